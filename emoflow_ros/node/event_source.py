"""The subscriptions to events and camera_info, made as soon as the event topic is found."""

from collections.abc import Callable
from dataclasses import dataclass

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo

from emoflow_ros.errors import InputError
from emoflow_ros.node.backlog import LeftOut
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_feed import EventFeed, fetch_waiting
from emoflow_ros.node.reports import Level
from emoflow_ros.node.ros_arguments import refused_values
from emoflow_ros.node.throttled import throttled
from emoflow_ros.node.topic_search import (
    EventTopic,
    TopicSearch,
    import_message_type,
    topic_beside,
)

# 0.25 s of messages of 1 ms; by default the backlog keeps 0.2 s. At 50 million events per second
# such a message has 220 kB: 1000 would hold 220 MB.
_EVENT_DEPTH = 250
_CAMERA_INFO_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_POLICIES = QoSOverridingOptions.with_default_policies().policy_kinds
_LOOK_S = 0.1


@dataclass(frozen=True)
class Callbacks:
    """The functions that take what comes.

    Attributes:
        topic: told which topic was found; again if it turns out to be another one.
        events: each serialised event message, and n where only its first n-th is to be decoded.
        end_turn: called after some messages, before the executor runs other callbacks.
        skip: told when messages before the next one are left out.
        camera_info: each calibration; None if the node has one.
    """

    topic: Callable[[EventTopic], None]
    events: Callable[[bytes, int], None]
    end_turn: Callable[[], None]
    skip: Callable[[LeftOut], None]
    camera_info: Callable[[CameraInfo], None] | None


class EventSource:
    """Looks for the event topic until it is there, then subscribes.

    A topic that the user did not name can be given up again: before its first event, if another
    event topic appears, so that the user has to choose; and until its events are used, if
    somebody publishes `events`. After that, other topics are only named in the log.

    Args:
        node: to subscribe with.
        search: decides what to listen to.
        obstacle: why messages cannot be taken yet; empty once they can.
        is_used: whether events of the present topic have been used, and would now be mixed with
            those of another one.
        length_ns: how much event time messages may cover while they wait, ns.
        callbacks: take what comes.
        statistics: told while there is no topic.
    """

    def __init__(
        self,
        node: Node,
        *,
        search: TopicSearch,
        obstacle: Callable[[], str],
        is_used: Callable[[], bool],
        length_ns: Callable[[], int],
        callbacks: Callbacks,
        statistics: Statistics,
    ) -> None:
        self._node = node
        self._obstacle = obstacle
        self._is_used = is_used
        self._length_ns = length_ns
        self._callbacks = callbacks
        self._statistics = statistics
        self._search = search
        self._subscriptions: list[Subscription] = []
        self._feed: EventFeed | None = None
        self._topic: EventTopic | None = None
        self._again: Timer | None = None  # until it is subscribed anew
        self._hears_events = False
        self._named: list[str] = []
        # Looking must go on while a simulated clock stands still, for example before a replay.
        self._timer = node.create_timer(
            _LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def stop(self) -> None:
        """Unsubscribe, and look no longer."""
        self._node.destroy_timer(self._timer)
        self._unsubscribe()
        self._statistics.clear_problem("input")

    def _look(self) -> None:
        with refused_values():  # of qos_overrides; they cannot change, so this ends the node
            self._look_once()

    def _look_once(self) -> None:
        if obstacle := self._obstacle():
            level = Level.ERROR if self._statistics.counts["worker_restarts"] else Level.WARN
            self._statistics.set_problem("input", level, obstacle)
            return
        if self._hears_events and (self._is_used() or not self._search.has_own()):
            self._name_others()
            return
        try:
            topic = self._search.look()
            if topic is not None and topic != self._topic:
                self._unsubscribe()
                self._subscribe(topic)
        except InputError as error:
            self._unsubscribe()
            self._statistics.set_problem("input", Level.ERROR, str(error))
            self._node.get_logger().error(str(error), **throttled())
            return
        if self._topic is None:
            waiting = self._search.waiting()
            self._statistics.set_problem("input", Level.WARN, waiting)
            self._node.get_logger().info(waiting, **throttled())

    def _name_others(self) -> None:
        """Log the event topics besides the one in use, whenever they change."""
        assert self._topic is not None
        others = self._search.others(self._topic)
        if others and others != self._named:
            self._node.get_logger().warning(
                f"listening to {self._topic.name}; event topics besides it: {', '.join(others)}; "
                f"choose with --ros-args -r events:={others[0]}",
                **throttled(),
            )
        self._named = others

    def _take_events(self, data: bytes, part: int) -> None:
        self._hears_events = True
        self._statistics.clear_problem("qos")  # there may be more publishers than the deaf one
        self._callbacks.events(data, part)

    def _unsubscribe(self) -> None:
        if self._feed is not None:
            self._feed.close()
            self._feed = None
        self._end_timer()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._topic = None
        self._hears_events = False
        for part in ("camera", "qos"):
            self._statistics.clear_problem(part)

    def _subscribe(self, topic: EventTopic) -> None:
        import_message_type(topic.type)  # before anything is made
        self._topic = topic
        if topic.name == self._search.name:  # the user named it: nothing is left to decide
            self._node.destroy_timer(self._timer)
        self._statistics.clear_problem("input")
        self._callbacks.topic(topic)
        if self._callbacks.camera_info is not None:
            self._subscriptions.append(
                self._node.create_subscription(
                    CameraInfo,
                    topic_beside(self._node, topic, "camera_info"),
                    self._callbacks.camera_info,
                    _CAMERA_INFO_QOS,
                    qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                )
            )
        self._feed = EventFeed(
            self._node,
            topic.name,
            fetch=lambda: fetch_waiting(self._subscriptions[-1], _EVENT_DEPTH),
            length_ns=self._length_ns,
            take=self._take_events,
            end_turn=self._callbacks.end_turn,
            skip=self._callbacks.skip,
            statistics=self._statistics,
        )
        self._hear(topic, _best_reliability(self._node, topic))

    def _hear(self, topic: EventTopic, reliability: ReliabilityPolicy) -> None:
        """Make the subscription to events; it is the last one."""
        assert self._feed is not None
        events = self._node.create_subscription(
            import_message_type(topic.type),
            topic.name,
            self._feed.receive,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST, depth=_EVENT_DEPTH, reliability=reliability
            ),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=lambda _: self._take_incompatible_qos(topic)
            ),
            qos_overriding_options=_given_overrides(self._node, topic.name),
            raw=True,
        )
        self._subscriptions.append(events)

    def _take_incompatible_qos(self, topic: EventTopic) -> None:
        """Ask for less where that was our own choice, or say that a publisher is not heard."""
        reliable = self._subscriptions[-1].qos_profile.reliability is ReliabilityPolicy.RELIABLE
        if reliable and QoSPolicyKind.RELIABILITY not in _given_kinds(self._node, topic.name):
            if self._again is None:  # not here: rclpy still uses the subscription
                self._again = self._node.create_timer(
                    0.0, self._hear_best_effort, clock=Clock(clock_type=ClockType.STEADY_TIME)
                )
            return
        self._report_incompatible_qos(topic)

    def _hear_best_effort(self) -> None:
        self._end_timer()
        assert self._topic is not None
        self._node.destroy_subscription(self._subscriptions.pop())
        self._hear(self._topic, ReliabilityPolicy.BEST_EFFORT)
        self._node.get_logger().warning(
            f"{self._topic.name}: a publisher offers best effort, so the events of all are "
            "subscribed to best effort from now on",
            **throttled(),
        )

    def _end_timer(self) -> None:
        if self._again is not None:
            self._node.destroy_timer(self._again)
            self._again = None

    def _report_incompatible_qos(self, topic: EventTopic) -> None:
        asked = _kind(self._subscriptions[-1].qos_profile)
        publishers = self._node.get_publishers_info_by_topic(topic.name)
        offered = " and ".join(sorted({_kind(p.qos_profile) for p in publishers}))
        self._statistics.set_problem(
            "qos",
            Level.ERROR,
            f"{topic.name}: no event arrives: a publisher offers {offered}, but {asked} is asked "
            f"for; change qos_overrides.{topic.name}.subscription.* or the publisher",
        )
        self._node.get_logger().error(self._statistics.problems["qos"][1], **throttled())


def _kind(profile: QoSProfile) -> str:
    """Name the two policies that decide whether a publisher and a subscription match."""
    return f"{profile.reliability.name.lower()} {profile.durability.name.lower()}"


def _best_reliability(node: Node, topic: EventTopic) -> ReliabilityPolicy:
    """Choose best effort, as drivers offer it, or reliable if all publishers are reliable."""
    offered = {p.qos_profile.reliability for p in node.get_publishers_info_by_topic(topic.name)}
    if offered == {ReliabilityPolicy.RELIABLE}:
        return ReliabilityPolicy.RELIABLE
    return ReliabilityPolicy.BEST_EFFORT


def _given_overrides(node: Node, topic: str) -> QoSOverridingOptions:
    """Return the QoS policies that the user has given for subscriptions to a topic (full name).

    For every policy that may be overridden, rclpy declares a read-only parameter with the value of
    the first subscription. All later subscriptions to that topic would take over that value.
    """
    return QoSOverridingOptions(_given_kinds(node, topic))


def _given_kinds(node: Node, topic: str) -> list[QoSPolicyKind]:
    names = {p: f"qos_overrides.{topic}.subscription.{p.name.lower()}" for p in _POLICIES}
    return [p for p, name in names.items() if _is_given(node, name)]


def _is_given(node: Node, name: str) -> bool:
    if node.has_parameter(name):  # an earlier subscription declared it, because it was given
        return True
    node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True))
    given = node.get_parameter(name).value is not None
    node.undeclare_parameter(name)
    return given
