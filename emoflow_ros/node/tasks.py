"""What goes to the worker and what comes back.

These are the tasks and their outcomes, the queue in which tasks wait, and the channel between the
two processes. Only plain data crosses the channel: a JSON header and arrays, no pickled objects.
"""

import json
import math
import os
import socket
import struct
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status, Twist
from emoflow_ros.core.events import Window
from emoflow_ros.core.gyro_checks import GyroState, GyroStatus

type Arrays = dict[str, NDArray[Any]]


class Picture(StrEnum):
    """A picture of a window, by its topic."""

    FLOW = "flow/image"
    COLOR = "flow/color"
    EVENTS = "flow/iwe"
    TRACKS = "flow/tracks"


@dataclass(frozen=True)
class Task:
    """A window on its way through the node.

    Attributes:
        window: what to estimate.
        epoch: which run of event time it belongs to; a jump back starts the next one.
        time_offset: ROS time minus event time, ns.
        frame_id: the camera's optical frame.
        received: monotonic time in s at which the window was complete.
    """

    window: Window
    epoch: int
    time_offset: int
    frame_id: str
    received: float

    @property
    def stamp(self) -> int:
        """ROS time of the window's middle, ns."""
        return self.to_ros((self.window.t_start + self.window.t_end) // 2)

    def to_ros(self, t: int) -> int:
        """Map an event time of the window to ROS time, ns."""
        return t + self.time_offset


@dataclass(frozen=True)
class Wishes:
    """What a result is to hold besides the estimate.

    Attributes:
        pictures: those of `Picture` that somebody subscribes to.
        flow_color_max: flow in full colour, px/s; 0 takes the picture's 99th percentile.
        flow_stride: 2 keeps every second pixel and row of the flow's picture, 1 all.
        tracks: number of points that the picture of tracks follows.
        twist_rate: twists per second of event time; 0: one per window.
    """

    pictures: tuple[str, ...] = ()
    flow_color_max: float = 0.0
    flow_stride: int = 1
    tracks: int = 1
    twist_rate: float = 0.0


@dataclass(frozen=True)
class Job:
    """A task with all that the worker needs for it, as it was when the task was handed over."""

    task: Task
    camera: Camera
    config: Config
    wishes: Wishes = field(default_factory=Wishes)


@dataclass(frozen=True)
class Result:
    """The answer to a task: the estimate without its samplers, and what was wished for.

    Attributes:
        task: what was asked.
        estimate: `flow` and `motion` are None.
        twists: those wished for, in order of time; none unless the status is OK.
        pictures: those wished for, by name; none unless the status is OK.
    """

    task: Task
    estimate: Estimate
    twists: tuple[Twist, ...] = ()
    pictures: Arrays = field(default_factory=dict)

    @property
    def stamp(self) -> int:
        """ROS time that the estimate's values hold at, ns."""
        return self.task.to_ros(self.estimate.t)


@dataclass(frozen=True)
class Loss:
    """A window without a result, or a worker that was lost, or both.

    Attributes:
        reason: one line.
        worker: whether the worker was lost and is started again.
        task: the window; None when the worker was lost between two windows.
        trace: the traceback of an error in the node itself; empty for all others.
    """

    reason: str
    worker: bool
    task: Task | None = field(default=None, compare=False)
    trace: str = ""


@dataclass(frozen=True)
class Notice:
    """Something about the worker that lasts until the node is configured anew; one line."""

    reason: str


type Outcome = Result | Loss | Notice


class DropOldestQueue[T]:
    """Hand items from one thread to another without ever blocking the one that puts.

    Args:
        capacity: items kept; one more drops the oldest. Items that come together are all kept.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, items: Sequence[T]) -> list[T]:
        """Append items; return, and count as `dropped`, those that had to make room."""
        with self._changed:
            self._items.extend(items)
            excess = len(self._items) - max(self._capacity, len(items))
            oldest = [self._items.popleft() for _ in range(excess)]
            self.dropped += len(oldest)
            self._changed.notify()
        return oldest

    def get(self, timeout: float) -> T | None:
        """Remove the oldest item, or return None when none came within `timeout` seconds."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._items, timeout):
                return None
            return self._items.popleft()

    def clear(self) -> int:
        """Forget all items, which do not count as dropped, and return how many they were."""
        with self._changed:
            count = len(self._items)
            self._items.clear()
        return count


class Channel:
    """One end of a connection between two processes. Not safe for several threads.

    Args:
        connection: of `multiprocessing.Pipe`, duplex.
        stall_s: the other end may stop for this long within a message; None: for ever.
    """

    def __init__(self, connection: Connection, stall_s: float | None = None) -> None:
        self._connection = connection
        if stall_s is not None:
            _bound_transfers(connection, stall_s)

    def send(self, header: Mapping[str, Any], arrays: Arrays) -> None:
        """Send a message.

        Raises:
            TimeoutError: the other end does not read.
            OSError: the other end is gone.
        """
        layout = [(name, a.dtype.str, a.shape) for name, a in arrays.items()]
        try:
            self._connection.send_bytes(json.dumps([header, layout]).encode())
            for array in arrays.values():
                self._connection.send_bytes(np.ascontiguousarray(array).reshape(-1).view(np.uint8))
        except BlockingIOError:
            raise TimeoutError("a message is not read") from None

    def receive(self, timeout_s: float | None = None) -> tuple[dict[str, Any], Arrays]:
        """Wait for a message. Its arrays are writable and belong to the caller.

        Args:
            timeout_s: how long to wait for its start; None: for ever.

        Raises:
            TimeoutError: no message, or no more of it.
            EOFError, OSError: the other end is gone.
        """
        if timeout_s is not None and not self._connection.poll(timeout_s):
            raise TimeoutError(f"no message in {timeout_s:g} s")
        try:
            return self._receive()
        except BlockingIOError:
            raise TimeoutError("a message is not finished") from None

    def _receive(self) -> tuple[dict[str, Any], Arrays]:
        header, layout = json.loads(self._connection.recv_bytes())
        arrays: Arrays = {}
        for name, dtype, shape in layout:
            array = np.empty(shape, dtype)
            self._connection.recv_bytes_into(array.reshape(-1).view(np.uint8))
            arrays[name] = array
        return header, arrays

    def close(self) -> None:
        """Close this end."""
        self._connection.close()


def _bound_transfers(connection: Connection, seconds: float) -> None:
    """Let every read and write of a connection, which is a pair of sockets, end after a time."""
    fraction, whole = math.modf(seconds)
    timeval = struct.pack("@ll", int(whole), round(fraction * 1e6))
    with socket.socket(fileno=os.dup(connection.fileno())) as end:
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            end.setsockopt(socket.SOL_SOCKET, option, timeval)


def pack(estimate: Estimate, twists: list[Twist]) -> tuple[dict[str, Any], Arrays]:
    """Turn an estimate, without its samplers, and its twists into plain data."""
    header = {
        "t_start": estimate.t_start,
        "t_end": estimate.t_end,
        "t": estimate.t,
        "status": estimate.status,
        "model": estimate.model,
        "quality": asdict(estimate.quality),
        "gyro": [estimate.gyro.state, estimate.gyro.reason],
        "times": [twist.t for twist in twists],
    }
    arrays: Arrays = {
        "linear": np.asarray(estimate.linear, np.float64),
        "angular": np.asarray(estimate.angular, np.float64),
        "covariance": np.asarray(estimate.covariance, np.float64),
        "twists": np.array([(*w.linear, *w.angular) for w in twists], np.float64).reshape(-1, 6),
    }
    return header, arrays


def unpack(task: Task, header: dict[str, Any], arrays: Arrays) -> Result:
    """Build the result of a task from its answer; arrays that `pack` does not make are pictures."""
    state, reason = header["gyro"]
    estimate = Estimate(
        t_start=header["t_start"],
        t_end=header["t_end"],
        t=header["t"],
        status=Status(header["status"]),
        model=MotionModel(header["model"]),
        quality=Quality(**header["quality"]),
        gyro=GyroStatus(GyroState(state), reason),
        linear=arrays.pop("linear"),
        angular=arrays.pop("angular"),
        covariance=arrays.pop("covariance"),
    )
    rows = zip(header["times"], arrays.pop("twists"), strict=True)
    twists = tuple(Twist(t, row[:3], row[3:]) for t, row in rows)
    return Result(task, estimate, twists, pictures=arrays)
