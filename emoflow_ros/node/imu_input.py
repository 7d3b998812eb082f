"""From serialised IMU messages to readings beside the windows; knows no ROS."""

import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro.clock import GyroClock
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.stream.clock import SAME_CLOCK_NS
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.core.types.gyro import REACH_NS, GyroReadings, GyroState
from emoflow_ros.node.tasks import Task

type Mounting = Callable[[str, str], NDArray[np.float64]]

_CAPACITY = 32_768  # readings: 8 s at 2 kHz, at least
_DISORDER = 100 * NS_PER_MS  # a larger step back starts another run of the recording
_WAIT_S = 0.008
_LIVE = 200 * NS_PER_MS  # a gyro that is further behind than this is not waited for
_SILENT_S = 0.5
_SEARCH_EACH = 8  # windows: a search for the clocks' offset takes 20 ms
_ANGULAR = 13 * 8  # bytes after the header: orientation and its covariance
_NOT_MEASURED = -1.0
_HEAD = {"<": struct.Struct("<iII"), ">": struct.Struct(">iII")}
_BODY = {"<": struct.Struct("<4d"), ">": struct.Struct(">4d")}


class MountingError(Exception):
    """The orientation of the IMU is not known yet; the text says why."""


class ReadingBuffer:
    """The latest readings, at least 16 384 of them, in arrays that are allocated once."""

    def __init__(self) -> None:
        self._t = np.zeros(_CAPACITY, np.int64)
        self._w = np.zeros((_CAPACITY, 3))
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self._count = 0
        self.latest: int | None = None

    def add(self, t: int, x: float, y: float, z: float) -> None:
        """Take a reading; a slightly late one is left out, one from long ago clears the buffer."""
        latest = self.latest
        if latest is not None and t <= latest:
            if latest - t < _DISORDER:
                return
            self.clear()
        if self._count == _CAPACITY:
            half = _CAPACITY // 2
            self._t[:half] = self._t[half:]
            self._w[:half] = self._w[half:]
            self._count = half
        row = self._w[self._count]
        row[0], row[1], row[2] = x, y, z
        self._t[self._count] = t
        self._count += 1
        self.latest = t

    def between(self, first: int, last: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Times (N,) and angular velocities (N, 3) from `first` to `last`, ns; a copy."""
        t = self._t[: self._count]
        a, b = np.searchsorted(t, [first, last + 1])
        return t[a:b].copy(), self._w[a:b].copy()

    def all(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """All times (N,) and angular velocities (N, 3); views that hold until the next call."""
        return self._t[: self._count], self._w[: self._count]


class ImuInput:
    """Gives windows the readings that cover them.

    A window waits for readings up to its end, 8 ms at most, and not for a gyro that is silent.
    Where the events' own times are ROS times, within a second, the stamps of the IMU are compared
    with them directly. Otherwise the stamps are mapped to the events' times. Where the two are on
    two clocks all the same, windows get no readings until the offset is found (core.gyro.clock).

    Args:
        config: `rotation` is looked up with `mounting`.
        mounting: rotation from a frame, the IMU's, to another one, the camera's; raises
            MountingError.
        clock: monotonic time in s.

    Attributes:
        refusal: what is wrong with the latest message; empty if nothing is.
        event_delay_ns: of event times behind their messages' stamps; 0 where that is not known.
    """

    def __init__(
        self,
        config: GyroConfig,
        mounting: Mounting,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._config = config
        self._mounting = mounting
        self._clock = clock
        self._buffer = ReadingBuffer()
        self._waiting: deque[Task] = deque()
        self.start_over()

    def start_over(self) -> None:
        """Forget the readings and the mounting: another IMU may follow."""
        self._buffer.clear()
        self._frame = ""
        self._heard: float | None = None
        self._rotation: NDArray[np.float64] | None = None
        self._unmounted = ""
        self._same_clock = GyroClock()
        self._clocks_ns = 0
        self.event_delay_ns = 0
        self.refusal = ""

    @property
    def is_waited_for(self) -> bool:
        """Whether windows wait for readings."""
        return bool(self._waiting)

    def take(self, data: bytes) -> None:
        """Take a serialised sensor_msgs/Imu; one that cannot be read is left out."""
        try:
            order = "<" if data[1] & 1 else ">"
            sec, nanosec, length = _HEAD[order].unpack_from(data, 4)
            start = 16 + length
            start += -(start - 4) % 8  # aligned, counted from behind the encapsulation
            x, y, z, covariance = _BODY[order].unpack_from(data, start + _ANGULAR)
        except (struct.error, IndexError):
            self.refusal = "a malformed message"
            return
        if covariance == _NOT_MEASURED:
            self.refusal = "messages that say they have no gyroscope"
            return
        self.refusal = ""
        if not self._frame:
            self._frame = data[16 : 15 + length].decode(errors="replace")
        self._heard = self._clock()
        self._buffer.add(sec * NS_PER_S + nanosec, x, y, z)

    def hold(self, tasks: list[Task]) -> None:
        """Take windows that are complete."""
        self._waiting.extend(tasks)

    def ready(self) -> list[Task]:
        """Return the windows, in their order, that wait no longer, with their readings."""
        found = []
        while self._waiting and not self._waits(self._waiting[0]):
            found.append(self._with_readings(self._waiting.popleft()))
        return found

    def forget(self) -> int:
        """Forget what waits; return how many windows that were."""
        count = sum(not task.is_slice for task in self._waiting)
        self._waiting.clear()
        return count

    def problem(self, topic: str) -> str:
        """Say why windows have no readings of the topic; empty if they have, or if it is unknown.

        A topic that nobody has published yet is a problem only where the gyro is required.
        """
        if self.refusal:
            return f"{topic}: {self.refusal}; check the driver"
        if self._heard is None:
            required = self._config.use == "require"
            wrong = f"no message on {topic}; remap imu:=TOPIC, or set imu.use to auto or off"
            return wrong if required else ""
        silent = self._clock() - self._heard
        if silent > _SILENT_S:
            return f"no message on {topic} for {silent:.1f} s: check the driver"
        if self._unmounted:
            return self._unmounted
        apart = self._same_clock.apart_ns
        if abs(apart) > SAME_CLOCK_NS:
            return (
                f"the stamps of {topic} are {apart / NS_PER_S:.1f} s from the events: it is "
                "on another clock; use one clock, or set imu.time_offset_ms"
            )
        if self._is_doubtful:
            return (
                f"the stamps of {topic} are {apart / NS_PER_S:.2f} s from the events: on another "
                "clock, or one comes late; not used until turning the camera tells which, or "
                "imu.time_offset_ms is set (evaluate --check-imu)"
            )
        return ""

    def learn(self, estimate: Estimate) -> str:
        """Find the offset of the clocks where it is doubtful, by windows without the gyro.

        Returns:
            What is found, in words; empty while nothing is.
        """
        by_events = estimate.status is Status.OK and estimate.gyro.state is GyroState.NONE
        if not (self._is_doubtful and by_events) or self._rotation is None:
            return ""
        known = self._same_clock.add(estimate.t_start, estimate.t_end, estimate.angular)
        if known % _SEARCH_EACH:
            return ""
        readings = GyroReadings.mounted(*self._buffer.all(), self._rotation, -self._clocks_ns)
        if not self._same_clock.search(readings):
            return ""
        return (
            f"the gyro is used with its stamps {self._same_clock.offset_ns / NS_PER_MS:+.0f} ms: "
            "so it turns as the events do"
        )

    @property
    def _is_doubtful(self) -> bool:
        return not self._config.time_offset_ns and self._same_clock.is_doubtful

    def _waits(self, task: Task) -> bool:
        latest = self._buffer.latest
        if latest is None or self._is_doubtful:
            return False
        ahead = latest - task.window.t_end - self._shift(task)
        if ahead >= 0 or ahead < -_LIVE:
            return False
        return self._clock() - task.received < _WAIT_S

    def _with_readings(self, task: Task) -> Task:
        if self._buffer.latest is None:
            return task
        self._note_time(task)
        try:
            if self._rotation is None:
                self._rotation = self._mounting(self._frame, task.frame_id)
            self._unmounted = ""
        except MountingError as error:
            self._unmounted = str(error)
            return task
        if self._is_doubtful:
            return task
        window, shift = task.window, self._shift(task)
        around = (
            window.t_start + shift - 2 * REACH_NS,
            window.t_end + shift + 2 * REACH_NS,
        )
        t, w = self._buffer.between(*around)
        readings = GyroReadings.mounted(t, w, self._rotation, -shift)
        return replace(task, window=window.with_gyro(readings))

    def _note_time(self, task: Task) -> None:
        """Note how far the readings are from a window, unless the gyro is silent."""
        latest, heard = self._buffer.latest, self._heard
        if task.is_slice or latest is None or heard is None:
            return
        self._clocks_ns = _clocks_ns(task)
        if self._clock() - heard < _SILENT_S:
            apart = latest - task.window.t_end - self._clocks_ns + self._config.time_offset_ns
            self._same_clock.note(apart, self.event_delay_ns)

    def _shift(self, task: Task) -> int:
        """Stamp of the IMU minus event time, ns."""
        return _clocks_ns(task) - self._config.time_offset_ns - self._same_clock.offset_ns


def _clocks_ns(task: Task) -> int:
    """ROS time minus event time, ns; 0 where event times are ROS times."""
    return task.time_offset if abs(task.time_offset) > SAME_CLOCK_NS else 0
