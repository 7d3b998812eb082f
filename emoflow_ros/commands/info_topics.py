"""A stream of events as the command `info` describes it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from rosbags.interfaces import Connection

from emoflow_ros.commands.info_contents import table_lines
from emoflow_ros.core.types.events import NS_PER_S, Events, TimeJumpError
from emoflow_ros.readers.bag_events import TopicDecoder
from emoflow_ros.readers.stream_check import SettledOrder
from msg_adapters import DecodeError, Statistics


@dataclass
class TopicInfo:
    """One stream of events. Times are the sensor's, in seconds; None where there is no event."""

    name: str
    type: str
    encoding: str = ""
    width: int = 0
    height: int = 0
    events: int = 0
    on: int = 0
    off: int = 0
    t_first: float | None = None
    t_last: float | None = None
    rate: float | None = None  # events/s
    unordered: int = 0  # events that the estimator leaves out, as they are not in order of time
    time_jumps: int = 0  # where time goes back for good
    packets: int = 0
    malformed: int = 0  # packets
    seq_gaps: int = 0  # packets
    time_wraps: int = 0
    triggers: int = 0
    outside: int = 0  # events
    skipped: int = 0  # words

    def add(self, events: Events) -> None:
        """Count the next events, which are in order of time."""
        if len(events) == 0:
            return
        first, last = int(events.t[0]) / NS_PER_S, int(events.t[-1]) / NS_PER_S
        self.t_first = first if self.t_first is None else self.t_first
        self.t_last = last
        self.events += len(events)
        self.on += int(events.p.sum())
        self.off = self.events - self.on
        if self.t_last > self.t_first:
            self.rate = self.events / (self.t_last - self.t_first)

    def add_jump(self, before: Events) -> None:
        """Count a jump back in time, and the events before it that were not counted yet."""
        self.add(before)
        self.time_jumps += 1

    def take(self, statistics: Statistics) -> None:
        """Take over what a decoder has counted."""
        self.encoding = statistics.encoding
        self.seq_gaps = statistics.seq_gaps
        self.time_wraps = statistics.time_wraps
        self.triggers = statistics.triggers
        self.outside = statistics.dropped_outside
        self.skipped = statistics.skipped


def inspect_topic(
    name: str,
    ros_type: str,
    decoder: TopicDecoder,
    messages: Iterable[tuple[Connection, int, bytes]],
) -> TopicInfo:
    """Decode the messages of a topic, and count."""
    topic, order = TopicInfo(name, ros_type), SettledOrder()
    for connection, _, data in messages:
        topic.packets += 1
        try:
            message = decoder.decode(connection, data)
        except DecodeError:
            topic.malformed += 1
            continue
        topic.width, topic.height = message.width, message.height
        try:
            topic.add(order(message.events))
        except TimeJumpError as jump:
            topic.add_jump(order.restart(jump))
    _finish(topic, order)
    topic.unordered = order.sift.left_out
    topic.take(decoder.statistics)
    return topic


def _finish(topic: TopicInfo, order: SettledOrder) -> None:
    """Count the events that still wait; there may be jumps back in time among them."""
    while True:
        try:
            topic.add(order.finish())
        except TimeJumpError as jump:
            topic.add_jump(order.restart(jump))
        else:
            return


def topic_lines(topic: TopicInfo) -> Iterator[str]:
    """Yield the lines about a topic for people."""
    yield f"{topic.name or 'events'}: {topic.type}"
    rows = [
        ("encoding", topic.encoding or "-"),
        ("resolution", f"{topic.width}x{topic.height}" if topic.width else "unknown"),
        ("events", f"{topic.events} ({topic.on} ON, {topic.off} OFF)"),
    ]
    if topic.t_first is not None and topic.t_last is not None:
        span = f"{topic.t_first:.6f} to {topic.t_last:.6f} s"
        rows.append(("sensor time", f"{span} ({topic.t_last - topic.t_first:.6f} s)"))
    if topic.rate is not None:
        rows.append(("rate", f"{topic.rate:.0f} events/s"))
    if topic.packets:
        rows.append(("packets", f"{topic.packets} ({topic.seq_gaps} lost)"))
    problems = {
        "malformed packets": topic.malformed,
        "events out of order, left out": topic.unordered,
        "jumps back in time": topic.time_jumps,
        "events outside": topic.outside,
        "words skipped": topic.skipped,
        "time wraps": topic.time_wraps,
        "triggers": topic.triggers,
    }
    rows += [(name, str(count)) for name, count in problems.items() if count]
    yield from table_lines(rows)
