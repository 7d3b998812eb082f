"""The lifecycle node: its transitions, and the loop that runs its callbacks until the end."""

import contextlib
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from emoflow_ros.node.diagnostics_topic import DiagnosticsTopic, idle_report
from emoflow_ros.node.event_source import Callbacks, EventSource
from emoflow_ros.node.neighbours import Neighbours
from emoflow_ros.node.parameters import NodeParameters
from emoflow_ros.node.pipeline import Pipeline
from emoflow_ros.node.reports import Report
from emoflow_ros.node.ros_arguments import refused_in_one_line
from emoflow_ros.node.settings import Settings
from emoflow_ros.node.supervisor import FACTORY
from emoflow_ros.node.topic_search import TopicSearch
from emoflow_ros.node.transitions import log_error, refuse_impossible_transitions, transition


def run_node(factory: str, give_end: Callable[[Callable[[], None]], None]) -> None:
    """Make the node, run it until the end is asked for, and destroy it.

    Args:
        factory: `module:function` that makes the estimator in the worker.
        give_end: gets the function that asks for the end, from any thread.

    Raises:
        InputError: ROS or the node cannot start with the ROS arguments of the command line.
    """
    node = None
    try:
        with refused_in_one_line():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = EstimatorNode(factory)
        spin_until_asked(node, give_end)
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown()


def spin_until_asked(node: Node, give_end: Callable[[Callable[[], None]], None]) -> None:
    """Run a node's callbacks until the end is asked for; the arguments are those of `run_node`.

    rclpy's spin_until_future_complete keeps a function for every callback that it has run.
    """
    is_asked = False

    def end() -> None:
        nonlocal is_asked
        is_asked = True

    wish = node.create_guard_condition(end)

    def ask() -> None:
        with contextlib.suppress(InvalidHandle):  # the node is gone already
            wish.trigger()

    # Not left to the garbage collector: if that destroys its parts first, a traceback is printed.
    with SingleThreadedExecutor(context=node.context) as executor:
        executor.add_node(node)
        give_end(ask)
        while not is_asked:
            executor.spin_once()


class EstimatorNode(LifecycleNode):
    """Listens to events while active, and publishes what the worker makes of them.

    Configuring reads the calibration file and starts the worker; activating looks for the
    event topic and subscribes as soon as the worker is warm. All callbacks and all publishing
    are in the executor's thread. A transition that fails leaves nothing of what it began.

    Args:
        factory: `module:function` that makes the estimator in the worker.
        **kwargs: as for rclpy's Node.

    Attributes:
        failure: why the last transition failed; None if it did not.
        is_starting: whether a failure is raised instead of logged.

    Raises:
        InputError: a parameter has an unknown name or a bad value, or the node cannot start
            with them.
    """

    def __init__(self, factory: str = FACTORY, **kwargs: Any) -> None:
        with refused_in_one_line():
            super().__init__("estimator", **kwargs)
        self.failure: Exception | None = None
        self.is_starting = False
        self._factory = factory
        self._pipeline: Pipeline | None = None
        # They undo what configuring and activating made, in reverse order.
        self._configured = ExitStack()
        self._activated = ExitStack()
        self._outcome_waits = self.create_guard_condition(self._take_outcomes)
        self._table = NodeParameters(
            self,
            is_configured=lambda: self._pipeline is not None,
            on_change=self._apply_settings,
        )
        refuse_impossible_transitions(self)
        self._neighbours = Neighbours(self)
        self._diagnostics = DiagnosticsTopic(
            self, self._report, self._settings.node.output.diagnostics_s
        )
        if self._settings.node.autostart:
            self._start()

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, as rclpy does; the node's dump can be loaded as it is."""
        return self._table.set_atomically(parameter_list, super().set_parameters_atomically)

    @property
    def _settings(self) -> Settings:
        return self._table.settings

    def _start(self) -> None:
        """Configure and activate; raise the exception of the one that fails."""
        self.is_starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            trigger()
            if self.failure is not None:
                raise self.failure
        self.is_starting = False

    @transition
    def on_configure(self, state: LifecycleState) -> None:
        """Read the calibration file if there is one, make the publishers, start the worker."""
        with ExitStack() as made:
            pipeline = Pipeline(
                self,
                self._settings,
                factory=self._factory,
                wake=self._outcome_waits.trigger,
                made=made,
            )
            self._diagnostics.set_period(self._settings.node.output.diagnostics_s)
            pipeline.start()
            self._configured = made.pop_all()
        self._pipeline = pipeline

    @transition
    def on_activate(self, state: LifecycleState) -> None:
        """Look for events."""
        pipeline = self._pipeline
        assert pipeline is not None
        with ExitStack() as made:
            made.callback(super().on_deactivate, state)
            super().on_activate(state)
            made.callback(pipeline.pause)
            source = EventSource(
                self,
                search=TopicSearch(self, self._settings.node.input.type),
                obstacle=lambda: pipeline.obstacle,
                is_used=lambda: pipeline.is_topic_used,
                length_ns=lambda: self._settings.backlog_ns,
                callbacks=Callbacks(
                    topic=pipeline.take_topic,
                    events=pipeline.take_events,
                    end_turn=pipeline.cut_windows,
                    skip=pipeline.skip,
                    camera_info=pipeline.take_camera_info if pipeline.hears_camera_info else None,
                ),
                statistics=pipeline.statistics,
            )
            made.callback(source.stop)
            self._activated = made.pop_all()

    @transition
    def on_deactivate(self, state: LifecycleState) -> None:
        """Listen no longer and forget the windows that wait."""
        self._activated.close()

    @transition
    def on_cleanup(self, state: LifecycleState) -> None:
        """End the worker and take the topics away."""
        self._release()

    @transition
    def on_shutdown(self, state: LifecycleState) -> None:
        """Do what deactivating and cleaning up do."""
        self._release()

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo everything after a transition that ended in an error: the node is unconfigured."""
        try:
            self._release()
        except Exception as error:
            log_error(self, "cleaning up after it", error)
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """End the worker, whatever state the node is in, and destroy the node."""
        try:
            self._release()
        finally:
            super().destroy_node()

    def _release(self) -> None:
        """Undo all that was made, even if a part of that fails."""
        self._pipeline = None
        with self._configured, self._activated:
            pass

    def _apply_settings(self, settings: Settings) -> None:
        """Take new settings for the next window."""
        if self._pipeline is not None:
            self._pipeline.set_settings(settings)

    def _take_outcomes(self) -> None:
        if self._pipeline is not None:
            self._pipeline.take_outcomes()

    def _report(self) -> Report:
        if self._pipeline is None:
            return idle_report(self._state_machine.current_state[1], self.failure)
        self._neighbours.look(self._pipeline.statistics)
        return self._pipeline.report()
