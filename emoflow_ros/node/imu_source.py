"""The subscription to the IMU, its mounting, and the timers that hand windows on."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu

from emoflow_ros.core.gyro.config import ROTATION_FROM_TF, GyroConfig
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.gyro import GyroState
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_feed import fetch_waiting
from emoflow_ros.node.imu_input import ImuInput, MountingError
from emoflow_ros.node.reports import Level
from emoflow_ros.node.target_frame import LATEST, NoTransformError, TfFrame
from emoflow_ros.node.tasks import Task
from emoflow_ros.node.topic_search import EventTopic, topic_beside

_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT
)
_MOST = 2000  # messages in one fetch
_FETCH_S = 0.05  # between events, so that the middleware's history does not overflow
_LOOK_S = 0.004  # while a window waits


class ImuSource:
    """Puts the readings of the topic `imu` beside windows.

    Args:
        node: subscribes, and listens to tf.
        config: of the gyro; its `use` is not off.
        hand_on: gets windows that wait no longer.
        statistics: told what is wrong with the gyro.
        made: gets the calls that take this down.

    Raises:
        InputError: the mounting is to come from tf, and tf2_ros is not installed.
    """

    def __init__(
        self,
        node: LifecycleNode,
        config: GyroConfig,
        hand_on: Callable[[list[Task]], None],
        statistics: Statistics,
        made: ExitStack,
    ) -> None:
        self._node = node
        self._hand_on = hand_on
        self._statistics = statistics
        self._level = Level.ERROR if config.use == "require" else Level.WARN
        self._topic = ""
        self._subscription: PolledSubscription | None = None
        self._config = config
        self._tf: TfFrame | None = None
        if config.rotation == ROTATION_FROM_TF:
            self._tf = TfFrame(node, "", "imu.rotation", "give imu.rotation as roll,pitch,yaw")
            made.callback(self._tf.close)
        self._input = ImuInput(config, self._mounting)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        fetching = node.create_timer(_FETCH_S, self._release, clock=steady)
        self._looking = node.create_timer(_LOOK_S, self._look, clock=steady)
        self._looking.cancel()
        for timer in (fetching, self._looking):
            made.callback(node.destroy_timer, timer)
        made.callback(self.stop)

    def listen(self, topic: EventTopic) -> None:
        """Take the IMU beside this event topic from now on."""
        self.stop()
        self._input.start_over()
        self._topic = topic_beside(self._node, topic, "imu")
        self._subscription = PolledSubscription(
            self._node, Imu, self._topic, _QOS, self._input.take
        )

    def stop(self) -> None:
        """Unsubscribe."""
        if self._subscription is not None:
            self._subscription.close()
        self._subscription = None
        self._topic = ""
        self._statistics.clear_problem("gyro")

    def push(self, tasks: list[Task]) -> None:
        """Take windows; they are handed on with their readings, at once or a little later."""
        self._input.hold(tasks)
        self._release()
        if self._input.is_waited_for:
            self._looking.reset()

    def forget(self) -> int:
        """Forget the windows that wait; return how many."""
        return self._input.forget()

    def judge(self, estimate: Estimate) -> None:
        """Note what became of the gyro in an estimate."""
        if found := self._input.learn(estimate):
            self._node.get_logger().info(found)
        if estimate.gyro.state is GyroState.REJECTED:
            self._statistics.set_problem("gyro", self._level, f"gyro: {estimate.gyro}")
        elif estimate.gyro.state is GyroState.USED:
            self._statistics.clear_problem("gyro")

    def report(self) -> None:
        """Note what is wrong with the messages."""
        if not self._topic:
            return
        if problem := self._input.problem(self._topic):
            self._statistics.set_problem("gyro", self._level, f"gyro: {problem}")

    def _look(self) -> None:
        self._release()
        if not self._input.is_waited_for:
            self._looking.cancel()

    def _release(self) -> None:
        if self._subscription is not None:
            self._subscription.fetch()
        self._input.event_delay_ns = round(self._statistics.event_delay_s * NS_PER_S)
        if tasks := self._input.ready():
            self._hand_on(tasks)

    def _mounting(self, imu_frame: str, optical_frame: str) -> NDArray[np.float64]:
        if self._tf is None:
            return self._config.matrix()
        try:
            return self._tf.between(optical_frame, imu_frame, LATEST)
        except NoTransformError as error:
            raise MountingError(str(error)) from None


class PolledSubscription:
    """A subscription whose serialised messages are fetched, many at a time.

    An ordinary subscription costs a turn of the executor per message. On a busy machine a turn
    takes more than 1 ms: at 1000 messages per second such a subscription falls further and further
    behind. Between two fetches the middleware keeps as many messages as `qos` says.

    Args:
        node: to subscribe with.
        message_type: class of the messages.
        topic: its name.
        qos: its depth has to hold what comes between two calls of `fetch`.
        take: gets each message.
    """

    def __init__(
        self,
        node: Node,
        message_type: Any,
        topic: str,
        qos: QoSProfile,
        take: Callable[[bytes], None],
    ) -> None:
        self._node = node
        self._take = take
        self._subscription = node.create_subscription(
            message_type,
            topic,
            take,
            qos,
            callback_group=_NeverCalled(),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            raw=True,
        )

    def fetch(self) -> None:
        """Hand on the messages that have come."""
        for data in fetch_waiting(self._subscription, _MOST):
            self._take(data)

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)


class _NeverCalled(CallbackGroup):
    """The executor never calls back for anything in this group."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: nothing begins."""
