"""Flow maps of MVSEC's `<sequence>_gt_flow_dist.npz`, streamed from the archive."""

import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError

_FIX = "give MVSEC's <sequence>_gt_flow_dist.npz"
_PARTS = ("timestamps", "x_flow_dist", "y_flow_dist")


class MvsecFlowMaps:
    """Maps over the interval to the next stamp, in the distorted image.

    The arrays of a sequence take up to 16 GB, so that they are read map by map. Going forward
    is free, going back decompresses the archive from its start. The simulator's files tell
    which pixels see a moving object, in a further array `moving` (N, H, W).

    Raises:
        InputError: not such a file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.name = path.name
        try:
            with zipfile.ZipFile(path) as archive, archive.open("timestamps.npy") as file:
                seconds = np.lib.format.read_array(file)
                told = "moving.npy" in archive.namelist()
            self._columns = [_Frames(path, f"{part}.npy") for part in _PARTS[1:]]
            self._moving = _Frames(path, "moving.npy") if told else None
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            reason = " ".join(str(error).split())
            raise InputError(path, f"not a flow ground truth ({reason})", _FIX) from None
        self.stamps = np.rint(seconds.astype(np.float64) * NS_PER_S).astype(np.int64)
        if self._columns[0].shape != self._columns[1].shape or len(self.stamps) != len(
            self._columns[0]
        ):
            raise InputError(path, f"{', '.join(_PARTS)} differ in length", _FIX)

    def read(self, index: int) -> NDArray[np.float32]:
        """Read map `index`, (H, W, 2) px; 0 where unknown."""
        return np.stack([self._read(column, index) for column in self._columns], axis=-1)

    def moving(self, index: int) -> NDArray[np.bool_] | None:
        """Read which pixels (H, W) see an object of its own motion; None if the file is silent."""
        return None if self._moving is None else self._read(self._moving, index) != 0

    def _read(self, frames: "_Frames", index: int) -> NDArray[np.float32]:
        try:
            return frames.read(index)
        except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
            reason = " ".join(str(error).split())
            raise InputError(self._path, f"damaged ({reason})", "download it again") from None


class _Frames:
    """One (N, H, W) array of an archive, read frame by frame."""

    def __init__(self, path: Path, member: str) -> None:
        # An archive of its own: members of one archive disturb each other when they seek.
        self._archive = zipfile.ZipFile(path)
        self._stream = self._archive.open(member)
        major, _ = np.lib.format.read_magic(self._stream)
        if major == 1:
            header = np.lib.format.read_array_header_1_0(self._stream)
        else:
            header = np.lib.format.read_array_header_2_0(self._stream)
        self.shape, fortran_order, self._dtype = header
        if len(self.shape) != 3 or fortran_order:
            raise ValueError(f"{member} of shape {self.shape} is not a stack of images")
        self._start = self._stream.tell()
        self._bytes = self.shape[1] * self.shape[2] * self._dtype.itemsize

    def __len__(self) -> int:
        return int(self.shape[0])

    def read(self, index: int) -> NDArray[np.float32]:
        """Read frame `index`, (H, W)."""
        self._stream.seek(self._start + index * self._bytes)
        data = np.frombuffer(self._stream.read(self._bytes), self._dtype)
        return data.reshape(self.shape[1:]).astype(np.float32)
