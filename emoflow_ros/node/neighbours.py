"""Other publishers of the node's twists, as of a second node of the same name."""

import time
from collections.abc import Callable

from rclpy.node import Node

from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.reports import Level

_TOPIC = "egomotion/twist"
# A process that was killed is seen for as long as its lease: 20 s in Fast DDS.
_SETTLE_S = 25.0


class Neighbours:
    """Says who else publishes twists on the node's topic: subscribers would get both.

    Args:
        node: whose topic it is; its own publisher is there.
        clock: monotonic time in s.
    """

    def __init__(self, node: Node, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self._since: float | None = None
        self._is_told = False

    def look(self, statistics: Statistics) -> None:
        """Look once, and state the problem or clear it."""
        topic = self._node.resolve_topic_name(_TOPIC)
        others = self._others(topic)
        if not others:
            self._since, self._is_told = None, False
            statistics.clear_problem("topic")
            return
        self._since = self._clock() if self._since is None else self._since
        if self._clock() - self._since < _SETTLE_S:
            return
        line = (
            f"{topic} is also published by {' and '.join(others)}: subscribers get both; start "
            "each node in a namespace of its own (-r __ns:=/NAME)"
        )
        statistics.set_problem("topic", Level.WARN, line)
        if not self._is_told:
            self._is_told = True
            self._node.get_logger().warning(line)

    def _others(self, topic: str) -> list[str]:
        own = self._node.get_fully_qualified_name()
        names = sorted(
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(topic)
        )
        if own in names:
            names.remove(own)
        return [f"another node called {name}" if name == own else name for name in names]
