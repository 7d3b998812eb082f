"""What a recording holds besides events: ground truth and IMUs, for the command `info`."""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers import Recording
from emoflow_ros.readers.bag_files import Bag, read_messages, serialization
from emoflow_ros.readers.bag_imu import IMU_TYPE, header_stamp, read_imu
from emoflow_ros.readers.reader_base import Imu
from emoflow_ros.readers.text_tables import IMU_FILE, read_imu_text
from emoflow_ros.truth import truth_beside
from emoflow_ros.truth.bag_truth import DEPTH_NAMES, IMAGE, POSE_TYPES
from emoflow_ros.truth.text_truth import is_tum, read_poses


@dataclass
class TruthInfo:
    """A source of ground truth. Times are in seconds; None where they are not looked at.

    Attributes:
        name: the topic or file.
        kind: what it holds.
        count: messages or lines; None where they are not counted.
        rate: per second.
        t_first, t_last: of the first and the last one.
    """

    name: str
    kind: str
    count: int | None = None
    rate: float | None = None
    t_first: float | None = None
    t_last: float | None = None

    def row(self) -> tuple[str, ...]:
        """Return the cells of its line."""
        return (self.name, self.kind, _counted(self.count, self.rate), _span(self))


@dataclass
class ImuInfo:
    """An IMU. Times are in seconds.

    Attributes:
        name: the topic or file.
        count: readings.
        rate: per second.
        t_first, t_last: of the first and the last reading.
        largest_angular_rad_s: magnitude.
        median_acceleration_m_s2: magnitude, 9.8 at rest; None without an accelerometer.
    """

    name: str
    count: int
    rate: float | None
    t_first: float
    t_last: float
    largest_angular_rad_s: float
    median_acceleration_m_s2: float | None

    def row(self) -> tuple[str, ...]:
        """Return the cells of its line; the magnitudes tell wrong units."""
        angular = f"angular velocity up to {self.largest_angular_rad_s:.2f} rad/s"
        force = "no accelerometer"
        if self.median_acceleration_m_s2 is not None:
            force = f"acceleration {self.median_acceleration_m_s2:.1f} m/s^2 (median)"
        return (self.name, _counted(self.count, self.rate), angular, force, _span(self))


@dataclass
class Extras:
    """Truth and IMU of a file or folder, and what is wrong with them."""

    truth: list[TruthInfo] = field(default_factory=list)
    imu: list[ImuInfo] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def topic_truth(path: Path, bag: Bag, topic: str) -> TruthInfo | None:
    """Describe a topic of poses or depth; None where it is of neither.

    Raises:
        InputError: damaged messages.
    """
    connections = [c for c in bag.connections if c.topic == topic]
    kind, count = connections[0].msgtype, sum(c.msgcount for c in connections)
    if kind == IMAGE and topic.rpartition("/")[2] in DEPTH_NAMES:
        return TruthInfo(topic, "depth images", count)  # large: they are not read
    if kind not in POSE_TYPES:
        return None
    try:
        stamps = [
            header_stamp(data, ros2=serialization(connection) == "cdr")
            for connection, _, data in read_messages(path, bag, connections)
        ]
    except (IndexError, struct.error):
        raise InputError(path, f"damaged message on {topic}", "record it again") from None
    return _stamped(topic, f"poses ({kind})", np.sort(np.array(stamps, np.int64)))


def topic_imu(path: Path, bag: Bag, topic: str) -> ImuInfo | None:
    """Describe a topic of an IMU; None where it is none.

    Raises:
        InputError: see `read_imu`.
    """
    connections = [c for c in bag.connections if c.topic == topic]
    if connections[0].msgtype != IMU_TYPE:
        return None
    return describe_imu(read_imu(path, read_messages(path, bag, connections)))


def file_extras(recording: Recording) -> Extras:
    """Describe the truth and the IMU that lie in a recording, in its folder or beside it."""
    extras = Extras()
    for path in truth_beside(recording):
        try:
            extras.truth.append(_describe_truth(path))
        except InputError as error:
            extras.problems.append(f"{path.name} cannot be used ({error})")
    try:
        imu = recording.imu()
    except InputError as error:
        extras.problems.append(f"the IMU cannot be used ({error})")
    else:
        extras.imu += [describe_imu(imu)] if imu is not None else []
    return extras


def describe_imu(imu: Imu) -> ImuInfo:
    """Describe readings, of which there is at least one."""
    force = imu.acceleration
    return ImuInfo(
        imu.name,
        len(imu),
        _finite(imu.rate),
        int(imu.t[0]) / NS_PER_S,
        int(imu.t[-1]) / NS_PER_S,
        float(np.linalg.norm(imu.angular, axis=1).max()),
        None if force is None else float(np.median(np.linalg.norm(force, axis=1))),
    )


def table_lines(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Yield the lines of a table with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield ("  " + "  ".join(map(str.ljust, row, widths))).rstrip()


def section_lines(title: str, rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Yield a title with a table below it, or that there is nothing."""
    yield ""
    yield title if rows else f"{title}: none"
    if rows:
        yield from table_lines(rows)


def apart(truth: TruthInfo, spans: Sequence[tuple[float | None, float | None]]) -> str | None:
    """Say whether a truth overlaps with no events in time; None where it does.

    Args:
        truth: one source.
        spans: the first and last time of each stream of events, s.
    """
    if truth.t_first is None or truth.t_last is None:
        return None
    known = [(a, a if b is None else b) for a, b in spans if a is not None]
    if not known or any(a < truth.t_last and truth.t_first < (b or a) for a, b in known):
        return None
    return "does not overlap with the events in time: of another clock, or another recording"


def _describe_truth(path: Path) -> TruthInfo:
    if path.is_dir():
        return TruthInfo(path.name, "flow images")
    if is_tum(path):
        return _stamped(path.name, "poses", read_poses(path).stamps)
    if path.name == IMU_FILE:
        return _stamped(path.name, "angular velocity (gyroscope)", read_imu_text(path).t)
    return TruthInfo(path.name, "constant rotation")


def _stamped(name: str, kind: str, stamps: NDArray[np.int64]) -> TruthInfo:
    if len(stamps) == 0:
        return TruthInfo(name, kind, 0)
    steps = np.diff(stamps)
    rate = NS_PER_S / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else None
    first, last = int(stamps[0]) / NS_PER_S, int(stamps[-1]) / NS_PER_S
    return TruthInfo(name, kind, len(stamps), rate, first, last)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _counted(count: int | None, rate: float | None) -> str:
    if count is None:
        return ""
    return f"{count}" if rate is None else f"{count} at {rate:.0f} Hz"


def _span(info: TruthInfo | ImuInfo) -> str:
    if info.t_first is None or info.t_last is None:
        return ""
    return f"{info.t_first:.6f} to {info.t_last:.6f} s"
