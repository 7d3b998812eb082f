"""The lifecycle node: event messages in, egomotion and optical flow out."""

from queue import SimpleQueue
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo

from emoflow_ros.core.calibration import load_calibration
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.clock import Timestamps
from emoflow_ros.errors import InputError
from emoflow_ros.node import converters
from emoflow_ros.node.calibration_path import calibration_path
from emoflow_ros.node.discovery import EventTopic, TopicSearch
from emoflow_ros.node.event_input import EventInput
from emoflow_ros.node.event_source import Callbacks, EventSource, camera_info_topic
from emoflow_ros.node.outputs import Outputs
from emoflow_ros.node.parameters import NodeOptions, NodeParameters, Settings
from emoflow_ros.node.ros_arguments import refused_in_one_line
from emoflow_ros.node.statistics import Level, Statistics
from emoflow_ros.node.supervisor import FACTORY, Supervisor
from emoflow_ros.node.tasks import Loss, Notice, Outcome, Result, Task
from emoflow_ros.node.transition import transition

_DIAGNOSTICS_DEPTH = 10
_THROTTLE_S = 5.0
# What does not change by itself: a reminder for who reads the log later.
_REMINDER_S = 30.0


class EstimatorNode(LifecycleNode):
    """Listens to events while active, and publishes what the worker makes of them.

    Configuring starts the worker and reads the calibration file; activating looks for the
    event topic and subscribes as soon as the worker is warm. All callbacks and all publishing
    are in the executor's thread.

    Args:
        factory: `module:function` that makes the estimator in the worker.
        **kwargs: as for rclpy's Node.

    Attributes:
        refusal: why the last transition failed.
        is_starting: whether a refusal is raised instead of logged.

    Raises:
        InputError: a parameter has an unknown name or a bad value, or the node cannot start
            with them.
    """

    def __init__(self, factory: str = FACTORY, **kwargs: Any) -> None:
        with refused_in_one_line():
            super().__init__("estimator", **kwargs)
        self.refusal: InputError | None = None
        self.is_starting = False
        self._factory = factory
        self._supervisor: Supervisor | None = None
        self._source: EventSource | None = None
        self._input: EventInput | None = None
        self._camera: Camera | None = None
        self._topic: EventTopic | None = None
        self._encoding = ""
        self._epoch = 0
        self._statistics = Statistics()
        self._outcomes: SimpleQueue[Outcome] = SimpleQueue()
        self._outcome_waits = self.create_guard_condition(self._take_outcomes)
        self._table = NodeParameters(
            self,
            is_configured=lambda: self._supervisor is not None,
            on_change=self._apply_settings,
        )
        if self._settings.node.autostart:
            self.is_starting = True
            self.trigger_configure()
            if self.refusal is not None:
                raise self.refusal
            self.is_starting = False
            self.trigger_activate()

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, as rclpy does; the node's dump can be loaded as it is."""
        return self._table.set_atomically(parameter_list, super().set_parameters_atomically)

    @property
    def _settings(self) -> Settings:
        return self._table.settings

    @transition
    def on_configure(self, state: LifecycleState) -> None:
        """Read the calibration file if there is one, make the publishers, start the worker."""
        options = self._settings.node
        path = options.camera.calibration_file
        self._camera = load_calibration(calibration_path(path)) if path else None
        self._supervisor = self._make_supervisor(options)
        self._statistics = Statistics()
        self._outputs = Outputs(self, options, self._statistics)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "/diagnostics", _DIAGNOSTICS_DEPTH
        )
        self._diagnostics_timer = self.create_timer(
            options.output.diagnostics_s,
            self._publish_diagnostics,
            clock=Clock(clock_type=ClockType.STEADY_TIME),  # also while simulated time stands still
        )
        if self._camera is not None:
            self._supervisor.configure(self._camera, self._settings.config)
        self._supervisor.start()

    @transition
    def on_activate(self, state: LifecycleState) -> None:
        """Look for events."""
        assert self._supervisor is not None
        super().on_activate(state)
        options = self._settings.node.camera
        self._source = EventSource(
            self,
            search=TopicSearch(self, self._settings.node.input.type),
            is_ready=self._supervisor.ready.is_set,
            callbacks=Callbacks(
                topic=self._take_topic,
                events=self._take_events,
                camera_info=None if options.calibration_file else self._take_camera_info,
            ),
            statistics=self._statistics,
        )

    @transition
    def on_deactivate(self, state: LifecycleState) -> None:
        """Listen no longer and forget the windows that wait."""
        assert self._supervisor is not None
        self._stop_listening()
        self._supervisor.queue.clear()
        super().on_deactivate(state)

    @transition
    def on_cleanup(self, state: LifecycleState) -> None:
        """End the worker and take the topics away."""
        self._release()

    @transition
    def on_shutdown(self, state: LifecycleState) -> None:
        """Do what deactivating and cleaning up do."""
        self._release()

    def destroy_node(self) -> None:
        """End the worker, whatever state the node is in, and destroy the node."""
        self._stop_listening()
        if self._supervisor is not None:
            self._supervisor.stop()
        super().destroy_node()

    def _make_supervisor(self, options: NodeOptions) -> Supervisor:
        """Make the supervisor, and wait for the worker if that may refuse its device."""
        supervisor = Supervisor(
            capacity=options.input.queue_windows,
            timeout_s=options.output.timeout_s,
            may_use_cpu=options.on_missing_device == "cpu",
            on_outcome=self._hand_over,
            factory=self._factory,
        )
        config = self._settings.config
        if options.on_missing_device == "refuse" and config.estimator.device != "cpu":
            supervisor.check(config)
        return supervisor

    def _stop_listening(self) -> None:
        if self._source is not None:
            self._source.stop()
        self._source = self._input = None

    def _release(self) -> None:
        self._stop_listening()
        if self._supervisor is None:
            return
        self._supervisor.stop()
        self._supervisor = None
        self.destroy_timer(self._diagnostics_timer)
        self.destroy_publisher(self._diagnostics)
        self._outputs.destroy()

    def _apply_settings(self, settings: Settings) -> None:
        """Take new settings for the next window."""
        if self._supervisor is not None:
            self._outputs.set_scale(settings.node.scale)
        if self._input is not None:
            self._input.set_policy(settings.config.window)
        if self._supervisor is not None and self._camera is not None:
            self._supervisor.configure(self._camera, settings.config)

    def _take_topic(self, topic: EventTopic) -> None:
        assert self._supervisor is not None
        settings = self._settings
        if topic != self._topic and not settings.node.camera.calibration_file:
            self._camera = None
            self._supervisor.unconfigure()
        self._topic = topic
        self._input = EventInput(
            topic.type,
            settings.config.window,
            timestamps=Timestamps(settings.node.input.timestamps),
            frame_id=settings.node.camera.frame_id,
            statistics=self._statistics,
            warn=lambda line: self.get_logger().warning(line, throttle_duration_sec=_THROTTLE_S),
            epoch=self._epoch + 1,
        )
        self._input.camera = self._camera
        self._epoch = self._input.epoch
        self._encoding = ""
        self.get_logger().info(f"listening to {topic.name} ({topic.type})")
        if self._camera is None:
            self._statistics.set_problem("camera", Level.ERROR, self._missing_calibration(topic))

    def _missing_calibration(self, topic: EventTopic) -> str:
        wanted = camera_info_topic(self, topic)
        return f"no calibration yet: publish {wanted} or give camera.calibration_file"

    def _take_events(self, data: bytes) -> None:
        if self._input is None or self._supervisor is None:
            return
        tasks = self._input.push(data)
        if self._input.encoding and not self._encoding:
            self._encoding = self._input.encoding
            self.get_logger().info(f"events are encoded as {self._encoding}")
        if self._input.epoch != self._epoch:
            self._epoch = self._input.epoch
            self._supervisor.queue.clear()
            self.get_logger().info(
                f"{self._input.jump}: the estimation starts anew",
                throttle_duration_sec=_THROTTLE_S,
            )
        if tasks:
            self._supervisor.wishes = self._outputs.wishes
            if self._camera is None and self._topic is not None:
                self.get_logger().warning(
                    f"windows wait: {self._missing_calibration(self._topic)}",
                    throttle_duration_sec=_REMINDER_S,
                )
        for task in tasks:
            dropped = self._supervisor.queue.put(task)
            if dropped is not None:
                self._statistics.add_dropped(dropped)
                self._outputs.publish_dropped(dropped)

    def _take_camera_info(self, info: CameraInfo) -> None:
        assert self._supervisor is not None
        try:
            camera = converters.to_camera(info)
        except InputError as error:
            self._statistics.set_problem("camera", Level.ERROR, f"camera_info: {error}")
            self.get_logger().error(f"camera_info: {error}", throttle_duration_sec=_THROTTLE_S)
            return
        self._statistics.clear_problem("camera")
        if camera == self._camera:
            return
        if self._input is not None:
            if self._input.size not in (None, camera.size):
                self._supervisor.queue.clear()  # windows of another sensor
            self._input.camera = camera
        self._camera = camera
        self._supervisor.configure(camera, self._settings.config)
        self.get_logger().info(f"calibration: {camera.width}x{camera.height}, {camera.model}")

    def _hand_over(self, outcome: Outcome) -> None:
        """Bring an outcome from the supervisor's thread into the executor's."""
        self._outcomes.put(outcome)
        self._outcome_waits.trigger()

    def _take_outcomes(self) -> None:
        while not self._outcomes.empty():
            match self._outcomes.get():
                case Result() as result:
                    self._publish(result)
                case Loss() as loss:
                    self._report(loss)
                case Notice(reason):
                    self.get_logger().warning(reason)
                    self._statistics.set_problem("device", Level.WARN, reason)

    def _publish(self, result: Result) -> None:
        if self._is_current(result.task):
            self._statistics.add_result(result)
            self._outputs.publish(result)

    def _report(self, loss: Loss) -> None:
        self._statistics.add_loss(loss)
        self.get_logger().error(loss.reason, throttle_duration_sec=_THROTTLE_S)
        if loss.task is not None and self._is_current(loss.task):
            self._outputs.publish_failed(loss.task, loss.reason)

    def _is_current(self, task: Task) -> bool:
        """Whether the task is of this run of event time and the topics are there."""
        return self._supervisor is not None and task.epoch == self._epoch

    def _publish_diagnostics(self) -> None:
        worker = None if self._supervisor is None else self._supervisor.pid
        report = self._statistics.report(self._settings.node.input.silence_s, worker)
        stamp = self.get_clock().now().to_msg()
        name = self.get_fully_qualified_name()
        self._diagnostics.publish(converters.to_diagnostics(name, report, stamp))
