"""The command `replay`: it publishes a bag of any kind on ROS topics, at its pace."""

import argparse
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from rosbags.interfaces import Connection
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from emoflow_ros.cli import run
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.node.ros_arguments import own_arguments, refused_in_one_line
from emoflow_ros.node.topic_search import import_message_type
from emoflow_ros.readers.bag_files import Bag, open_bag, read_messages, serialization
from emoflow_ros.readers.ros1_conversion import Ros1Converter
from msg_adapters import supported_types

_EPILOG = """\
examples:
  replay flight_data.bag
  replay recording/ --rate 0.5 --clock --wait
  replay flight_data.bag --topics /davis/left/events --ros-args -r /davis/left/events:=/events
"""
_DEPTH = 1000
_WAIT_S = 10.0
_SETTLE_S = 0.3
# Fast DDS asks a reliable subscriber for its acknowledgment every 3 s, unless messages are large.
_FLUSH_S = 4
_LATE_S = 0.05
_STOPPED_S = 0.5  # no single message takes that long
_CLOCK_PERIOD = 10 * NS_PER_MS
_BAR = "{desc}{percentage:3.0f}%|{bar}| {n:.1f}/{total:.1f} s [{elapsed}<{remaining}]"


class Pace:
    """Waits for the time of one message after another.

    A stop of the process between two messages (Ctrl-Z, SIGSTOP) delays all that follow: they
    are not sent in a burst, which no subscriber could take.

    Args:
        rate: 2 is twice as fast as it was recorded.
        clock, sleep: monotonic time in s, and a wait of so many s.

    Attributes:
        lag_s: the longest delay of a message, stops left out.
    """

    def __init__(
        self,
        rate: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.lag_s = 0.0
        self._rate = rate
        self._clock = clock
        self._sleep = sleep
        self._started = clock()
        self._late = 0.0

    def wait(self, recorded_s: float) -> None:
        """Wait until the message of so many seconds into the recording is due."""
        due = self._started + recorded_s / self._rate
        if (ahead := due - self._clock()) > 0:
            self._sleep(ahead)
        late = max(0.0, self._clock() - due)
        if late - self._late > _STOPPED_S:
            self._started += late - self._late
            late = self._late
        self._late = late
        self.lag_s = max(self.lag_s, late)


class Player:
    """Publishes a bag's messages in order of their log times.

    Args:
        node: to publish with.
        path, reader: the bag, opened.
        topics: what to publish; None for everything that can be.
        with_clock: whether to publish /clock.

    Attributes:
        published: messages so far.
        lag_s: the longest delay of a message.

    Raises:
        InputError: a topic is not in the bag, or nothing in it can be published.
    """

    def __init__(
        self,
        node: Node,
        path: Path,
        reader: Bag,
        *,
        topics: Sequence[str] | None,
        with_clock: bool,
    ) -> None:
        self.published = 0
        self.lag_s = 0.0
        self._path = path
        self._reader = reader
        self._connections = _select(path, reader, topics)
        self._publishers = self._advertise(node)
        ros1 = [c for c in self._connections if serialization(c) == "ros1"]
        self._converter = Ros1Converter(ros1)
        self._clock = node.create_publisher(Clock, "/clock", 10) if with_clock else None

    def wait_for_subscribers(self, timeout_s: float) -> None:
        """Wait until somebody listens to the events, or to anything if there are no events."""
        events = {c.topic for c in self._connections if c.msgtype in supported_types()}
        wanted = [self._publishers[t] for t in events or self._publishers]
        deadline = time.monotonic() + timeout_s
        while not all(p.get_subscription_count() for p in wanted):
            if time.monotonic() > deadline:
                print(f"nobody listens after {timeout_s:g} s: starting anyway", file=sys.stderr)
                return
            time.sleep(0.01)
        time.sleep(_SETTLE_S)  # topics of one node are matched one after another

    def play(self, rate: float) -> None:
        """Publish the bag once; `rate` 2 is twice as fast as it was recorded.

        Raises:
            InputError: damaged data, or no messages.
        """
        begin, end = self._reader.start_time, self._reader.end_time
        pace = Pace(rate)
        tick = begin
        with tqdm(total=(end - begin) / NS_PER_S, bar_format=_BAR, disable=None) as bar:
            for connection, t, data in read_messages(self._path, self._reader, self._connections):
                cdr = self._to_cdr(connection, data)
                pace.wait((t - begin) / NS_PER_S)
                if self._clock is not None and t >= tick:
                    sec, nanosec = divmod(t, NS_PER_S)
                    self._clock.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))
                    tick = t + _CLOCK_PERIOD
                self._publishers[connection.topic].publish(cdr)
                self.published += 1
                bar.update((t - begin) / NS_PER_S - bar.n)
        if self.published == 0:
            topics = ", ".join(sorted(self._publishers))
            raise InputError(self._path, f"no messages on {topics}", "record it again")
        self.lag_s = max(self.lag_s, pace.lag_s)

    def finish(self) -> bool:
        """Wait until the subscribers have what was published; return whether they have."""
        deadline = time.monotonic() + _FLUSH_S
        return all(
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))
            for publisher in self._publishers.values()
        )

    def _to_cdr(self, connection: Connection, data: bytes) -> bytes:
        if serialization(connection) == "cdr":
            return data
        return self._converter.to_cdr(data, connection.msgtype)

    def _advertise(self, node: Node) -> dict[str, Publisher]:
        """Make the publishers, and say which topics are left out."""
        publishers = {}
        refused = []
        for connection in self._connections:
            try:
                message_type = _message_type(connection)
            except InputError as error:
                refused.append(connection)
                print(f"left out: {connection.topic}: {error}", file=sys.stderr)
                continue
            qos = QoSProfile(depth=_DEPTH)
            if connection.topic.endswith("/tf_static"):
                qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
            publishers[connection.topic] = node.create_publisher(
                message_type, connection.topic, qos
            )
        self._connections = [c for c in self._connections if c not in refused]
        if not publishers:
            raise InputError(self._path, "no topic can be published", "install the message types")
        return publishers


def _message_type(connection: Connection) -> Any:
    """Import the type of a connection's messages.

    Raises:
        InputError: it is not installed, or none of ROS.
    """
    if serialization(connection) is None:
        form = getattr(connection.ext, "serialization_format", "")
        wrong = f"its messages are {form or 'of no known form'}, not of ROS"
        raise InputError(connection.msgtype, wrong, "convert them")
    return import_message_type(connection.msgtype)


def _select(path: Path, reader: Bag, topics: Sequence[str] | None) -> list[Connection]:
    """Return the bag's connections, or those of the topics asked for."""
    there = {c.topic for c in reader.connections}
    missing = sorted(set(topics or ()) - there)
    if missing or not there:
        wrong = f"no topic {missing[0]}" if missing else "no messages"
        listing = ", ".join(sorted(there)) or "nothing"
        raise InputError(path, wrong, f"the bag holds {listing}")
    return [c for c in reader.connections if topics is None or c.topic in topics]


def main() -> int:
    """Run the command line."""
    return run(_main)


def _main() -> None:
    args = _parse()
    with open_bag(args.bag) as reader:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            with refused_in_one_line():
                rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
                node = rclpy.create_node("replay")
            player = Player(node, args.bag, reader, topics=args.topics, with_clock=args.clock)
            if args.wait:
                player.wait_for_subscribers(args.wait)
            player.play(args.rate)
            while args.loop:
                player.play(args.rate)
            if not player.finish():
                print("a subscriber has not acknowledged the last messages", file=sys.stderr)
        finally:
            try_shutdown()
    late = f", up to {player.lag_s * 1e3:.0f} ms late" if player.lag_s > _LATE_S else ""
    print(f"{player.published} messages published{late}")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="replay",
        description="Publish the messages of a bag (ROS 1 .bag, rosbag2 sqlite3 or mcap) on ROS 2 "
        "topics, at the pace of their recording. ROS 1 messages are converted; types that are "
        "not installed are listed and left out. Ends with 0, 2 for bad input, 130 for Ctrl-C.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("bag", type=Path, metavar="BAG", help=".bag file, rosbag2 folder, .mcap or .db3 file")
    add("--rate", type=float, default=1.0, metavar="R", help="pace: 2 is twice as fast")
    add("--clock", action="store_true", help="publish /clock for nodes with use_sim_time")
    add("--topics", nargs="+", metavar="TOPIC", help="replay these topics only")
    add("--loop", action="store_true", help="start again at the end, until Ctrl-C")
    add(
        "--wait",
        type=float,
        nargs="?",
        const=_WAIT_S,
        default=0.0,
        metavar="S",
        help=f"wait up to S seconds (default: {_WAIT_S:g}) until somebody listens to the events",
    )
    args = parser.parse_args(own_arguments("replay"))
    if not 0.001 <= args.rate <= 1000:
        raise InputError("--rate", f"{args.rate:g}", "give a rate in [0.001, 1000]")
    if not 0 <= args.wait <= 3600:
        raise InputError("--wait", f"{args.wait:g} s", "give a time in [0, 3600] s")
    return args


if __name__ == "__main__":
    sys.exit(main())
