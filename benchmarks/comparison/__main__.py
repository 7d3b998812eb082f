"""Our rows of MVSEC beside what others have published, from a folder of downloaded files.

Of each sequence the folder holds `NAME_data.hdf5` (or `.bag`), `NAME_gt.hdf5` (or `.bag`),
`NAME_gt_flow_dist.npz` and, for the errors as the paper counts them, `NAME_odom.npz`. Windows run
from every frame to the fourth one after it (dt = 4). The profiles `paper*` take the published
windows, whole and from the future, too, and minutes for each; the others end with the interval. A
folder with `events.txt`, `calib.yaml`, `depth.txt` and `velocity_truth.txt` is a snippet: its own
row, of the profile's windows.

Results stay in the folder of --out, one report for each row: the same command goes on where it was
cut. docs/comparison.md explains the columns.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.comparison.snippet import CALIBRATION, EVENTS, is_snippet, load_snippet
from benchmarks.comparison.table import SEQUENCES, Row, published, table
from emoflow_ros.cli import run
from emoflow_ros.config import Config, load_config
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.benchmark_sequences import find_sequence
from emoflow_ros.evaluation.protocols import CAUSAL, PAPER, WINDOWS, adapt_windows, make_plan
from emoflow_ros.evaluation.recording_options import Source, overrides, positive
from emoflow_ros.evaluation.window_run import evaluate
from emoflow_ros.factory import make_estimator
from emoflow_ros.readers import require_camera
from emoflow_ros.report.report_writer import write_report
from emoflow_ros.truth import load_truth

PROTOCOL = "mvsec-dt4"


def main() -> int:
    """Run the comparison."""
    return run(lambda: _compare(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.comparison",
        description=__doc__,
        epilog="example: python -m benchmarks.comparison ~/mvsec --profiles realtime rigid",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("folder", type=Path, metavar="FOLDER", help="of downloaded files, or a snippet")
    add("--profiles", nargs="+", default=["realtime"], metavar="PROFILE",
        help="default: realtime")  # fmt: skip
    add("--set", action="append", default=[], metavar="NAME=VALUE", dest="overrides",
        help="an option of all profiles by its dotted name, for example estimator.model=full; "
        "repeatable")  # fmt: skip
    add("--max-windows", type=positive, metavar="N", help="of each sequence (default: all)")
    add("--out", type=Path, default=Path("out/comparison"), metavar="DIR",
        help="default: out/comparison")  # fmt: skip
    parser.set_defaults(window_ms=None, stride_ms=None)
    return parser


def _compare(args: argparse.Namespace) -> None:
    jobs = list(_jobs(args.folder))
    if not jobs:
        raise InputError(
            args.folder,
            "holds no sequence of MVSEC and no snippet",
            f"download for example {SEQUENCES[0]}_data.hdf5, _gt.hdf5 and _gt_flow_dist.npz to it",
        )
    values = overrides(args)
    configs = {name: load_config(name, values) for name in args.profiles}
    rows = []
    for job in jobs:
        for profile, config in configs.items():
            rows.append(measure(job, profile, config, args.out, args.max_windows))
        rows += published(job.name)
    text = table(rows)
    print(text)
    (args.out / "table.md").write_text(text + "\n")
    print(f"written to {args.out}")


@dataclass(frozen=True)
class Job:
    """A sequence whose files are there: name, recording, and truth (of a snippet none)."""

    name: str
    data: Path
    truth: tuple[Path, ...]


def _jobs(folder: Path) -> Iterator[Job]:
    """Find what the folder holds, and say what is missing.

    Raises:
        InputError: a recording without any truth.
    """
    if is_snippet(folder):
        yield Job(folder.resolve().name, folder, ())
        return
    for snippet in filter(is_snippet, sorted(folder.glob("*"))):
        yield Job(snippet.name, snippet, ())
    for name in SEQUENCES:
        stem = folder / name.removesuffix("_segment")
        data = _first(stem, "_data.hdf5", "_data.bag")
        if data is None:
            print(f"{name}: no {stem.name}_data.hdf5 or .bag in {folder}", file=sys.stderr)
            continue
        found = (
            _first(stem, "_gt.hdf5", "_gt.bag"),
            _first(stem, "_gt_flow_dist.npz"),
            _first(stem, "_odom.npz"),
        )
        truth = tuple(path for path in found if path)
        if not truth:
            raise InputError(data, "without ground truth beside it", f"add {stem.name}_gt.hdf5")
        yield Job(name, data, truth)


def _first(stem: Path, *endings: str) -> Path | None:
    paths = (stem.with_name(stem.name + ending) for ending in endings)
    return next((path for path in paths if path.is_file()), None)


def measure(
    job: Job, profile: str, config: Config, out: Path, max_windows: int | None = None
) -> Row:
    """Evaluate one profile on one sequence, or read what an earlier run has left."""
    folder = out / f"{job.name}_{profile}"
    report, wanted = folder / "report.json", config.flat() | {"max_windows": max_windows}
    done = folder / "configuration.json"
    if not (report.is_file() and done.is_file() and json.loads(done.read_text()) == wanted):
        _evaluate(job, profile, config, folder, max_windows)
        done.write_text(json.dumps(wanted))
    return _row(job.name, profile, json.loads(report.read_text(encoding="utf-8")))


def _evaluate(
    job: Job, profile: str, config: Config, folder: Path, max_windows: int | None
) -> None:
    is_paper = profile.startswith("paper")
    snippet = not job.truth
    protocol, clips = (WINDOWS, CAUSAL) if snippet else (PROTOCOL, PAPER if is_paper else CAUSAL)
    sequence = None if snippet else find_sequence(job.name)
    config = replace(config, window=adapt_windows(config.window, protocol, clips))
    path = job.data / EVENTS if snippet else job.data
    with Source(
        path, calibration=job.data / CALIBRATION if snippet else None, sequence=sequence
    ).open() as recording:
        camera = require_camera(recording)
        truth = load_snippet(job.data, camera) if snippet else load_truth(recording, job.truth)
        plan = make_plan(protocol, recording, truth, config.window, sequence, clips=clips)
        result = evaluate(
            recording,
            make_estimator(camera, config),
            plan.slicer,
            plan.truth,
            protocol=plan.description,
            max_windows=max_windows,
            progress_bar=True,
        )
    if result.interrupted:
        raise KeyboardInterrupt
    folder.mkdir(parents=True, exist_ok=True)
    write_report(result, config.flat(), folder)


def _row(sequence: str, method: str, report: dict[str, Any]) -> Row:
    """Take the columns out of a report.json."""
    figures = {name: value["value"] for name, value in report["summary"].items()}
    milliseconds = figures.get("runtime_p50_ms")
    return Row(
        sequence,
        method,
        figures.get("epe_px"),
        figures.get("out_percent"),
        figures.get("paper_angular_rms_deg_s"),
        figures.get("direction_error_deg"),
        None if milliseconds is None else milliseconds / 1000,
        f"{sum(w['status'] == 'ok' for w in report['windows'])} of {len(report['windows'])}",
    )


if __name__ == "__main__":
    sys.exit(main())
