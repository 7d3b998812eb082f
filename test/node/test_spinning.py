"""The loop that runs the node's callbacks."""

import gc
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_nodes import ros_context

from emoflow_ros.node import estimator_node
from emoflow_ros.node.estimator_node import spin_until_asked

CALLBACKS = 500


@pytest.fixture
def node() -> Iterator[Node]:
    with ros_context() as context:
        yield rclpy.create_node("spinning", context=context)


def test_nothing_is_kept_of_a_callback_that_has_run(node: Node) -> None:
    """A camera's thousand messages a second would add up."""
    objects: list[int] = []
    asks: list[Callable[[], None]] = []
    calls = 0

    def call() -> None:
        nonlocal calls
        calls += 1
        if calls in (CALLBACKS, 2 * CALLBACKS):
            gc.collect()
            objects.append(len(gc.get_objects()))
        if len(objects) == 2:
            asks[0]()
        else:
            again.trigger()

    again = node.create_guard_condition(call)
    again.trigger()
    spin_until_asked(node, asks.append)
    assert objects[1] - objects[0] < CALLBACKS / 10


def test_the_end_is_asked_for_while_nothing_happens_and_may_be_once_more(node: Node) -> None:
    asks: list[Callable[[], None]] = []
    timers: list[threading.Timer] = []

    def give(ask: Callable[[], None]) -> None:
        asks.append(ask)
        timers.append(threading.Timer(0.1, ask))
        timers[0].start()

    spin_until_asked(node, give)
    timers[0].join()
    node.destroy_node()
    asks[0]()  # a signal that comes late


def test_an_end_that_was_asked_for_before_comes_at_once(node: Node) -> None:
    spin_until_asked(node, lambda ask: ask())


def test_destructor_of_the_executor_has_nothing_left_to_do(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The garbage collector may destroy what the executor holds before it: an exception then."""
    made: list[Any] = []

    class Kept(SingleThreadedExecutor):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__(**kwargs)
            made.append((self, self._sigint_gc))

    monkeypatch.setattr(estimator_node, "SingleThreadedExecutor", Kept)
    spin_until_asked(node, lambda ask: ask())
    [(executor, guard)] = made
    guard.__del__()
    executor.__del__()
