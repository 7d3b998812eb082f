"""The data sets of `estimates.h5`: what each holds for a window, and how it is stored.

The record of a window's quality is the same in every result: in `estimates.h5`, files of labels,
`report.json` and `windows.csv`.
"""

from typing import Any, NamedTuple

import h5py

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import INSTANTS
from emoflow_ros.core.types.estimate import Quality

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

QUALITY = {
    "translation_observable": Column((), "?", "", "whether linear holds a direction"),
    "window_events": Column((), "i8", "1", "all events of the window, from t_start to t_end"),
    "events": Column((), "i8", "1", "events of the window that were used"),
    "iterations": Column((), "i8", "1", "steps of the optimiser"),
    "stop_reason": Column(
        (), TEXT, "", "converged, iterations, deadline, remembered, or why the events gave nothing"
    ),
    "contrast_gain": Column((), "f8", "1", "variance of the warped over the unwarped event image"),
    "residual_px": Column((), "f8", "px", "robust scale of the epipolar residual"),
    "inlier_fraction": Column((), "f8", "1", "share of the residuals within 3 robust scales"),
    "warm": Column((), "?", "", "whether the window before was the start"),
    "runtime_s": Column((), "f8", "s", "wall time of the estimate"),
}

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
        (3,), "f8", "rad/s", "angular velocity in the optical frame; NaN where status tells none"
    ),
    "covariance": Column(
        (6, 6),
        "f8",
        "1, rad/s",
        "of (linear, angular); [0, 0] is -1 where translation is not observable",
    ),
    "status": Column((), TEXT, "", "ok, still, carried, bounded, or why there is no motion"),
    "model": Column((), TEXT, "", "full, rotation, translation or static"),
    **QUALITY,
}

# Added within version 1 of the layout: readers do without them where a file has none.
ADDED = QUALITY.keys() - {"translation_observable", "events", "runtime_s"}


def quality_values(
    quality: Quality, window_events: int, translation_observable: bool
) -> dict[str, Any]:
    """Return the values of a window's QUALITY columns; NaN where unknown."""
    return {
        "translation_observable": translation_observable,
        "window_events": window_events,
        "events": quality.events,
        "iterations": quality.iterations,
        "stop_reason": str(quality.stop_reason),
        "contrast_gain": quality.contrast_gain,
        "residual_px": quality.residual_px,
        "inlier_fraction": quality.inlier_fraction,
        "warm": quality.warm,
        "runtime_s": quality.runtime_s,
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
            "leaves the image on, and where there is no flow",
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
        "displacement (u right, v down) over the window of the pixels of t_start; NaN where "
        "there is no flow",
        chunk=1,
    )
