"""The data sets of `estimates.h5`: what each holds for a window, and how it is stored."""

from typing import Any, NamedTuple

import h5py

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.tracks import INSTANTS

_ROWS_PER_CHUNK = 256
_TRACK_ROWS_PER_CHUNK = 16


class Column(NamedTuple):
    """A data set with one row per window.

    Attributes:
        shape: of a row.
        dtype: as h5py takes it.
        unit: empty where there is none.
        description: what a row means.
        chunk: rows stored together; columns of large rows have few, and are compressed.
    """

    shape: tuple[int, ...]
    dtype: Any
    unit: str
    description: str
    chunk: int = _ROWS_PER_CHUNK

    @property
    def compressed(self) -> bool:
        """Whether it is stored compressed."""
        return self.chunk < _ROWS_PER_CHUNK


TEXT = h5py.string_dtype()
COLUMNS = {
    "t_start": Column((), "f8", "s", "start of the window, in the recording's event time"),
    "t_end": Column((), "f8", "s", "end of the window (exclusive)"),
    "t_start_ns": Column((), "i8", "ns", "t_start without rounding"),
    "t_end_ns": Column((), "i8", "ns", "t_end without rounding"),
    "t": Column((), "f8", "s", "time that linear and angular hold at"),
    "linear": Column(
        (3,),
        "f8",
        "1",
        "unit direction of the camera's velocity in its optical frame (x right, y down, "
        "z forward); zeros where not observable",
    ),
    "angular": Column(
        (3,), "f8", "rad/s", "angular velocity in the optical frame; NaN unless status is ok"
    ),
    "covariance": Column(
        (6, 6),
        "f8",
        "1, rad/s",
        "of (linear, angular); [0, 0] is -1 where translation is not observable",
    ),
    "translation_observable": Column((), "?", "", "whether linear holds a direction"),
    "status": Column((), TEXT, "", "ok, or why there is no estimate"),
    "model": Column((), TEXT, "", "full, rotation, translation or static"),
    "events": Column((), "i8", "1", "events of the window that were used"),
    "runtime_s": Column((), "f8", "s", "wall time of the estimate"),
}


def track_columns(points: int) -> dict[str, Column]:
    """Describe the data sets that point tracks add, for so many points."""
    rows = _TRACK_ROWS_PER_CHUNK
    return {
        "tracks": Column(
            (INSTANTS, points, 2),
            "f4",
            "px",
            "positions (x, y) of the tracked points at track_times_ns; NaN from where a point "
            "leaves the image on, and unless status is ok",
            rows,
        ),
        "track_times_ns": Column((INSTANTS,), "i8", "ns", "times of the tracks' positions", rows),
        "track_id": Column(
            (points,),
            "i8",
            "",
            "number of each point's track; it changes where a new one begins",
            rows,
        ),
    }


def flow_column(camera: Camera) -> Column:
    """Describe the data set of dense flow, (H, W, 2) per window of a camera."""
    return Column(
        (camera.height, camera.width, 2),
        "f2",
        "px",
        "displacement (u right, v down) over the window of the pixels of t_start; NaN unless "
        "status is ok",
        chunk=1,
    )
