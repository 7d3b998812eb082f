"""What every encoding of event_camera_msgs/EventPacket offers."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import Events
from msg_adapters.message import Statistics


class PacketDecoder(Protocol):
    """Decodes the payloads of one stream in order. Made with the statistics to add to."""

    def __init__(self, statistics: Statistics) -> None: ...

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; `time_base` is in ns and below 2**62. Never fails."""
        ...

    def resync(self) -> None:
        """Distrust what lost packets may have changed; keep counting time wraps."""
        ...

    def reset(self) -> None:
        """Forget everything."""
        ...


def view_words(
    payload: memoryview, word: np.dtype[Any], big_endian: bool, statistics: Statistics
) -> NDArray[Any]:
    """View a payload as words of a little-endian type; big-endian ones are copied.

    An incomplete word at the end counts as skipped.
    """
    if len(payload) % word.itemsize:
        statistics.skipped += 1
    words: NDArray[Any] = np.ndarray(len(payload) // word.itemsize, word, payload)
    return words.byteswap() if big_endian else words
