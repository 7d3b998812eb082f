"""Real ROS nodes in tests, each of them destroyed at a known time."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node


@contextmanager
def ros_context() -> Iterator[Context]:
    """Initialise rclpy in a context; at the end destroy all nodes that were made meanwhile.

    That includes nodes whose constructor raised, which nobody else holds. The garbage collector
    would destroy them at any time, also in the middle of another node's work, and Fast DDS can
    wait for ever there (in DomainParticipant::set_listener).
    """
    context = Context()
    make = Node.__init__
    with ExitStack() as made, pytest.MonkeyPatch.context() as patch:

        def make_and_keep(self: Node, *args: Any, **kwargs: Any) -> None:
            make(self, *args, **kwargs)
            made.callback(destroy, self)

        patch.setattr(Node, "__init__", make_and_keep)
        rclpy.init(context=context)
        made.callback(rclpy.shutdown, context=context)  # after the nodes
        yield context


def destroy(node: Node) -> None:
    """Destroy a node whole: rclpy's destroy_node leaves the state machine of a lifecycle node.

    The state machine has a publisher of its own, and keeps the node alive.
    """
    node.destroy_node()
    state_machine = getattr(node, "_state_machine", None)
    if state_machine is not None:
        state_machine.destroy_when_not_in_use()
