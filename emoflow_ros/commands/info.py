"""The command `info`: what a recording holds, and what is missing to run the estimator on it."""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
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
from emoflow_ros.commands.info_topics import TopicInfo, inspect_topic, topic_lines
from emoflow_ros.errors import InputError
from emoflow_ros.readers import KNOWN_FORMATS, Recording, open_recording, unordered
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.bag_events import TopicDecoder, event_connections
from emoflow_ros.readers.bag_files import Bag, open_bag, read_messages
from emoflow_ros.readers.column_arguments import add_column_options, column_options
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.readers.hdf5_columns import ColumnsRecording
from emoflow_ros.readers.stream_check import MAX_UNORDERED_SHARE
from msg_adapters import supported_types

_EPILOG = """\
examples:
  info recording.bag
  info events.raw --json

exit codes: 0 done, also for a bag of other topics; 2 bad input, or not one event in the messages of
events; 130 interrupted, 141 nobody reads the output.
"""
_NO_CALIBRATION = (
    "no calibration: give --calib FILE to evaluate, camera.calibration_file to the estimator"
)
# Lidars publish these, too: a topic of them without a single event is no event topic.
_AMBIGUOUS = "sensor_msgs/msg/PointCloud2"


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
        info.missing.append("no topic of a known event type")
    info.missing += [f"{t.name or 'file'}: no events" for t in info.topics if t.events == 0]
    info.missing += [
        f"{t.name}: event time goes back for good: give each part as a recording of its own"
        for t in info.topics
        if t.time_jumps
    ]
    info.missing += [
        f"{t.name}: event times are not sorted"
        for t in info.topics
        if t.unordered > MAX_UNORDERED_SHARE * (t.events + t.unordered)
    ]
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
    _refuse_lost_events(info)


def _refuse_lost_events(info: Info) -> None:
    """Refuse a recording that holds messages of events of which not one event came.

    Raises:
        InputError: it is one. What it holds has been said by then.
    """
    if any(topic.events for topic in info.topics):
        return
    held = {topic.name: topic.packets for topic in info.topics if topic.packets}
    known = set(supported_types()) - {_AMBIGUOUS}
    held |= {t["name"]: t["messages"] for t in info.other_topics if t["type"] in known}
    if count := sum(held.values()):
        wrong = f"{count} messages of events on {', '.join(sorted(held))}, and no event in them"
        raise InputError(info.input, wrong, "record it again, or convert it")


def _inspect_bag(path: Path) -> Info:
    info = Info(str(path))
    with open_bag(path) as bag:
        events = event_connections(bag)
        for name in sorted({c.topic for c in bag.connections}):
            connections = [c for c in bag.connections if c.topic == name]
            ros_type = connections[0].msgtype
            count = sum(c.msgcount for c in connections)
            if decoder := _decoder(info, events.get(name, [])):
                messages = read_messages(path, bag, events[name])
                bar = tqdm(messages, name, count, unit="packet", leave=False, disable=None)
                topic = inspect_topic(name, ros_type, decoder, bar)
                if ros_type != _AMBIGUOUS or topic.malformed < count:
                    info.topics.append(topic)
                    continue
            if not _is_extra(info, path, bag, name):
                info.other_topics.append({"name": name, "type": ros_type, "messages": count})
    info.missing += [
        f"{t.name}: {problem}" for t in info.topics if (problem := _calibration_problem(path, t))
    ]
    return info


def _decoder(info: Info, connections: list[Connection]) -> TopicDecoder | None:
    """Make the decoder of an event topic; what cannot be decoded is listed as missing."""
    try:
        return TopicDecoder(connections) if connections else None
    except InputError as error:
        info.missing.append(str(error))
        return None


def _is_extra(info: Info, path: Path, bag: Bag, name: str) -> bool:
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
    topic.unordered = unordered(recording)
    return topic


def _lines(info: Info) -> Iterator[str]:
    """Yield the report for people."""
    yield info.input
    for topic in info.topics:
        yield ""
        yield from topic_lines(topic)
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


if __name__ == "__main__":
    sys.exit(main())
