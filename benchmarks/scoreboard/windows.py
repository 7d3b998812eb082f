"""The table that the scoreboard keeps of a recording: one row per window and cold start."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# One row is one window. "Part" is the part of it that the estimator took; "static event pixels"
# are those with an event and a known truth that see no object of its own motion.
WINDOW = np.dtype(
    [
        ("start", np.int64),  # which cold start: 0 or 1
        ("t_begin", np.int64),  # ns, the first event of that start
        ("t_window", np.int64),  # ns, begin of the whole window
        ("t_start", np.int64),  # ns, begin of the part
        ("t_end", np.int64),  # ns, end of both
        ("events", np.int64),  # of the part
        ("status", "U16"),
        ("model", "U16"),
        ("ok", np.bool_),  # whether there is an estimate
        ("moved_px", np.float64),  # median true way of the static event pixels, whole window
        ("parallax_px", np.float64),  # mean of what is left of that way without the rotation
        ("truth_px", np.float64),  # mean true way of the event pixels over the part, flow or not
        ("epe_px", np.float64),  # mean end-point error of the same pixels; NaN without a flow
        ("angular", np.float64, 3),  # rad/s
        ("true_angular", np.float64, 3),  # rad/s
        ("angular_covariance", np.float64, (3, 3)),
        ("linear", np.float64, 3),  # unit direction; NaN where none is given
        ("true_linear", np.float64, 3),  # unit direction; NaN where unknown
        ("linear_covariance", np.float64, (3, 3)),
        ("seconds", np.float64),  # that the estimate took
    ]
)

Windows = NDArray[np.void]


def make_windows(rows: list[dict[str, Any]]) -> Windows:
    """Build the table from rows that hold every field of WINDOW by name."""
    windows = np.zeros(len(rows), WINDOW)
    for k, row in enumerate(rows):
        for name in WINDOW.names or ():
            windows[name][k] = row[name]
    return windows
