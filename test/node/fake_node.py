"""A node without DDS, which keeps what is published, and a tf that knows one transform."""

import sys
from contextlib import nullcontext
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest


class FakePublisher:
    def __init__(self, message_type: Any) -> None:
        self.message_type = message_type
        self.subscribers = 0
        self.messages: list[Any] = []

    def publish(self, message: Any) -> None:
        assert isinstance(message, self.message_type)
        self.messages.append(message)

    def get_subscription_count(self) -> int:
        return self.subscribers


class FakeHandle(nullcontext):
    def __init__(self, sent: list[bytes]) -> None:
        super().__init__()
        self._sent = sent

    def take_message(self, message_type: Any, raw: bool) -> Any:
        assert raw
        return (self._sent.pop(0), None) if self._sent else None


class FakeNode:
    """Its publishers have as many subscribers as a test says; the log holds (level, line)."""

    def __init__(self) -> None:
        self.publishers: dict[str, FakePublisher] = {}
        self.now = 0
        self.log: list[tuple[str, str]] = []
        self.sent: list[bytes] = []
        self.timers: list[Any] = []

    def get_logger(self) -> Any:
        def level(name: str) -> Any:
            return lambda line, **kwargs: self.log.append((name, line))

        return SimpleNamespace(**{name: level(name) for name in ("info", "warning", "error")})

    def resolve_topic_name(self, name: str, *, only_expand: bool = False) -> str:
        return f"/{name}"

    def create_lifecycle_publisher(
        self, message_type: Any, topic: str, depth: int, *, event_callbacks: Any
    ) -> Any:
        self.publishers[topic] = FakePublisher(message_type)
        return self.publishers[topic]

    def destroy_lifecycle_publisher(self, publisher: FakePublisher) -> None:
        [topic] = [name for name, p in self.publishers.items() if p is publisher]
        del self.publishers[topic]

    def create_timer(self, period_s: float, callback: Any, clock: Any) -> Any:
        self.timers.append(SimpleNamespace(cancel=lambda: None, reset=lambda: None, fire=callback))
        return self.timers[-1]

    def create_subscription(self, message_type: Any, topic: str, *args: Any, **kwargs: Any) -> Any:
        """A polled one: `sent` holds what has come on any topic."""
        handle = FakeHandle(self.sent)
        return SimpleNamespace(handle=handle, msg_type=message_type)

    def destroy_subscription(self, subscription: Any) -> None:
        pass

    def destroy_timer(self, timer: Any) -> None:
        pass

    def get_fully_qualified_name(self) -> str:
        return "/estimator"

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now))

    def messages(self, topic: str) -> list[Any]:
        return self.publishers[topic].messages


class FakeTf(ModuleType):
    """As much of tf2_ros as is used: a camera that looks ahead, known or not yet."""

    class TransformException(Exception):  # noqa: N818 (tf2_ros's name)
        pass

    def __init__(self) -> None:
        super().__init__("tf2_ros")
        self.known = False
        self.listening = 0
        self.asked: list[tuple[str, str, int]] = []
        self.cleared = 0

    def Buffer(self) -> Any:  # noqa: N802
        return SimpleNamespace(lookup_transform=self._lookup, clear=self._clear)

    def TransformListener(self, buffer: Any, node: Any) -> Any:  # noqa: N802
        self.listening += 1
        return SimpleNamespace(unregister=self._unregister)

    def _unregister(self) -> None:
        self.listening -= 1

    def _clear(self) -> None:
        self.cleared += 1

    def _lookup(self, target: str, source: str, time: Any) -> Any:
        self.asked.append((target, source, time.nanoseconds))
        if not self.known:
            raise self.TransformException("not yet")
        rotation = SimpleNamespace(x=-0.5, y=0.5, z=-0.5, w=0.5)
        return SimpleNamespace(transform=SimpleNamespace(rotation=rotation))


def install_fake_tf(monkeypatch: pytest.MonkeyPatch) -> FakeTf:
    tf = FakeTf()
    monkeypatch.setitem(sys.modules, "tf2_ros", tf)
    return tf
