"""The lifecycle node: event messages in, egomotion and optical flow out."""

from contextlib import ExitStack
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from emoflow_ros.node import converters
from emoflow_ros.node.discovery import TopicSearch
from emoflow_ros.node.event_source import Callbacks, EventSource
from emoflow_ros.node.parameters import NodeParameters, Settings
from emoflow_ros.node.pipeline import Pipeline
from emoflow_ros.node.ros_arguments import refused_in_one_line
from emoflow_ros.node.supervisor import FACTORY
from emoflow_ros.node.transition import answer_every_wish, log_error, transition

_DIAGNOSTICS_DEPTH = 10


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
        # What configuring and activating have made, to be taken back in the opposite order.
        self._configured = ExitStack()
        self._activated = ExitStack()
        self._outcome_waits = self.create_guard_condition(self._take_outcomes)
        self._table = NodeParameters(
            self,
            is_configured=lambda: self._pipeline is not None,
            on_change=self._apply_settings,
        )
        answer_every_wish(self)
        if self._settings.node.autostart:
            self._start()

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, as rclpy does; the node's dump can be loaded as it is."""
        return self._table.set_atomically(parameter_list, super().set_parameters_atomically)

    @property
    def _settings(self) -> Settings:
        return self._table.settings

    def _start(self) -> None:
        """Configure and activate; raise what keeps one of them from it."""
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
            self._diagnostics = self.create_publisher(
                DiagnosticArray, "/diagnostics", _DIAGNOSTICS_DEPTH
            )
            made.callback(self.destroy_publisher, self._diagnostics)
            timer = self.create_timer(
                self._settings.node.output.diagnostics_s,
                self._publish_diagnostics,
                clock=Clock(clock_type=ClockType.STEADY_TIME),  # also while simulated time stands
            )
            made.callback(self.destroy_timer, timer)
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
                is_ready=lambda: pipeline.is_ready,
                is_used=lambda: pipeline.is_topic_used,
                callbacks=Callbacks(
                    topic=pipeline.take_topic,
                    events=pipeline.take_events,
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
        """Leave nothing after a transition that ended in an error: the node is unconfigured."""
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
        """Take back what was made, all of it, also where a part of that fails."""
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

    def _publish_diagnostics(self) -> None:
        if self._pipeline is None:
            return
        report = self._pipeline.report()
        stamp = self.get_clock().now().to_msg()
        name = self.get_fully_qualified_name()
        self._diagnostics.publish(converters.to_diagnostics(name, report, stamp))
