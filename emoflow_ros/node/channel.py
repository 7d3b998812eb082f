"""Plain data between the node and its worker: a JSON header and arrays, never pickled objects."""

import json
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

type Arrays = dict[str, NDArray[Any]]


class Channel:
    """One end of a connection between two processes. Not safe for several threads."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def send(self, header: Mapping[str, Any], arrays: Arrays) -> None:
        """Send a message.

        Raises:
            OSError: the other end is gone.
        """
        layout = [(name, a.dtype.str, a.shape) for name, a in arrays.items()]
        self._connection.send_bytes(json.dumps([header, layout]).encode())
        for array in arrays.values():
            self._connection.send_bytes(np.ascontiguousarray(array).reshape(-1).view(np.uint8))

    def receive(self) -> tuple[dict[str, Any], Arrays]:
        """Wait for a message. Its arrays are writable and belong to the caller.

        Raises:
            EOFError, OSError: the other end is gone.
        """
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
