"""The tests' own nodes: none of them is left to the garbage collector."""

from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.lifecycle import LifecycleNode
from ros_nodes import ros_context


def test_node_whose_constructor_raises_is_gone_at_the_end() -> None:
    made: list[LifecycleNode] = []

    class Broken(LifecycleNode):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__("broken", **kwargs)
            made.append(self)
            raise RuntimeError("broken")

    with ros_context() as context:
        with pytest.raises(RuntimeError, match="broken"):
            Broken(context=context, use_global_arguments=False)
        whole = rclpy.create_node("whole", context=context)
        assert set(whole.get_node_names()) == {"broken", "whole"}
    [broken] = made
    for node in (broken, whole):
        with pytest.raises(InvalidHandle), node.handle:
            pass
    with pytest.raises(InvalidHandle), broken._state_machine:
        pass
