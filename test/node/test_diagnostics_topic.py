"""Diagnostics in every state of the node, and of nodes that share a topic."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from builtin_interfaces.msg import Time
from fake_clock import Clock
from fake_node import FakeNode
from fake_supervisor import install_fake_supervisor
from rclpy.parameter import Parameter
from ros_nodes import ros_context

from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.diagnostics_topic import to_diagnostics
from emoflow_ros.node.estimator_node import EstimatorNode
from emoflow_ros.node.neighbours import Neighbours
from emoflow_ros.node.reports import Level, Report


@pytest.fixture
def make_node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., EstimatorNode]]:
    install_fake_supervisor(monkeypatch)
    with ros_context() as context:

        def make(**values: Any) -> EstimatorNode:
            given = {"autostart": False} | values
            return EstimatorNode(
                context=context,
                use_global_arguments=False,
                parameter_overrides=[
                    Parameter(n.replace("__", "."), value=v) for n, v in given.items()
                ],
            )

        yield make


def said(node: EstimatorNode) -> tuple[Level, str]:
    """What the node's timer publishes now."""
    published: list[Any] = []
    topic: Any = node._diagnostics
    topic._publisher = SimpleNamespace(publish=published.append)
    topic._timer.callback()
    [status] = published[0].status
    return Level(status.level[0]), status.message


def test_diagnostics_come_in_every_state(make_node: Callable[..., EstimatorNode]) -> None:
    node = make_node()
    idle = "nothing runs until the node is configured and activated"
    assert said(node) == (Level.OK, f"unconfigured: {idle}")
    node.trigger_configure()
    assert said(node)[1].startswith("inactive: ")
    node.trigger_activate()
    assert "waiting for events" in said(node)[1] or said(node)[0] is Level.OK
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert said(node) == (Level.OK, f"unconfigured: {idle}")
    node.trigger_shutdown()
    assert said(node) == (Level.OK, "finalized: the node was shut down; start it anew")


def test_reason_for_which_it_cannot_be_configured_is_said(
    make_node: Callable[..., EstimatorNode],
) -> None:
    node = make_node(camera__calibration_file="/nowhere.yaml")
    node.trigger_configure()
    level, message = said(node)
    assert level is Level.ERROR
    assert message.startswith("unconfigured: /nowhere.yaml: no such file or directory; give")
    node.set_parameters([Parameter("camera.calibration_file", value="")])
    node.trigger_configure()
    assert said(node)[1].startswith("inactive: ")


def test_time_between_two_reports_is_that_of_the_configuration(
    make_node: Callable[..., EstimatorNode],
) -> None:
    node = make_node(output__diagnostics_s=0.5)
    timer: Any = node._diagnostics._timer
    assert timer.timer_period_ns == 500_000_000
    node.set_parameters([Parameter("output.diagnostics_s", value=2.0)])
    node.trigger_configure()
    assert timer.timer_period_ns == 2_000_000_000


class Neighbourhood:
    """Nodes that publish /egomotion/twist."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.node: Any = FakeNode()
        self.names = ["/estimator"]
        self.node.get_publishers_info_by_topic = lambda topic: [
            SimpleNamespace(node_namespace=n.rpartition("/")[0] or "/", node_name=n.split("/")[-1])
            for n in self.names
            if topic == "/egomotion/twist"
        ]
        self.statistics = Statistics()
        self.neighbours = Neighbours(self.node, self.clock)

    def wait(self, seconds: int) -> dict[str, tuple[Level, str]]:
        for _ in range(seconds):
            self.neighbours.look(self.statistics)
            self.clock.now += 1.0
        return self.statistics.problems


@pytest.mark.parametrize(
    ("other", "words"),
    [("/estimator", "another node called /estimator"), ("/right/player", "/right/player")],
)
def test_twists_of_somebody_else_on_the_topic_are_said(other: str, words: str) -> None:
    there = Neighbourhood()
    assert there.wait(60) == {}
    there.names.append(other)
    assert there.wait(24) == {}  # it may be a process that was killed
    level, line = there.wait(10)["topic"]
    assert level is Level.WARN
    assert line.startswith(f"/egomotion/twist is also published by {words}: subscribers get both;")
    assert there.node.log == [("warning", line)]
    there.names.remove(other)
    assert there.wait(1) == {}


def test_diagnostics_hold_level_reason_and_numbers() -> None:
    report = Report(Level.WARN, "late", {"windows_ok": "3"})
    message = to_diagnostics("/ns/estimator", report, Time(sec=3))
    [status] = message.status
    assert (status.level, status.message) == (b"\x01", "late")
    assert [(v.key, v.value) for v in status.values] == [("windows_ok", "3")]
    assert message.header.stamp.sec == 3
