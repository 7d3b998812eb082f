"""From event messages to what is published: all that a configured node does with windows."""

from collections import deque
from collections.abc import Callable
from contextlib import ExitStack

from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import CameraInfo

from emoflow_ros.config import require_torch
from emoflow_ros.core.geometry.calibration import camera_from_info, load_calibration
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.node.answers import Answers
from emoflow_ros.node.backlog import LeftOut
from emoflow_ros.node.calibration_url import calibration_path
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_input import EventInput
from emoflow_ros.node.event_share import share_of
from emoflow_ros.node.imu_source import ImuSource
from emoflow_ros.node.outputs import Outputs
from emoflow_ros.node.reports import Level, Report
from emoflow_ros.node.settings import Settings
from emoflow_ros.node.supervisor import STARTING, Supervisor
from emoflow_ros.node.tasks import Job, Task
from emoflow_ros.node.throttled import REMINDER_S, throttled
from emoflow_ros.node.topic_search import EventTopic, topic_beside

# Without a twist for this long the diagnostics warn, unless windows are longer.
_TWIST_S = 1.0
_ENDED = (
    "the thread that feeds the worker has ended, its traceback is in the log; "
    "clean up and configure the node, or start it anew"
)
_INACTIVE = "inactive: nothing is listened to until the node is activated"


class Pipeline:
    """Cuts the events of a topic into windows, has them estimated, and publishes the results.

    Windows wait here until there is a calibration. Each then goes to the worker with the camera,
    the configuration and the wishes that hold at that moment. When an epoch ends, the windows on
    their way are forgotten: they are counted and not published. The pipeline runs in the
    executor's thread; the supervisor has a thread of its own.

    Args:
        node: to publish with.
        settings: the values of the parameters.
        factory: `module:function` that makes the estimator in the worker.
        wake: called in the supervisor's thread when `take_outcomes` has something to do.
        made: gets the calls that take the pipeline down.

    Attributes:
        statistics: what is counted, and what is wrong.
        is_topic_used: whether events of the present topic have gone to the worker.
        imu: puts the readings of a gyro beside windows; None if none is used.

    Raises:
        InputError: the calibration file, the device or another setting cannot be used.
    """

    def __init__(
        self, node: LifecycleNode, settings: Settings, *,
        factory: str, wake: Callable[[], None], made: ExitStack,
    ) -> None:  # fmt: skip
        options = settings.node
        if settings.config.method != "lattice":
            require_torch(settings.config)  # else every worker would fail in the same way
        path = options.camera.calibration_file
        self.statistics = Statistics()
        self.is_topic_used = False
        self._node = node
        self._settings = settings
        self._camera = load_calibration(calibration_path(path)) if path else None
        if self._camera is not None:
            node.get_logger().info(f"calibration: {path}: {self._camera.description}")
        self._missing = ""  # why there is no camera
        self._topic: EventTopic | None = None
        self._input: EventInput | None = None
        self._encoding = ""
        self._epoch = 0
        self._waiting: deque[Task] = deque()
        self._supervisor = Supervisor(
            capacity=options.input.queue_windows,
            timeout_s=options.output.timeout_s,
            may_use_cpu=options.on_missing_device == "cpu",
            wake=wake,
            factory=factory,
            nice=options.worker_nice,
        )
        made.callback(self._supervisor.stop)
        if options.on_missing_device == "refuse" and settings.config.device != "cpu":
            self._supervisor.check(settings.config)
        self._outputs = Outputs(node, options, self.statistics, made, present=bool(settings.slices))
        imu = settings.config.imu
        self.imu: ImuSource | None = None
        if imu.use != "off":
            self.imu = ImuSource(node, imu, self._hand_on, self.statistics, made)
        self._answers = Answers(
            node, self._supervisor.outcomes, self.statistics, self._outputs, self.imu
        )
        self.statistics.set_problem("input", Level.OK, _INACTIVE)

    def start(self) -> None:
        """Start the worker."""
        self._supervisor.start()
        self._node.get_logger().info(STARTING)

    @property
    def obstacle(self) -> str:
        """Why the worker takes no window yet; empty once it was warm."""
        return "" if self._supervisor.ready.is_set() else self._supervisor.obstacle or STARTING

    @property
    def hears_camera_info(self) -> bool:
        """Whether the calibration comes from a topic."""
        return not self._settings.node.camera.calibration_file

    def set_settings(self, settings: Settings) -> None:
        """Take new settings for the next window."""
        self._settings = settings
        self._outputs.set_scale(settings.node.scale)
        if self._input is not None:
            self._input.set_budget(share_of(settings.budget, self.statistics.share.part))

    def pause(self) -> None:
        """Forget the topic's unfinished window and the windows that wait."""
        self._input = None
        self._epoch += 1
        self._forget_waiting()
        if self.imu is not None:
            self.imu.stop()
        self.statistics.set_problem("input", Level.OK, _INACTIVE)

    def take_topic(self, topic: EventTopic) -> None:
        """Listen to this topic from now on."""
        settings = self._settings
        if topic != self._topic and self.hears_camera_info:
            self._camera = None
        self._forget_waiting()
        self.is_topic_used = False
        self._topic = topic
        if self.imu is not None:
            self.imu.listen(topic)
        self._epoch += 1
        self._encoding = ""
        self.statistics.stream.listen()
        self._input = EventInput(
            topic.type,
            share_of(settings.budget, self.statistics.share.part),
            settings.slices,
            timestamps=Timestamps(settings.node.input.timestamps),
            frame_id=settings.node.camera.frame_id,
            statistics=self.statistics,
            warn=lambda line: self._node.get_logger().warning(line, **throttled()),
            epoch=self._epoch,
        )
        self._input.camera = self._camera
        self._node.get_logger().info(f"listening to {topic.name} ({topic.type})")
        if self._camera is None:
            self._miss_camera(
                f"no calibration yet: publish {self._info_topic()} or give camera.calibration_file"
            )

    def take_events(self, data: bytes, part: int = 1) -> None:
        """Take a serialised message of the topic, or the first 1/part of its events."""
        if self._input is None:
            return
        self._input.take(data, part)
        if self._input.encoding and not self._encoding:
            self._encoding = self._input.encoding
            self._node.get_logger().info(f"events are encoded as {self._encoding}")

    def cut_windows(self) -> None:
        """Hand on what the messages taken so far complete."""
        if self._input is None:
            return
        groups = self._input.cut()
        if self._input.epoch != self._epoch:
            self._epoch = self._input.epoch
            self._forget_waiting()
            line = f"{self._input.jump}: the estimation starts anew"
            self._node.get_logger().info(line, **throttled())
        if any(not task.is_slice for tasks in groups for task in tasks):
            self._note_load()
        take = self._hand_on if self.imu is None else self.imu.push
        for tasks in groups:
            take(tasks)

    def skip(self, left_out: LeftOut) -> None:
        """Go on behind messages that are left out, as `EventInput.skip` does."""
        if self._input is not None:
            self._input.skip(left_out)

    def take_camera_info(self, info: CameraInfo) -> None:
        """Take a calibration, which may be the one in use."""
        try:
            camera = camera_from_info(info, self._info_topic(), "camera.calibration_file")
        except InputError as error:
            self._miss_camera(str(error))
            self._node.get_logger().error(str(error), **throttled())
            return
        self.statistics.clear_problem("camera")
        if camera != self._camera:
            self._change_camera(camera)

    def take_outcomes(self) -> None:
        """Publish what the worker has done."""
        self._answers.take(self._epoch)

    def report(self) -> Report:
        """Judge the time since the last report."""
        self.take_outcomes()  # also those for which the supervisor could not wake this thread
        if self._supervisor.has_ended:
            self.statistics.set_problem("worker", Level.ERROR, _ENDED)
            self._node.get_logger().error(_ENDED, **throttled(REMINDER_S))
        timeout_s = self._settings.node.output.timeout_s
        self.statistics.clear_problem("busy")
        if hangs := self.statistics.load.hangs(self._supervisor.busy_s, timeout_s):
            self.statistics.set_problem("busy", Level.WARN, hangs)
        if self.imu is not None and self._input is not None:
            self.imu.report()
        window, silence_s = self._settings.config.window, self._settings.node.input.silence_s
        twist_s = max(_TWIST_S, (window.duration_ns + window.stride_ns) / NS_PER_S)
        return self.statistics.report(silence_s, self._supervisor.pid, twist_s=twist_s)

    def _hand_on(self, tasks: list[Task]) -> None:
        """Put tasks into the worker's queues, or let windows wait for a calibration."""
        slices = [task for task in tasks if task.is_slice]
        tasks = [task for task in tasks if not task.is_slice]
        if self._camera is None:
            for task in tasks:
                self._wait(task)
            return
        self._supervisor.slices.put(slices)
        if not tasks:
            return
        self.is_topic_used = True
        part = self.statistics.share.part
        shared = self._camera, self._settings.config, self._outputs.wishes, part
        jobs = [Job(task, *shared) for task in tasks]
        queue = self._supervisor.queue
        if not len(queue):  # else they are dropped perhaps: thinning takes longer than decoding
            jobs = [job.thinned() for job in jobs]
        for left_out in queue.put(jobs):
            self._drop(left_out.task, self._why_slow())

    def _note_load(self) -> None:
        """Note whether windows find the worker busy, once for those that come together."""
        is_busy = self._supervisor.busy_s > 0 and not self._supervisor.obstacle
        if self._camera is not None and self.statistics.share.note(is_busy=is_busy):
            self.set_settings(self._settings)

    def _why_slow(self) -> str:
        settings, supervisor = self._settings, self._supervisor
        return supervisor.obstacle or self.statistics.load.reason(
            supervisor.busy_s,
            settings.node.output.timeout_s,
            on_cpu=settings.config.device == "cpu",
        )

    def _wait(self, task: Task) -> None:
        self._node.get_logger().warning(f"windows wait: {self._missing}", **throttled(REMINDER_S))
        if len(self._waiting) == self._settings.node.input.queue_windows:
            self._drop(self._waiting.popleft(), self._missing)
        self._waiting.append(task)

    def _drop(self, task: Task, reason: str) -> None:
        self.statistics.add_dropped(task, reason)
        self._outputs.publish_dropped(task, reason)

    def _forget_waiting(self) -> None:
        self._supervisor.slices.clear()
        forgotten = len(self._waiting) + self._supervisor.queue.clear()
        forgotten += self.imu.forget() if self.imu is not None else 0
        self._waiting.clear()
        self.statistics.counts["windows_forgotten"] += forgotten

    def _info_topic(self) -> str:
        name = "camera_info"
        return topic_beside(self._node, self._topic, name) if self._topic else name

    def _miss_camera(self, reason: str) -> None:
        self._missing = reason
        self.statistics.set_problem("camera", Level.ERROR, reason)

    def _change_camera(self, camera: Camera) -> None:
        if self._input is not None:
            if self._input.size not in (None, camera.size):
                self._forget_waiting()  # windows of another sensor
            self._input.camera = camera
        self._camera = camera
        self._node.get_logger().info(f"calibration: {camera.description}")
        waiting, self._waiting = list(self._waiting), deque()
        self._hand_on(waiting)
