"""DSEC's flow truth and the intervals of its benchmark (Gehrig et al., 3DV 2021)."""

from pathlib import Path
from typing import NamedTuple

from emoflow_ros.errors import InputError
from emoflow_ros.offline.flow_png import read_flow_png
from emoflow_ros.offline.truth.base import TrueFlow
from emoflow_ros.readers.dsec import DsecFolder

_NS_PER_US = 1000


class DsecInterval(NamedTuple):
    """An interval of the benchmark: start and end in ns, and the number of its flow image."""

    start: int
    end: int
    number: int


class DsecFlow:
    """The flow images of a sequence, in the rectified view; each holds for its interval only.

    Every pixel with truth counts, also those without events, as in DSEC's benchmark.

    Raises:
        InputError: images and intervals do not belong together.
    """

    def __init__(self, folder: DsecFolder) -> None:
        self._images = sorted(folder.flow.glob("*.png"))
        times = _read_rows(folder.flow_times, "from_timestamp_us, to_timestamp_us")
        if len(times) != len(self._images):
            raise InputError(
                folder.flow,
                f"{len(self._images)} images, but {len(times)} intervals in "
                f"{folder.flow_times.name}",
                "unpack both again",
            )
        self.intervals = [
            DsecInterval(start * _NS_PER_US, end * _NS_PER_US, _number(image))
            for (start, end), image in zip(times, self._images, strict=True)
        ]
        self._rows = {(i.start, i.end): row for row, i in enumerate(self.intervals)}
        name = folder.path.resolve().name
        self.description = f"flow: DSEC's images of {name}, rectified view, all pixels with truth"

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Return the image of the interval [t0, t1] ns; None for any other interval."""
        row = self._rows.get((t0, t1))
        if row is None:
            return None
        flow, valid = read_flow_png(self._images[row])
        return TrueFlow(flow, valid, everywhere=True)


def read_test_intervals(path: Path) -> list[DsecInterval]:
    """Read the benchmark's `<sequence>.csv`: the intervals and the numbers of their images.

    Raises:
        InputError: not such a file.
    """
    rows = _read_rows(path, "from_timestamp_us, to_timestamp_us, file_index")
    return [DsecInterval(start * _NS_PER_US, end * _NS_PER_US, n) for start, end, n in rows]


def _read_rows(path: Path, layout: str) -> list[list[int]]:
    """Read lines of whole numbers; a first line that begins with none is the header."""
    fix = f"give DSEC's file of lines '{layout}'"
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        if lines and not lines[0].strip()[:1].isdigit():
            lines = lines[1:]
        rows = [[int(word) for word in line.split(",")] for line in lines if line.strip()]
    except (OSError, UnicodeDecodeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(path, f"not a table of whole numbers ({reason})", fix) from None
    columns = layout.count(",") + 1
    if not rows or any(len(row) != columns for row in rows):
        raise InputError(path, f"not {columns} numbers in every line", fix)
    if any(row[0] >= row[1] for row in rows) or rows != sorted(rows):
        raise InputError(path, "intervals that are empty or not in order", fix)
    return rows


def _number(path: Path) -> int:
    if not path.stem.isdecimal():
        raise InputError(path, "its name is no number", "keep the names of DSEC's flow images")
    return int(path.stem)
