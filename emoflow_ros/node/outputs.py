"""What is published of a window: its status, its pictures and its twists."""

import contextlib
from collections.abc import Sequence
from contextlib import ExitStack

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecycleNode

from emoflow_ros.core.products.wide import why_wide
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.diagnostics_topic import to_status
from emoflow_ros.node.picture_output import PictureOutput
from emoflow_ros.node.reports import Level, Report
from emoflow_ros.node.scale import Scale
from emoflow_ros.node.settings import NodeOptions, ScaleOptions
from emoflow_ros.node.stream_watch import HELD_BACK
from emoflow_ros.node.target_frame import NoTransformError
from emoflow_ros.node.tasks import Present, Result, Task, Wishes
from emoflow_ros.node.twist_output import HeldBack, TwistOutput, make_publisher

_LEVELS = {
    Status.OK: Level.OK,
    Status.STILL: Level.OK,
    Status.CARRIED: Level.WARN,
    Status.BOUNDED: Level.WARN,
    Status.LOST: Level.WARN,
    Status.TOO_FEW_EVENTS: Level.WARN,
    Status.NO_MOTION: Level.WARN,
    Status.DIVERGED: Level.ERROR,
}


class Outputs:
    """Publishes what becomes of windows; the lifecycle node must be active for that.

    Args:
        node: to publish with.
        options: what to publish.
        statistics: told while twists are not what was asked for.
        made: gets the calls that take the topics away.
        present: whether latest twists will come.

    Raises:
        InputError: the options need a package that is not installed.
    """

    def __init__(
        self,
        node: LifecycleNode,
        options: NodeOptions,
        statistics: Statistics,
        made: ExitStack,
        *,
        present: bool = False,
    ) -> None:
        self._node = node
        self._statistics = statistics
        self._twists = TwistOutput(node, options.output, made, present=present)
        self._scale = Scale(node, options.scale)
        made.callback(self._scale.close)
        self._status = make_publisher(node, DiagnosticStatus, "egomotion/status", made)
        self._pictures = PictureOutput(node, options.output, made)

    def set_scale(self, options: ScaleOptions) -> None:
        """Take the scale from where these options say from now on."""
        self._scale.set_options(options)

    @property
    def wishes(self) -> Wishes:
        """What results are to hold: only those pictures that somebody subscribes to now."""
        return self._pictures.wishes

    def publish(self, result: Result) -> None:
        """Publish a window's status, and its estimate if there is one."""
        scaling = self._scale.at(result.stamp)
        problems, notes = {"scale": scaling.problem}, []
        if result.estimate.told:
            # Pictures first: under load twists sent before a flow image, which is larger than Fast
            # DDS's shared memory (512 KiB), came seconds late or never.
            self._pictures.publish(result)
            problems["frame"], held_back = self._publish_twists(result, scaling.speed)
            notes = [held_back]
        for part, problem in problems.items():
            self._statistics.clear_problem(part)
            if problem:
                self._statistics.set_problem(part, Level.WARN, problem)
        found = [problem for problem in problems.values() if problem]
        report = judge_result(result, self._now(), scaling.source, found, notes)
        self._publish_status(report)

    def publish_present(self, present: Present) -> None:
        """Publish the latest twist."""
        stamp = present.task.to_ros(present.found.twist.t)
        speed = self._scale.at(stamp).speed
        with contextlib.suppress(NoTransformError):  # the next window's status will say so
            if self._twists.publish_present(present, speed):
                self._statistics.stream.give()

    def publish_dropped(self, task: Task, reason: str) -> None:
        """Publish the status of a window that was dropped for this reason."""
        self._publish_status(judge_dropped(task, reason, self._now()))

    def publish_failed(self, task: Task, reason: str) -> None:
        """Publish the status of a window that the worker failed at for this reason."""
        self._publish_status(judge_failed(task, reason, self._now()))

    def _publish_twists(self, result: Result, speed: float | None) -> tuple[str, str]:
        """Publish the twists, or tell what is wrong, and what is held back as it was asked for."""
        try:
            held_back = self._twists.publish(result, speed)
        except NoTransformError as error:
            return f"{error}; no twist is published", ""
        if held_back is HeldBack.TWIST:
            self._statistics.stream.miss(HELD_BACK)
        else:
            self._statistics.stream.give()
        return "", held_back

    def _publish_status(self, report: Report) -> None:
        name = self._node.get_fully_qualified_name()
        self._status.publish(to_status(f"{name}: window", name, report))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)


def judge_result(
    result: Result,
    now: int,
    scale: str = "none",
    problems: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> Report:
    """Judge a window that the worker answered.

    Args:
        result: the answer.
        now: ROS time of publishing, ns.
        scale: where that of the published twist comes from, as `scale.source` names it.
        problems: what kept the twist from being published as it was asked for.
        notes: what else there is to say.
    """
    estimate = result.estimate
    quality = estimate.quality
    values = {
        "model": str(estimate.model),
        "translation_observable": str(estimate.translation_observable).lower(),
        "flow": str(result.has_flow).lower(),
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
    common = _window_values(result.stamp, now, str(estimate.status), quality.events)
    level = max(_LEVELS[estimate.by_events], Level.WARN if problems else Level.OK)
    if quality.stop_reason == Status.DIVERGED:
        level = Level.ERROR
    words = [_estimate_message(result), *problems, *filter(None, notes)]
    return Report(level, "; ".join(words), common | values)


def judge_dropped(task: Task, reason: str, now: int) -> Report:
    """Judge a window that was dropped for this reason; `now` is ROS time, ns."""
    return Report(Level.WARN, f"dropped: {reason}", _lost_values(task, now, "dropped"))


def judge_failed(task: Task, reason: str, now: int) -> Report:
    """Judge a window that the worker failed at for this reason; `now` is ROS time, ns."""
    return Report(Level.ERROR, reason, _lost_values(task, now, "failed"))


def _estimate_message(result: Result) -> str:
    """Say where the motion comes from, what is missing, and in one word why it is wide."""
    estimate = result.estimate
    words = [str(estimate.status)]
    moves = estimate.told and estimate.status is not Status.STILL
    if moves and not estimate.translation_observable:
        words.append("translation not observable")
    if estimate.by_events is not estimate.status:
        words.append(f"by the gyro alone: {estimate.by_events}")
    elif why := why_wide(estimate):
        words.append(f"wide: {why}")
    return ", ".join(words)


def _lost_values(task: Task, now: int, status: str) -> dict[str, str]:
    return _window_values(task.stamp, now, status, task.window.events.came)


def _window_values(stamp: int, now: int, status: str, events: int) -> dict[str, str]:
    sec, nanosec = divmod(stamp, NS_PER_S)
    return {
        "stamp": f"{sec}.{nanosec:09d}",
        "status": status,
        "events": str(events),
        "lag_ms": f"{(now - stamp) / NS_PER_MS:.1f}",
    }
