"""Lifecycle transitions that fail at each of their steps: what is left, and what is said."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_supervisor import FakeSupervisor, install_fake_supervisor
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.context import Context
from rclpy.lifecycle import LifecyclePublisher, TransitionCallbackReturn
from rclpy.parameter import Parameter
from ros_nodes import ros_context

from emoflow_ros.errors import InputError
from emoflow_ros.node import estimator_node, event_source, outputs, pipeline, transitions
from emoflow_ros.node.estimator_node import EstimatorNode
from emoflow_ros.node.supervisor import STARTING
from emoflow_ros.node.tasks import DropOldestQueue

SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
ERROR = TransitionCallbackReturn.ERROR

type Break = Callable[[pytest.MonkeyPatch, "Bench"], None]


class Bench:
    """An unconfigured node without a worker."""

    def __init__(self, context: Context, patch: pytest.MonkeyPatch, **values: Any) -> None:
        self.supervisors = install_fake_supervisor(patch)
        self.log: list[str] = []
        self.node = EstimatorNode(
            context=context,
            use_global_arguments=False,
            parameter_overrides=[Parameter(n, value=v) for n, v in values.items()],
        )
        patch.setattr(self.node, "get_logger", lambda: self)
        self.before = self.entities()

    def error(self, line: str, **kwargs: Any) -> None:
        self.log.append(line)

    warning = error

    def info(self, line: str, **kwargs: Any) -> None:
        assert line == STARTING

    @property
    def state(self) -> str:
        return str(self.node._state_machine.current_state[1])

    def entities(self) -> tuple[int, ...]:
        n = self.node
        kinds = (n.publishers, n.subscriptions, n.timers, n._managed_entities)
        return tuple(len(list(kind)) for kind in kinds)

    def set(self, **values: Any) -> bool:
        wish = [Parameter(n.replace("__", "."), value=v) for n, v in values.items()]
        return all(result.successful for result in self.node.set_parameters(wish))

    def is_as_before(self) -> bool:
        """Whether it is unconfigured, with nothing left, and would run."""
        assert self.state == "unconfigured"
        assert self.entities() == self.before
        assert not any(supervisor.running for supervisor in self.supervisors)
        assert self.set(output__target_frame="", camera__calibration_file="")
        assert self.node.trigger_configure() == SUCCESS
        assert self.node.trigger_activate() == SUCCESS
        assert self.supervisors[-1].running
        assert self.node.trigger_shutdown() == SUCCESS
        return not self.supervisors[-1].running


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    with ros_context() as context:
        yield Bench(context, monkeypatch, autostart=False)


def broken(*args: Any, **kwargs: Any) -> Any:
    raise RuntimeError("broken")


def refused(*args: Any, **kwargs: Any) -> Any:
    raise InputError("it", "is bad", "mend it")


def at_call(number: int, function: Callable[..., Any]) -> Callable[..., Any]:
    """Let a call, counted from 1, fail."""
    calls = iter(range(1, 100))

    def counted(*args: Any, **kwargs: Any) -> Any:
        return (broken if next(calls) == number else function)(*args, **kwargs)

    return counted


def replaced(owner: Any, name: str, stand_in: Callable[..., Any] = broken) -> Break:
    return lambda patch, bench: patch.setattr(owner, name, stand_in)


def of_node(name: str, number: int = 1) -> Break:
    """Let a method of the node fail at one of its calls."""

    def apply(patch: pytest.MonkeyPatch, bench: Bench) -> None:
        patch.setattr(bench.node, name, at_call(number, getattr(bench.node, name)))

    return apply


BAD_INPUT: dict[str, dict[str, Any]] = {
    "calibration": {"camera__calibration_file": "/nowhere.yaml"},
    "tf": {"output__target_frame": "base"},
}
CONFIGURING: dict[str, Break] = {
    "supervisor": replaced(pipeline, "Supervisor"),
    "twists": replaced(outputs, "TwistOutput"),
    "scale": replaced(outputs, "Scale"),
    **{f"topic {n}": of_node("create_lifecycle_publisher", n) for n in range(1, 9)},
    "thread": replaced(FakeSupervisor, "start"),
}
ACTIVATING: dict[str, Break] = {
    "publisher": replaced(LifecyclePublisher, "on_activate"),
    "search": replaced(estimator_node, "TopicSearch"),
    "source": replaced(estimator_node, "EventSource"),
    "timer": of_node("create_timer"),
}
PAUSING: dict[str, Break] = {
    "source": replaced(event_source.EventSource, "_unsubscribe"),
    "queue": replaced(DropOldestQueue, "clear"),
    "publisher": replaced(LifecyclePublisher, "on_deactivate"),
}
RELEASING: dict[str, Break] = {
    "scale": replaced(outputs.Scale, "close"),
    "topic": of_node("destroy_lifecycle_publisher", 3),
    "thread": replaced(FakeSupervisor, "stop"),
}


def each(breaks: dict[str, Any]) -> Any:
    return pytest.mark.parametrize("fail", breaks.values(), ids=breaks.keys())


@each(BAD_INPUT)
def test_configuring_with_bad_input_leaves_nothing(bench: Bench, fail: dict[str, Any]) -> None:
    assert bench.set(**fail) and bench.node.trigger_configure() == FAILURE
    assert len(bench.log) == 1
    assert bench.is_as_before()


def test_configuring_without_the_device_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    with ros_context() as context:
        wishes = {"on_missing_device": "refuse", "estimator.device": "cuda", "profile": "paper"}
        bench = Bench(context, monkeypatch, autostart=False, **wishes)
        monkeypatch.setattr(FakeSupervisor, "check", refused)
        assert bench.node.trigger_configure() == FAILURE
        assert bench.log == ["it: is bad; mend it"]
        assert bench.set(on_missing_device="cpu") and bench.is_as_before()


@each(CONFIGURING)
def test_configuring_that_breaks_at_any_step_leaves_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, fail: Break
) -> None:
    with monkeypatch.context() as patch:
        fail(patch, bench)
        assert bench.node.trigger_configure() == ERROR
    [line] = bench.log
    assert line.startswith("on_configure failed: RuntimeError: broken\nTraceback")
    assert bench.is_as_before()


@each(ACTIVATING)
def test_activating_that_breaks_at_any_step_leaves_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, fail: Break
) -> None:
    bench.node.trigger_configure()
    with monkeypatch.context() as patch:
        fail(patch, bench)
        assert bench.node.trigger_activate() == ERROR
    assert bench.log[0].startswith("on_activate failed: RuntimeError: broken\nTraceback")
    assert bench.is_as_before()


def test_activating_with_bad_input_leaves_the_node_inactive(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.node.trigger_configure()
    configured = bench.entities()
    with monkeypatch.context() as patch:
        patch.setattr(estimator_node, "TopicSearch", refused)
        assert bench.node.trigger_activate() == FAILURE
    assert (bench.state, bench.log) == ("inactive", ["it: is bad; mend it"])
    assert bench.entities() == configured
    assert not any(entity.is_activated for entity in bench.node._managed_entities)
    assert bench.node.trigger_activate() == SUCCESS


@each(PAUSING)
def test_deactivating_that_breaks_at_any_step_leaves_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, fail: Break
) -> None:
    bench.node.trigger_configure()
    bench.node.trigger_activate()
    with monkeypatch.context() as patch:
        fail(patch, bench)
        assert bench.node.trigger_deactivate() == ERROR
    assert bench.log[0].startswith("on_deactivate failed: RuntimeError: broken\nTraceback")
    assert bench.is_as_before()


@each(RELEASING)
def test_cleaning_up_that_breaks_at_any_step_takes_back_the_rest(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, fail: Break
) -> None:
    with monkeypatch.context() as patch:
        fail(patch, bench)
        bench.node.trigger_configure()
        assert bench.node.trigger_cleanup() == ERROR
    assert bench.log[0].startswith("on_cleanup failed: RuntimeError: broken\nTraceback")
    assert_released(bench)


@each(PAUSING | RELEASING)
def test_shutdown_that_breaks_at_any_step_takes_back_the_rest(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, fail: Break
) -> None:
    with monkeypatch.context() as patch:
        fail(patch, bench)
        bench.node.trigger_configure()
        bench.node.trigger_activate()
        assert bench.node.trigger_shutdown() == ERROR
    assert bench.log[0].startswith("on_shutdown failed: RuntimeError: broken\nTraceback")
    assert_released(bench)


def assert_released(bench: Bench) -> None:
    """Nothing is left but what could not be destroyed, and the node would run."""
    assert bench.state == "unconfigured"
    assert sum(bench.entities()) <= sum(bench.before) + 2
    bench.supervisors.clear()
    assert bench.node.trigger_configure() == SUCCESS
    assert bench.node.trigger_activate() == SUCCESS
    assert bench.supervisors[-1].running


def test_autostart_that_breaks_raises_what_broke(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    for owner, name in ((outputs, "TwistOutput"), (estimator_node, "EventSource")):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, broken)
            with pytest.raises(RuntimeError, match="broken"):
                EstimatorNode(context=bench.node.context, use_global_arguments=False)
        assert not bench.supervisors[-1].running


def ask(bench: Bench, **wish: Any) -> bool:
    """Call the service change_state without DDS."""
    request = ChangeState.Request(transition=Transition(**wish))
    answer = bench.node._service_change_state.callback(request, ChangeState.Response())
    return bool(answer.success)


def test_wish_that_is_impossible_is_answered_and_said(bench: Bench) -> None:
    possible = "unconfigured; possible: configure (1), shutdown (5)"
    for wish in ({"id": Transition.TRANSITION_ACTIVATE}, {"id": 250}, {"label": "activate"}):
        assert not ask(bench, **wish)
        assert f"transition {next(iter(wish.values()))} is refused: the node is {possible}" in (
            bench.log.pop()
        )
    assert ask(bench, id=Transition.TRANSITION_CONFIGURE)
    assert ask(bench, label="activate")
    assert not ask(bench, id=Transition.TRANSITION_CONFIGURE)  # a manager after autostart
    assert "needs autostart:=false" in bench.log.pop()
    assert bench.state == "active"
    assert ask(bench, id=Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert not ask(bench, id=Transition.TRANSITION_CONFIGURE)
    assert "the node is finalized; possible: none" in bench.log.pop()


def test_failed_transition_is_answered(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeSupervisor, "start", broken)
    assert not ask(bench, id=Transition.TRANSITION_CONFIGURE)
    assert bench.state == "unconfigured"


def test_transitions_are_those_of_the_node() -> None:
    """No callback of the lifecycle is left to rclpy, which would say nothing of a failure."""
    for name in ("configure", "activate", "deactivate", "cleanup", "shutdown"):
        callback = getattr(EstimatorNode, f"on_{name}")
        assert callback.__module__ == transitions.__name__
        assert callback.__qualname__.startswith(f"{transitions.transition.__name__}.")
    assert EstimatorNode.on_error.__module__ == estimator_node.__name__
