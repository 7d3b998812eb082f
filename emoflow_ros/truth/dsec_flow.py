"""DSEC's flow images: the truth, the intervals of the benchmark, and what its server takes.

An image is a 16-bit PNG of x, y and validity (Gehrig et al., 3DV 2021).
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.errors import InputError
from emoflow_ros.readers.dsec import DsecFolder
from emoflow_ros.truth.ground_truth import TrueFlow

_NS_PER_US = 1000
_PER_PX = 128
_ZERO = 1 << 15
_MAX = np.iinfo(np.uint16).max
_SIZE = (640, 480)


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
    """Read lines of whole numbers; a first line that does not begin with a digit is the header."""
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


def _opencv(path: Path) -> Any:
    """Import OpenCV for an image."""
    try:
        return import_module("cv2")
    except ImportError:
        raise InputError(
            path, "OpenCV is not installed", "run 'pip install opencv-python-headless'"
        ) from None


def read_flow_png(path: Path) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Read a displacement (H, W, 2) in px, zero where not valid, and where it is valid (H, W).

    Raises:
        InputError: no such file, not an image of three 16-bit channels, or OpenCV is missing.
    """
    cv2 = _opencv(path)
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if image is None:
        raise InputError(path, "missing or damaged", "copy the sequence's flow images again")
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint16:
        raise InputError(path, "not a PNG of three 16-bit channels", "give DSEC's flow images")
    rgb = image[..., ::-1]  # OpenCV's order is blue, green, red
    valid = rgb[..., 2] > 0
    flow = (rgb[..., :2].astype(np.float32) - _ZERO) / _PER_PX
    return np.where(valid[..., None], flow, np.float32(0)), valid


def write_flow_png(path: Path, flow: NDArray[np.floating[Any]]) -> None:
    """Write a displacement (H, W, 2) in px, every pixel valid.

    Values are rounded to 1/128 px and limited to what 16 bits hold, -256 to 256 px.
    """
    values = np.clip(np.rint(flow * _PER_PX) + _ZERO, 0, _MAX).astype(np.uint16)
    ones = np.ones((*flow.shape[:2], 1), np.uint16)
    rgb = np.concatenate([values, ones], axis=-1)
    if not _opencv(path).imwrite(str(path), rgb[..., ::-1]):
        raise InputError(path, "cannot be written", "give another --submission")


class Submission:
    """Write one sequence's flow images as DSEC's benchmark server takes them.

    The sequence's folder holds one image `<number>.png` (six digits) for each interval of the
    benchmark's `<sequence>.csv`: the displacement over the interval at every pixel of the rectified
    view (dsec.ifi.uzh.ch/optical-flow-submission-format).

    Args:
        root: the folder with a folder per sequence, which goes to the server as an archive.
        sequence: the sequence's name.
        intervals: what the benchmark asks for.
        camera: of the rectified view.
        keep: whether to keep images that are there; they are removed otherwise.

    Raises:
        InputError: a camera of another size, or a folder that cannot be written.
    """

    def __init__(
        self,
        root: Path,
        sequence: str,
        intervals: Sequence[DsecInterval],
        camera: Camera,
        *,
        keep: bool = False,
    ) -> None:
        if (camera.width, camera.height) != _SIZE:
            size = f"{camera.width}x{camera.height}"
            raise InputError("--submission", f"flow of {size} px", "give a DSEC sequence")
        self.folder = root / sequence
        self._shape = (camera.height, camera.width, 2)
        self._paths = {(i.start, i.end): self.folder / f"{i.number:06d}.png" for i in intervals}
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            for path in self.folder.glob("*.png"):
                if not keep:
                    path.unlink()
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError(
                self.folder, f"cannot be written ({reason})", "give another --submission"
            ) from None

    def offer(self, t_start: int, t_end: int, estimate: Estimate) -> None:
        """Write the flow over [t_start, t_end] ns, if the benchmark asks for it."""
        path = self._paths.get((t_start, t_end))
        if path is not None and estimate.flow is not None:
            flow = estimate.flow.displacement(t_start, t_end)
            write_flow_png(path, np.nan_to_num(flow, nan=0.0))

    def finish(self) -> int:
        """Write images without motion where there are none, since the server wants them all.

        Returns:
            How many were missing.
        """
        missing = [path for path in self._paths.values() if not path.exists()]
        for path in missing:
            write_flow_png(path, np.zeros(self._shape, np.float32))
        return len(missing)

    def report(self) -> None:
        """Finish, and say where the images are and how many have no estimate."""
        missing = self.finish()
        print(self.folder)
        if missing:
            print(f"{missing} of its images have no estimate and show no motion", file=sys.stderr)
