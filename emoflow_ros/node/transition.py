"""Lifecycle callbacks that say why they failed, and a service that always answers."""

import traceback
from collections.abc import Callable
from typing import Any, Protocol

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from emoflow_ros.errors import InputError


class Failing(Protocol):
    """A node with such callbacks.

    Attributes:
        failure: why the last transition failed; None if it did not.
        is_starting: whether the node is being made: who makes it gets the failure, so that the
            log does not say it a second time.
    """

    failure: Exception | None
    is_starting: bool

    def get_logger(self) -> Any:
        """Return rclpy's logger."""


def transition[N: Failing](
    body: Callable[[N, LifecycleState], None],
) -> Callable[..., TransitionCallbackReturn]:
    """Make a lifecycle callback that says why it failed: rclpy would say nothing.

    Bad input is a failure, after which the node is in the state that it was in; any other
    exception is an error, after which rclpy calls `on_error`.
    """

    def callback(self: N, state: LifecycleState) -> TransitionCallbackReturn:
        self.failure = None
        try:
            body(self, state)
        except InputError as error:
            self.failure = error
            if not self.is_starting:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.failure = error
            if not self.is_starting:
                log_error(self, body.__name__, error)
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    callback.__doc__ = body.__doc__
    return callback


def log_error(node: Failing, action: str, error: Exception) -> None:
    """Log an exception that nobody expects, with its traceback."""
    trace = "".join(traceback.format_exception(error))
    node.get_logger().error(f"{action} failed: {type(error).__name__}: {error}\n{trace}")


def answer_every_wish(node: LifecycleNode) -> None:
    """Let the service change_state refuse what is impossible: rclpy would raise, or say nothing."""
    service = node._service_change_state
    change = service.callback

    def answer(
        request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        wish = request.transition
        machine = node._state_machine
        possible = {number: label for number, label, *_ in machine.available_transitions}
        if wish.label in possible.values() if wish.label else wish.id in possible:
            return change(request, response)
        choices = ", ".join(f"{label} ({number})" for number, label in sorted(possible.items()))
        node.get_logger().error(
            f"change_state: transition {wish.label or wish.id} is refused: the node is "
            f"{machine.current_state[1]}; possible: {choices or 'none'}. A node that a manager "
            "configures needs autostart:=false"
        )
        response.success = False
        return response

    service.callback = answer
