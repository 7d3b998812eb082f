"""Measure how accurate and how consistent the estimator is, over many recordings.

60 random recordings of 3 s, those of another simulator and real ones, each from two cold starts.
Writes accuracy.json, report.html and one table of windows per recording into the folder of --out.
docs/scoreboard.md says what the figures mean.
"""

import argparse
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

from benchmarks.scoreboard.compare import compare, describe, read_run
from benchmarks.scoreboard.report import write_report
from benchmarks.scoreboard.run import measure_all, save_windows
from benchmarks.scoreboard.simulated_subjects import random_subjects
from benchmarks.scoreboard.subjects import SHARED_DATA, Subject, shared_subjects
from benchmarks.scoreboard.summary import summarise
from benchmarks.scoreboard.table import table
from emoflow_ros.cli import run
from emoflow_ros.config import Config, load_config
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.recording_options import (
    add_configuration_options,
    make_folder,
    overrides,
    positive,
)
from emoflow_ros.report.documents import write_json

_SEEDS = "0:60"
_QUICK = "0:12"
_EPILOG = """\
examples:
  python -m benchmarks.scoreboard --quick
  python -m benchmarks.scoreboard --only 'independent|real'
  python -m benchmarks.scoreboard --gyro
  python -m benchmarks.scoreboard --only random --seeds 0:30 --set estimator.max_events=20000
"""


def main() -> int:
    """Entry point."""
    return run(lambda: _run(_parse()))


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scoreboard",
        description=__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--seeds", metavar="A:B", help=f"of the random recordings, A to B - 1 (default: {_SEEDS})")
    add("--quick", action="store_true", help=f"random seeds {_QUICK} only")
    add("--only", metavar="REGEX", default="", help="recordings whose name matches")
    add("--data", type=Path, default=SHARED_DATA, help="folder of the other recordings")
    add("--jobs", type=positive, default=2, metavar="N", help="processes (default: 2)")
    add("--out", type=Path, default=Path("out/accuracy"), help="default: out/accuracy")
    add(
        "--cache",
        type=Path,
        default=Path("out/accuracy/cache"),
        help="folder of random recordings that were simulated before (default: out/accuracy/cache)",
    )
    add(
        "--gyro",
        action="store_true",
        help="measure a second time with a gyro (imu.use=auto), into OUT/gyro, and print both "
        "side by side",
    )
    add("--no-report", action="store_true", help="write no report.html")
    add_configuration_options(parser)
    return parser.parse_args()


def _run(options: argparse.Namespace) -> None:
    config = load_config(options.profile, overrides(options))
    _measure(options, config, options.out)
    if options.gyro:
        aided = replace(config, imu=replace(config.imu, use="auto"))
        _measure(options, aided, options.out / "gyro")
        print("\nwithout a gyro, and with one:")
        print(describe(compare(read_run(options.out), read_run(options.out / "gyro"))))


def _measure(options: argparse.Namespace, config: Config, folder: Path) -> None:
    """Measure all recordings and write the results into a folder."""
    subjects, missing = _subjects(options)
    make_folder(folder)
    load = os.getloadavg()[0]
    outcomes = measure_all(subjects, config, options.jobs)
    document = summarise(outcomes, config, missing, load)
    print(table(document))
    save_windows(folder, outcomes)
    path = folder / "accuracy.json"
    write_json(path, document)
    print(f"written to {path}")
    if not options.no_report:
        print(write_report(folder, outcomes, document))


def _subjects(options: argparse.Namespace) -> tuple[list[Subject], list[str]]:
    """List the recordings to measure, and the names of those that are not there."""
    seeds = parse_seeds(options.seeds or (_QUICK if options.quick else _SEEDS))
    everything = [*random_subjects(seeds, options.cache), *shared_subjects(options.data)]
    try:
        chosen = [subject for subject in everything if re.search(options.only, subject.name)]
    except re.error as error:
        raise InputError("--only", f"not a regular expression ({error})", "correct it") from None
    missing = [f"{s.name} ({s.missing})" for s in chosen if s.missing]
    there = [subject for subject in chosen if not subject.missing]
    if not there:
        raise InputError("--only", "no recording is left", "give another REGEX, or --data FOLDER")
    return there, missing


def parse_seeds(text: str) -> range:
    """Parse `A:B`, the seeds from A to B - 1.

    Raises:
        InputError: another form, or no seed.
    """
    match = re.fullmatch(r"(\d+):(\d+)", text)
    if not match or int(match[1]) >= int(match[2]):
        raise InputError("--seeds", f"'{text}' is not A:B with A < B", "give for example 0:60")
    return range(int(match[1]), int(match[2]))


if __name__ == "__main__":
    sys.exit(main())
