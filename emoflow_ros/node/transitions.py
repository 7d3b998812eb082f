"""What rclpy's lifecycle transitions lack: why one failed, and a refusal of impossible ones."""

import traceback
from collections.abc import Callable
from typing import TYPE_CHECKING

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

from emoflow_ros.errors import InputError

if TYPE_CHECKING:
    from emoflow_ros.node.estimator_node import EstimatorNode


def transition(
    body: Callable[["EstimatorNode", LifecycleState], None],
) -> Callable[..., TransitionCallbackReturn]:
    """Make a lifecycle callback that logs why it failed; rclpy would log nothing.

    Bad input is a failure: the node stays in its state. Any other exception is an error, after
    which rclpy calls `on_error`. While the node is being made, nothing is logged: the caller gets
    the exception.
    """

    def callback(self: "EstimatorNode", state: LifecycleState) -> TransitionCallbackReturn:
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


def log_error(node: Node, action: str, error: Exception) -> None:
    """Log an unexpected exception with its traceback."""
    trace = "".join(traceback.format_exception(error))
    node.get_logger().error(f"{action} failed: {type(error).__name__}: {error}\n{trace}")


def refuse_impossible_transitions(node: LifecycleNode) -> None:
    """Let the service change_state refuse what is impossible; rclpy would raise, or say nothing."""
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
