"""The command `evaluate compare`: runs side by side."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.recording_options import make_folder
from emoflow_ros.evaluation.run_comparison import load_run
from emoflow_ros.report.comparison_page import write_comparison


def main(arguments: Sequence[str]) -> int:
    """Compare the runs named on the command line."""
    parser = argparse.ArgumentParser(
        prog="evaluate compare",
        description="Put runs of 'evaluate' side by side and test whether they differ from the "
        "first one, window by window.",
        epilog="example: evaluate compare out/run1 out/run2 --out out/comparison",
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/comparison"),
        metavar="DIR",
        help="folder for comparison.html and comparison.json (default: out/comparison)",
    )
    options = parser.parse_args(arguments)
    runs = [load_run(path) for path in options.runs]
    if len(runs) < 2:
        raise InputError(options.runs[0], "one run alone", "give two or more to compare")
    make_folder(options.out)
    print(write_comparison(runs, options.out))
    return 0
