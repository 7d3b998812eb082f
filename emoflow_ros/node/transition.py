"""Lifecycle callbacks that say why they failed."""

from collections.abc import Callable
from typing import Any, Protocol

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from emoflow_ros.errors import InputError


class Refusing(Protocol):
    """A node with such callbacks.

    Attributes:
        refusal: why the last transition failed.
        is_starting: whether the node is being made: who makes it gets the refusal, so that the
            log does not say it a second time.
    """

    refusal: InputError | None
    is_starting: bool

    def get_logger(self) -> Any:
        """Return rclpy's logger."""


def transition[N: Refusing](
    body: Callable[[N, LifecycleState], None],
) -> Callable[..., TransitionCallbackReturn]:
    """Make a lifecycle callback that says why it failed: rclpy would say nothing."""

    def callback(self: N, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            body(self, state)
        except InputError as error:
            self.refusal = error
            if not self.is_starting:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    callback.__doc__ = body.__doc__
    return callback
