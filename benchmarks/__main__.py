"""Run the benchmarks one after another, and print one table: figure, target, result, verdict.

The short runs take a quarter of an hour on two cores. The long ones take hours: ten minutes of
replay, all scenes, and the published loop to its end.
"""

import argparse
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks._rows import Row, lay_out
from emoflow_ros.cli import run
from emoflow_ros.errors import InputError

_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Step:
    """One benchmark.

    Attributes:
        name: of its file here.
        short: its arguments in a short run; None: it has no part in that.
        long: its arguments in a long run.
        rows: whether it writes NAME.json with rows into the folder of results.
    """

    name: str
    short: tuple[str, ...] | None
    long: tuple[str, ...] = ()
    rows: bool = True


STEPS = (
    Step("decoders", short=()),
    Step("realtime", short=("--scenes", "calm", "agile", "--seeds", "0", "1", "2")),
    Step("offline", short=("--duration", "30")),
    Step("node", short=(), long=("--long",)),
    Step("growth", short=None),
    Step("stream", short=None),
    Step("paper", short=None, rows=False),
    Step("profiles", short=None, rows=False),
)


def main() -> int:
    """Run the command line."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--long", action="store_true", help="everything, in full")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/benchmarks"),
        help="folder of results (default: out/benchmarks)",
    )
    return parser


def _measure(args: argparse.Namespace) -> None:
    began = time.monotonic()
    steps = [step for step in STEPS if args.long or step.short is not None]
    failed = []
    for step in steps:
        print(f"\n== {step.name}", flush=True)
        results(step, args.out).unlink(missing_ok=True)  # those of an earlier run
        if subprocess.run(command(step, args.out, long=args.long), check=False).returncode:
            failed.append(step.name)
    print(f"\n== {(time.monotonic() - began) / 60:.1f} minutes\n")
    # A benchmark that failed at one of its cases has written those before it.
    there = [path for step in steps if (path := results(step, args.out)).exists()]
    print(lay_out([row for path in there for row in read_rows(path)]))
    if failed:
        raise InputError(", ".join(failed), "failed", "see the messages above")


def command(step: Step, out: Path, *, long: bool) -> list[str]:
    """Return the command line of a step."""
    arguments = step.long if long else step.short or ()
    into = ("--out", str(results(step, out))) if step.rows else ()
    return [sys.executable, str(_HERE / f"{step.name}.py"), *arguments, *into]


def results(step: Step, out: Path) -> Path:
    """Return where a step with rows writes them."""
    return out / f"{step.name}.json"


def read_rows(path: Path) -> list[Row]:
    """Read the rows of a benchmark's results."""
    saved = json.loads(path.read_text(encoding="utf-8"))["rows"]
    return [Row.from_dict(row) for row in saved]


if __name__ == "__main__":
    sys.exit(main())
