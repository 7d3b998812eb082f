"""Plain data between the node and its worker: a JSON header and arrays, never pickled objects."""

import json
import math
import os
import socket
import struct
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

type Arrays = dict[str, NDArray[Any]]


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
