"""The command `info`: what a recording holds, and what is missing to run the estimator on it."""

import argparse
import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from tqdm import tqdm

from emoflow_ros.cli import run
from emoflow_ros.commands.info_contents import (
    Extras,
    ImuInfo,
    TruthInfo,
    apart,
    file_extras,
    section_lines,
    table_lines,
    topic_imu,
    topic_truth,
)
from emoflow_ros.core.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import KNOWN_FORMATS, Recording, open_recording
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.bag_files import open_bag, read_messages, serialization
from emoflow_ros.readers.column_arguments import add_column_options, column_options
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.readers.hdf5_columns import ColumnsRecording
from msg_adapters import DecodeError, Statistics, make_decoder, supported_types

_EPILOG = """\
examples:
  info recording.bag
  info events.raw --json
"""
_NO_CALIBRATION = (
    "no calibration: give --calib FILE to evaluate, camera.calibration_file to the estimator"
)
# Lidars publish these, too: a topic of them without a single event is no event topic.
_AMBIGUOUS = "sensor_msgs/msg/PointCloud2"


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
    unsorted: int = 0  # events before the one that precedes them
    packets: int = 0
    malformed: int = 0  # packets
    seq_gaps: int = 0  # packets
    time_wraps: int = 0
    triggers: int = 0
    outside: int = 0  # events
    skipped: int = 0  # words

    def add(self, events: Events) -> None:
        """Count the next events."""
        if len(events) == 0:
            return
        t = events.t
        first, last = int(t[0]) / NS_PER_S, int(t[-1]) / NS_PER_S
        self.unsorted += int(np.count_nonzero(t[1:] < t[:-1]))
        self.unsorted += self.t_last is not None and first < self.t_last
        self.t_first = first if self.t_first is None else self.t_first
        self.t_last = last
        self.events += len(events)
        self.on += int(np.count_nonzero(events.p))
        self.off = self.events - self.on
        if self.t_last > self.t_first:
            self.rate = self.events / (self.t_last - self.t_first)

    def take(self, statistics: Statistics) -> None:
        """Take over what a decoder has counted."""
        self.encoding = statistics.encoding
        self.seq_gaps = statistics.seq_gaps
        self.time_wraps = statistics.time_wraps
        self.triggers = statistics.triggers
        self.outside = statistics.dropped_outside
        self.skipped = statistics.skipped


@dataclass
class Info:
    """A recording: its event streams, truth, IMUs and other topics, and what would be missed."""

    input: str
    topics: list[TopicInfo] = field(default_factory=list)
    truth: list[TruthInfo] = field(default_factory=list)
    imu: list[ImuInfo] = field(default_factory=list)
    other_topics: list[dict[str, Any]] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


def main() -> int:
    """Entry point."""
    return run(lambda: _main(_parser().parse_args()))


def inspect(path: Path, columns: ColumnOptions | None = None) -> Info:
    """Read a whole recording and count; `columns` as for `open_recording`.

    Raises:
        InputError: it cannot be read.
    """
    is_bag = BagRecording.matches(path) and not columns  # of bags the options are refused
    info = _inspect_bag(path) if is_bag else _inspect_file(path, columns)
    if not info.topics:
        info.missing.append("no event topic")
    info.missing += [f"{t.name or 'file'}: no events" for t in info.topics if t.events == 0]
    spans = [(t.t_first, t.t_last) for t in info.topics if t.t_first is not None]
    info.missing += [f"{t.name}: {problem}" for t in info.truth if (problem := apart(t, spans))]
    return info


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="info",
        description="Say what a recording holds, and what is missing to run the estimator on it.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("input", type=Path, help=KNOWN_FORMATS)
    add_column_options(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def _main(args: argparse.Namespace) -> None:
    info = inspect(args.input, column_options(args))
    if args.json:
        print(json.dumps(asdict(info), indent=2))
    else:
        print("\n".join(_lines(info)))


def _inspect_bag(path: Path) -> Info:
    info = Info(str(path))
    with open_bag(path) as bag:
        for name in sorted({c.topic for c in bag.connections}):
            connections = [c for c in bag.connections if c.topic == name]
            ros_type = connections[0].msgtype
            count = sum(c.msgcount for c in connections)
            if ros_type in supported_types():
                messages = (data for _, _, data in read_messages(path, bag, connections))
                bar = tqdm(messages, name, count, unit="packet", leave=False, disable=None)
                topic = _inspect_topic(name, ros_type, serialization(bag), bar)
                if ros_type != _AMBIGUOUS or topic.malformed < count:
                    info.topics.append(topic)
                    continue
            if not _is_extra(info, path, bag, name):
                info.other_topics.append({"name": name, "type": ros_type, "messages": count})
    info.missing += [
        f"{t.name}: {problem}" for t in info.topics if (problem := _calibration_problem(path, t))
    ]
    return info


def _is_extra(info: Info, path: Path, bag: AnyReader, name: str) -> bool:
    """Add a topic that is truth or an IMU; one that cannot be read is listed as missing."""
    try:
        found = topic_truth(path, bag, name) or topic_imu(path, bag, name)
    except InputError as error:
        info.missing.append(f"{name} cannot be used ({error})")
        return False
    if isinstance(found, TruthInfo):
        info.truth.append(found)
    elif found is not None:
        info.imu.append(found)
    return found is not None


def _inspect_topic(name: str, ros_type: str, kind: Any, messages: Iterable[bytes]) -> TopicInfo:
    topic = TopicInfo(name, ros_type)
    decoder = make_decoder(ros_type, kind)
    for data in messages:
        topic.packets += 1
        try:
            message = decoder.decode(data)
        except DecodeError:
            topic.malformed += 1
            continue
        topic.width, topic.height = message.width, message.height
        topic.add(message.events)
    topic.take(decoder.statistics)
    return topic


def _calibration_problem(path: Path, topic: TopicInfo) -> str | None:
    """Say why the bag's own calibration of a topic is of no use."""
    try:
        with BagRecording(path, topic=topic.name) as recording:
            camera = recording.camera
    except InputError as error:
        reason = str(error).removeprefix(f"{path} ")
        return f"camera_info cannot be used ({reason})"
    if camera is None:
        return _NO_CALIBRATION
    if topic.width and (camera.width, camera.height) != (topic.width, topic.height):
        return f"camera_info is of a {camera.width}x{camera.height} sensor"
    return None


def _inspect_file(path: Path, columns: ColumnOptions | None) -> Info:
    info = Info(str(path))
    several = ColumnsRecording.matches(path)
    for name in ColumnsRecording.topics(path) if several else [None]:
        with open_recording(path, topic=name, columns=columns) as recording:
            if not info.topics:
                _take_extras(info, file_extras(recording))
            info.topics.append(_count_file(recording))
            if recording.camera is None:
                info.missing.append(f"{name}: {_NO_CALIBRATION}" if several else _NO_CALIBRATION)
    return info


def _take_extras(info: Info, extras: Extras) -> None:
    info.truth, info.imu = extras.truth, extras.imu
    info.missing += extras.problems


def _count_file(recording: Recording) -> TopicInfo:
    kind = getattr(recording, "TYPE", type(recording).__name__)
    topic = TopicInfo(recording.topic or getattr(recording, "file_name", ""), kind)
    topic.encoding = getattr(recording, "encoding", "")
    size = getattr(recording, "size", (0, 0))
    if recording.camera is not None:
        size = recording.camera.width, recording.camera.height
    topic.width, topic.height = size
    for events in tqdm(recording.event_chunks(), unit="chunk", leave=False, disable=None):
        topic.add(events)
    return topic


def _lines(info: Info) -> Iterator[str]:
    """Yield the report for people."""
    yield info.input
    for topic in info.topics:
        yield ""
        yield from _topic_lines(topic)
    yield from section_lines("truth", [truth.row() for truth in info.truth])
    yield from section_lines("imu", [imu.row() for imu in info.imu])
    if info.other_topics:
        yield ""
        yield "other topics"
        yield from table_lines(
            [(t["name"], t["type"], str(t["messages"])) for t in info.other_topics]
        )
    yield ""
    yield f"missing: {'; '.join(info.missing) or 'nothing'}"


def _topic_lines(topic: TopicInfo) -> Iterator[str]:
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
        "events out of order": topic.unsorted,
        "events outside": topic.outside,
        "words skipped": topic.skipped,
        "time wraps": topic.time_wraps,
        "triggers": topic.triggers,
    }
    rows += [(name, str(count)) for name, count in problems.items() if count]
    yield from table_lines(rows)


if __name__ == "__main__":
    sys.exit(main())
