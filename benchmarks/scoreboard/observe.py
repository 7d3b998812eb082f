"""Run the estimator over a recording and note every window beside the truth."""

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scoreboard.subjects import Material
from benchmarks.scoreboard.truths import displace, true_rotation
from benchmarks.scoreboard.windows import Windows, make_windows
from emoflow_ros.config import Config
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S, Window, WindowSlicer
from emoflow_ros.evaluation.metrics import event_mask, flow_errors
from emoflow_ros.evaluation.window_run import attempt
from emoflow_ros.factory import make_estimator
from emoflow_ros.truth import TrueFlow, TrueTwist

SECOND_START_S = 0.37
_SHORT = 3  # the second start leaves out at most this part of a recording, 1/3
_MIN_PARALLAX_PX = 0.5  # below, the image does not tell which way the camera moves
_MIN_SPEED = 1e-3  # m/s

Pixels = NDArray[np.intp]


def start_times(material: Material) -> tuple[int, int]:
    """Times (ns) of the two cold starts: the first event, and 0.37 s later.

    Of a recording shorter than 1.11 s the second start leaves out a third.
    """
    first, last = int(material.events.t[0]), int(material.events.t[-1])
    return first, first + min(round(SECOND_START_S * NS_PER_S), (last - first) // _SHORT)


def observe(material: Material, config: Config) -> Windows:
    """Estimate all windows of both cold starts, and compare each one with the truth.

    With `imu.use` the windows carry the readings of the recording's gyro, where it has one. Without
    any event there is no window.
    """
    if not len(material.events):
        return make_windows([])
    gyro = material.gyro if config.imu.use != "off" else None
    rows = []
    for start, begin in enumerate(start_times(material)):
        events = material.events[int(np.searchsorted(material.events.t, begin)) :]
        estimator = make_estimator(material.calibration, config)
        for window in WindowSlicer(config.window).push(events):
            if gyro is not None:
                window = window.with_gyro(gyro)
            began = time.perf_counter()
            estimate, _ = attempt(estimator, window)
            seconds = time.perf_counter() - began
            row = _compare(window, estimate, material)
            rows.append({**row, "start": start, "t_begin": begin, "seconds": seconds})
    return make_windows(rows)


def _compare(window: Window, estimate: Estimate, material: Material) -> dict[str, Any]:
    """Fill one row of the table."""
    part = window.since(estimate.t_start)
    ok = estimate.told
    twist = material.truth.twists.twist(estimate.t) if material.truth.twists else None
    whole = _true_flow(window, material)
    # Slow motion takes the window whole: its flow need not be put together twice.
    partial = whole if part.t_start == window.t_start else _true_flow(part, material)
    moved, parallax = _true_motion(window, material, whole)
    if not _translates(twist):
        parallax = 0.0  # else it is the rounding of flow maps
    truth_px, epe_px = _flow_error(part, estimate, material, partial)
    nothing = np.full(3, np.nan)
    gives_linear = estimate.translation_observable
    return {
        "t_window": window.t_start,
        "t_start": part.t_start,
        "t_end": part.t_end,
        "events": len(part.events),
        "status": str(estimate.status),
        "model": str(estimate.model),
        "ok": ok,
        "moved_px": moved,
        "parallax_px": parallax,
        "truth_px": truth_px,
        "epe_px": epe_px,
        "angular": estimate.angular if ok else nothing,
        "true_angular": twist.angular if twist is not None else nothing,
        "angular_covariance": estimate.covariance[3:, 3:] if ok else math.nan,
        "linear": estimate.linear if gives_linear else nothing,
        "true_linear": _true_direction(twist, parallax),
        "linear_covariance": estimate.covariance[:3, :3] if gives_linear else math.nan,
    }


def _translates(twist: TrueTwist | None) -> bool:
    """Whether the truth tells a translation."""
    if twist is None or twist.linear is None:
        return False
    return float(np.linalg.norm(twist.linear)) > _MIN_SPEED


def _true_direction(twist: TrueTwist | None, parallax: float) -> NDArray[np.float64]:
    """Unit direction (3,) of translation; NaN where the image cannot tell it."""
    if twist is None or twist.linear is None or not parallax >= _MIN_PARALLAX_PX:
        return np.full(3, np.nan)
    return twist.linear / float(np.linalg.norm(twist.linear))


def _true_motion(window: Window, material: Material, true: TrueFlow | None) -> tuple[float, float]:
    """How far the image moves over the whole window: median way, mean parallax; px.

    Over static event pixels, so that an object that moves before a camera at rest is no motion;
    0 where there is none. NaN where the truth is silent.
    """
    rotation = true_rotation(material.truth, window.t_start, window.t_end)
    if true is None or rotation is None:
        return math.nan, math.nan
    pixels = _event_pixels(window, true, static=True)
    if not len(pixels):
        return 0.0, 0.0
    flow = true.displacement[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    rotated = displace(material.camera, pixels, rotation, np.zeros(3))
    parallax = np.linalg.norm(flow - rotated, axis=1)
    return float(np.median(np.linalg.norm(flow, axis=1))), float(np.nanmean(parallax))


def _flow_error(
    part: Window, estimate: Estimate, material: Material, true: TrueFlow | None
) -> tuple[float, float]:
    """Mean true displacement and mean end-point error of the event pixels over a part, px.

    NaN where no true flow is known exactly; the error is NaN, too, without an estimated flow.
    """
    if true is None or not material.exact_flow:
        return math.nan, math.nan
    pixels = _event_pixels(part, true)
    truth = true.displacement[pixels[:, 1], pixels[:, 0]]
    if estimate.flow is None:
        nothing = flow_errors(np.zeros(truth.shape), truth)
        return (nothing.truth_px if nothing else math.nan), math.nan
    points = pixels.astype(np.float64)
    ours = estimate.flow.tracks(points, (part.t_start, part.t_end))[1] - points
    errors = flow_errors(ours, truth)
    return (errors.truth_px, errors.epe_px) if errors else (math.nan, math.nan)


def _true_flow(window: Window, material: Material) -> TrueFlow | None:
    flows = material.truth.flows
    return flows.displacement(window.t_start, window.t_end) if flows else None


def _event_pixels(window: Window, true: TrueFlow, *, static: bool = False) -> Pixels:
    """List the pixels (N, 2), columns and rows, that hold an event and have a known truth."""
    height, width = true.valid.shape
    mask = event_mask(window.events, width, height) & true.valid
    if static and true.moving is not None:
        mask &= ~true.moving
    rows, columns = np.nonzero(mask)
    return np.stack([columns, rows], axis=1)
