"""The verdict on one window, whether it gave an estimate or not."""

from collections.abc import Sequence

from emoflow_ros.core.estimate import Estimate, Status
from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S
from emoflow_ros.node.statistics import Level, Report
from emoflow_ros.node.tasks import Result, Task

_LEVELS = {
    Status.OK: Level.OK,
    Status.TOO_FEW_EVENTS: Level.WARN,
    Status.NO_MOTION: Level.WARN,
    Status.UNCERTAIN: Level.WARN,
    Status.DIVERGED: Level.ERROR,
}


def judge_result(
    result: Result, now: int, scale: str = "none", problems: Sequence[str] = ()
) -> Report:
    """Judge a window that the worker answered.

    Args:
        result: the answer.
        now: ROS time of publishing, ns.
        scale: where that of the published twist comes from, as `scale.source` names it.
        problems: what kept the twist from being published as it was asked for.
    """
    estimate = result.estimate
    quality = estimate.quality
    values = {
        "model": str(estimate.model),
        "translation_observable": str(estimate.translation_observable).lower(),
        "scale": scale,
        "gyro": str(estimate.gyro),
        "contrast_gain": f"{quality.contrast_gain:.3f}",
        "residual_px": f"{quality.residual_px:.3f}",
        "inlier_fraction": f"{quality.inlier_fraction:.3f}",
        "iterations": str(quality.iterations),
        "stop_reason": quality.stop_reason,
        "warm": str(quality.warm).lower(),
        "runtime_ms": f"{1e3 * quality.runtime_s:.1f}",
    }
    common = _common(result.stamp, now, str(estimate.status), quality.events)
    level = max(_LEVELS[estimate.status], Level.WARN if problems else Level.OK)
    return Report(level, "; ".join([_message(estimate), *problems]), common | values)


def judge_dropped(task: Task, reason: str, now: int) -> Report:
    """Judge a window that had to make room for newer ones, and why; `now` is ROS time, ns."""
    return Report(Level.WARN, f"dropped: {reason}", _lost(task, now, "dropped"))


def judge_failed(task: Task, reason: str, now: int) -> Report:
    """Judge a window that the worker failed at for this reason; `now` is ROS time, ns."""
    return Report(Level.ERROR, reason, _lost(task, now, "failed"))


def _message(estimate: Estimate) -> str:
    if estimate.status is Status.OK and not estimate.translation_observable:
        return f"{estimate.status}, translation not observable"
    return str(estimate.status)


def _lost(task: Task, now: int, status: str) -> dict[str, str]:
    return _common(task.stamp, now, status, len(task.window.events))


def _common(stamp: int, now: int, status: str, events: int) -> dict[str, str]:
    sec, nanosec = divmod(stamp, NS_PER_S)
    return {
        "stamp": f"{sec}.{nanosec:09d}",
        "status": status,
        "events": str(events),
        "lag_ms": f"{(now - stamp) / NS_PER_MS:.1f}",
    }
