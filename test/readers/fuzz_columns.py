"""Valid files of columns, each with one odd trait of the field: part of `make fuzz`.

Comments, blank lines and names in text; any order of columns; any unit of time, as whole numbers
or with decimals. The events that are read have to be those that were written.

    python test/readers/fuzz_columns.py [--runs N] [--seed N]
"""

import argparse
import contextlib
import io
import sys
import tempfile
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS / "recordings")]

from column_files import ARRAY_WRITERS, SCALES, steady_events, write_text  # noqa: E402

from emoflow_ros.core.types.events import Events  # noqa: E402
from emoflow_ros.readers import open_recording  # noqa: E402

LAYOUTS = ("txyp", "xytp", "xypt", "tpxy", "pxyt", "ptxy", "xtyp")
ODD_LINES = ("# comment\n", "% comment\n", "// comment\n", "\n", "   \n", "# 1 2 3 4\n")
# Units in which these rates cannot be mistaken (docs/sources.md).
DECIMALS = ("s", "ms", "us")
WHOLE = ("us", "ns", "ms")


def main() -> int:
    """Write and read; 1 at the first file whose events come out wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000, help="files")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()):
        for run in range(options.runs):
            (write_any_text if rng.random() < 0.5 else write_any_array)(Path(folder), rng, run)
    print(f"== columns: {options.runs} files, all read")
    return 0


def write_any_text(folder: Path, rng: np.random.Generator, run: int) -> None:
    """Write a text file with odd lines, columns and units, and read it."""
    events, unit = _events(rng), str(rng.choice(["s", "us", "ns", "ms"]))
    layout = str(rng.choice(LAYOUTS))
    odd = {
        place: str(rng.choice(ODD_LINES))
        for place in ("first", "between", "last")
        if rng.random() < 0.5
    }
    odd["between"] = odd.get("between", "").rstrip("\n")
    off = int(rng.choice([0, -1]))
    path = write_text(folder / "events.txt", events, layout, unit, off, **odd)
    _check(path, events, f"run {run}: {layout}, {unit}, {odd}", 1)


def write_any_array(folder: Path, rng: np.random.Generator, run: int) -> None:
    """Write an array of any kind with an odd unit, and read it."""
    events, name = _events(rng), str(rng.choice(list(ARRAY_WRITERS)))
    has_decimals = rng.random() < 0.5
    unit = str(rng.choice(DECIMALS if has_decimals else WHOLE))
    t = events.t * SCALES[unit]
    t = t if has_decimals else np.rint(t).astype(np.int64)
    path = ARRAY_WRITERS[name](folder, events, t)
    tolerance = 1 if unit != "ms" or has_decimals else 500_000
    _check(path, events, f"run {run}: {name}, {unit}, decimals {has_decimals}", tolerance)
    path.unlink()


def _events(rng: np.random.Generator) -> Events:
    """Some thousand events, 110 000 to 900 000 per second, in whole microseconds."""
    return steady_events(
        int(rng.integers(2000, 6000)), 1000 * int(rng.integers(2, 9)), int(rng.integers(1 << 30))
    )


def _check(path: Path, events: Events, what: str, tolerance_ns: int) -> None:
    with open_recording(path) as recording:
        read = Events.concatenate(list(recording.event_chunks()))
    for name in ("x", "y", "p"):
        assert np.array_equal(getattr(read, name), getattr(events, name)), f"{what}: {name}"
    assert np.abs(read.t - events.t).max() <= tolerance_ns, f"{what}: t"


if __name__ == "__main__":
    sys.exit(main())
