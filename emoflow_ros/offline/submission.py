"""Flow images as DSEC's benchmark server takes them.

A folder per sequence holds one image `<number>.png` (six digits) for each interval of the
benchmark's `<sequence>.csv`: the displacement over the interval at every pixel of the rectified
view (dsec.ifi.uzh.ch/optical-flow-submission-format).
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.errors import InputError
from emoflow_ros.offline.flow_png import write_flow_png
from emoflow_ros.offline.truth.dsec import DsecInterval

_SIZE = (640, 480)


class Submission:
    """Write one sequence's flow images.

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
        """Write no motion where there is no image, since the server wants them all.

        Returns:
            How many there were.
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
