"""A node's view of the graph in tests of what it listens to, and the time that passes there."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from fake_node import FakeHandle

DVS = "dvs_msgs/msg/EventArray"
CLOUD = "sensor_msgs/msg/PointCloud2"


class Graph:
    """Stands for a node: topics with their type, a namespace, and a remapping of `events`.

    Attributes:
        topics: published ones, with their type.
        now: what `clock` tells, s.
        callbacks: of the subscriptions, by topic.
        sent: messages that wait in the middleware, for any subscription.
        guards: callbacks of the guard conditions.
        triggered: how often one of them was triggered.
        log: lines, as (level, text).
    """

    def __init__(self, topics: dict[str, str], events: str = "", namespace: str = "/") -> None:
        self.topics = topics
        self.now = 0.0
        self.callbacks: dict[str, Callable[..., None]] = {}
        self.sent: list[bytes] = []
        self.guards: list[Callable[[], None]] = []
        self.triggered = 0
        self.log: list[tuple[str, str]] = []
        self.tick: Callable[[], None] | None = None
        self._namespace = namespace
        self._events = events

    def clock(self) -> float:
        return self.now

    def resolve_topic_name(self, name: str, *, only_expand: bool = False) -> str:
        if name == "events" and self._events and not only_expand:
            return self._events
        return f"{self._namespace.rstrip('/')}/{name}"

    def get_namespace(self) -> str:
        return self._namespace

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [(name, [ros_type]) for name, ros_type in self.topics.items()]

    def count_publishers(self, name: str) -> int:
        return int(name in self.topics)

    def get_publishers_info_by_topic(self, name: str) -> list[Any]:
        return []

    def has_parameter(self, name: str) -> bool:
        return name.startswith("qos_overrides.")  # given, for rclpy to read

    def create_timer(self, period: float, callback: Callable[[], None], **kwargs: Any) -> Any:
        self.tick = callback
        return self

    def destroy_timer(self, timer: Any) -> None:
        self.tick = None

    def create_subscription(
        self, kind: Any, topic: str, callback: Callable[..., None], qos: Any, **kwargs: Any
    ) -> Any:
        self.callbacks[topic] = callback
        return SimpleNamespace(topic=topic, handle=FakeHandle(self.sent), msg_type=kind)

    def destroy_subscription(self, subscription: Any) -> None:
        del self.callbacks[subscription.topic]

    def create_guard_condition(self, callback: Callable[[], None]) -> Any:
        self.guards.append(callback)
        return SimpleNamespace(callback=callback, trigger=self._trigger)

    def destroy_guard_condition(self, guard: Any) -> None:
        self.guards.remove(guard.callback)

    def _trigger(self) -> None:
        self.triggered += 1

    def get_logger(self) -> Any:
        def level(name: str) -> Callable[..., None]:
            return lambda line, **kwargs: self.log.append((name, line))

        return SimpleNamespace(**{name: level(name) for name in ("info", "warning", "error")})
