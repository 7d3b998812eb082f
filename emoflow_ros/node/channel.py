"""The channel between the node and its worker, and what crosses it.

That is plain data only: a JSON header and arrays, no pickled objects. A window goes to the worker
in few bytes; its estimate, or the latest twist, comes back.
"""

import json
import math
import os
import socket
import struct
from collections.abc import Mapping
from dataclasses import asdict
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.core.types.gyro import GyroReadings, GyroState, GyroStatus
from emoflow_ros.core.types.twist import PresentTwist, Twist
from emoflow_ros.node.tasks import Arrays, Present, Result, Task


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


def pack_window(window: Window) -> tuple[dict[str, Any], Arrays]:
    """Return the interval of a window, and the columns of its events and of its gyro.

    Times count from the window's start. Times and counts take the shortest type that holds them
    all: an event of a window of up to 4 s has at most 11 bytes while it stands for less than 65536.
    """
    events = window.events
    arrays = {"x": events.x, "y": events.y, "p": events.p, "t": _short(events.t - window.t_start)}
    if events.stands_for is not None:
        arrays["stands_for"] = _short(events.stands_for)
    if window.gyro is not None:
        arrays |= {"gyro_t": window.gyro.t, "gyro_w": window.gyro.w}
    return {"t_start": window.t_start, "t_end": window.t_end}, arrays


def unpack_window(interval: dict[str, Any], arrays: Arrays) -> Window:
    """Build the window again; it equals the one that `pack_window` was given."""
    start, end = interval["t_start"], interval["t_end"]
    stands_for = arrays.get("stands_for")
    events = Events(
        arrays["x"],
        arrays["y"],
        arrays["t"].astype(np.int64) + start,
        arrays["p"],
        None if stands_for is None else stands_for.astype(np.uint32),
    )
    gyro = None
    if "gyro_t" in arrays:
        gyro = GyroReadings(arrays["gyro_t"], arrays["gyro_w"])
    return Window(start, end, events, gyro)


def _short(values: np.ndarray[Any, np.dtype[Any]]) -> np.ndarray[Any, np.dtype[Any]]:
    """Return values of 0 and more as the shortest unsigned type that holds them."""
    return values.astype(np.min_scalar_type(int(values.max(initial=0))))


def pack(estimate: Estimate) -> tuple[dict[str, Any], Arrays]:
    """Turn an estimate, without its samplers, into plain data."""
    header = {
        "t_start": estimate.t_start,
        "t_end": estimate.t_end,
        "t": estimate.t,
        "status": estimate.status,
        "model": estimate.model,
        "has_flow": estimate.flow is not None,
        "quality": asdict(estimate.quality),
        "gyro": [estimate.gyro.state, estimate.gyro.reason],
    }
    arrays: Arrays = {
        "linear": np.asarray(estimate.linear, np.float64),
        "angular": np.asarray(estimate.angular, np.float64),
        "covariance": np.asarray(estimate.covariance, np.float64),
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
    return Result(
        task,
        estimate,
        pictures=arrays,
        has_flow=header["has_flow"],
        wall_s=header.get("wall_s", 0.0),
        processor_s=header.get("processor_s", 0.0),
    )


def pack_present(found: PresentTwist | None) -> tuple[dict[str, Any], Arrays]:
    """Turn the latest twist, if there is one, into plain data."""
    if found is None:
        return {"t": None}, {}
    twist = found.twist
    arrays = {"linear": twist.linear, "angular": twist.angular, "covariance": found.covariance}
    return {"t": twist.t}, arrays


def unpack_present(task: Task, header: dict[str, Any], arrays: Arrays) -> Present | None:
    """Build the answer to a slice; None if there is no latest twist."""
    if header["t"] is None:
        return None
    twist = Twist(header["t"], arrays["linear"], arrays["angular"])
    return Present(task, PresentTwist(twist, arrays["covariance"]))
