"""What `make demo` says where the node was late."""

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from emoflow_ros.commands.demo import Collected


def diagnostics(**values: str) -> DiagnosticArray:
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticArray(status=[DiagnosticStatus(), DiagnosticStatus(values=pairs)])


def test_a_late_node_is_named_with_the_least_share_of_events():
    collected = Collected()
    collected.note_share(diagnostics(windows="3", events_share="1"))
    assert collected.remark == ""
    for share in ("0.5", "1"):
        collected.note_share(diagnostics(events_share=share))
    assert "50 % of their events" in collected.remark
