"""What the worker answers, on its way back: counted, logged and published."""

from dataclasses import replace
from queue import SimpleQueue

from rclpy.lifecycle import LifecycleNode

from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.imu_source import ImuSource
from emoflow_ros.node.outputs import Outputs
from emoflow_ros.node.reports import Level
from emoflow_ros.node.tasks import Loss, Notice, Outcome, Present, Progress, Result, Task
from emoflow_ros.node.throttled import throttled


class Answers:
    """Hands on what comes from the supervisor, in the executor's thread.

    Args:
        node: logs.
        outcomes: of the supervisor.
        statistics: counts.
        outputs: publish.
        imu: told how the gyro did; None if none is used.
    """

    def __init__(
        self,
        node: LifecycleNode,
        outcomes: SimpleQueue[Outcome],
        statistics: Statistics,
        outputs: Outputs,
        imu: ImuSource | None,
    ) -> None:
        self._node = node
        self._outcomes = outcomes
        self._statistics = statistics
        self._outputs = outputs
        self._imu = imu

    def take(self, epoch: int) -> None:
        """Take all that waits; windows of other epochs than the present one are forgotten."""
        while not self._outcomes.empty():
            match self._outcomes.get():
                case Result() as result if self._is_recent(result.task, epoch):
                    self._statistics.add_result(result)
                    if self._imu is not None:
                        self._imu.judge(result.estimate)
                    self._outputs.publish(result)
                case Present() as present if present.task.epoch == epoch:
                    self._statistics.counts["twists_now"] += 1
                    self._outputs.publish_present(present)
                case Loss() as loss:
                    self._report(loss, epoch)
                case Notice(reason):
                    self._node.get_logger().warning(reason)
                    self._statistics.set_problem("device", Level.WARN, reason)
                case Progress(line):
                    self._node.get_logger().info(line)

    def _is_recent(self, task: Task, epoch: int) -> bool:
        """Tell whether a window is of the present epoch; another one is forgotten."""
        recent = task.epoch == epoch
        self._statistics.counts["windows_forgotten"] += not recent
        return recent

    def _report(self, loss: Loss, epoch: int) -> None:
        if loss.task is not None and not self._is_recent(loss.task, epoch):
            loss = replace(loss, task=None)
        self._statistics.add_loss(loss)
        trace = f"\n{loss.trace}" if loss.trace else ""
        self._node.get_logger().error(f"{loss.reason}{trace}", **throttled())
        if loss.task is not None:
            self._outputs.publish_failed(loss.task, loss.reason)
