"""The topic `/diagnostics`, whatever state the node is in."""

from collections.abc import Callable

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from std_msgs.msg import Header

from emoflow_ros.node.reports import Level, Report

_DEPTH = 10
_IDLE = {
    "unconfigured": "nothing runs until the node is configured and activated",
    "finalized": "the node was shut down; start it anew",
}


class DiagnosticsTopic:
    """Publishes a report again and again, from when the node is made until it is destroyed.

    Args:
        node: to publish with.
        report: makes the report.
        period_s: time between two reports, s; it may be set at any time.
    """

    def __init__(self, node: Node, report: Callable[[], Report], period_s: float) -> None:
        self._node = node
        self._report = report
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", _DEPTH)
        # Also while simulated time stands.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(period_s, self._publish, clock=clock)

    def set_period(self, period_s: float) -> None:
        """Report every so many seconds from now on."""
        self._timer.timer_period_ns = round(period_s * 1e9)

    def _publish(self) -> None:
        name, stamp = self._node.get_fully_qualified_name(), self._node.get_clock().now().to_msg()
        self._publisher.publish(to_diagnostics(name, self._report(), stamp))


def idle_report(state: str, failure: Exception | None) -> Report:
    """Judge a node that is not configured.

    Args:
        state: its lifecycle state.
        failure: why the last transition failed; None if it did not.
    """
    if failure is not None:
        return Report(Level.ERROR, f"{state}: {failure}", {})
    return Report(Level.OK, f"{state}: {_IDLE.get(state, 'nothing runs')}", {})


def to_diagnostics(name: str, report: Report, stamp: Time) -> DiagnosticArray:
    """Build the diagnostics of one node."""
    status = to_status(f"{name}: estimator", name, report)
    return DiagnosticArray(header=Header(stamp=stamp), status=[status])


def to_status(name: str, hardware_id: str, report: Report) -> DiagnosticStatus:
    """Build one status: level, message and numbers of a report."""
    return DiagnosticStatus(
        level=bytes([report.level]),
        name=name,
        message=report.message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in report.values.items()],
    )
