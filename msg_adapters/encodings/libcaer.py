"""libcaer's own polarity events, as libcaer_driver passes them on: 8 bytes per event.

Source: libcaer (polarity.h). Two 32-bit words: the first holds polarity in bit 1, the row in
bits 2-16 and the column in bits 17-31; the second 31 bits of microseconds. The packet's
time_base holds what the 31 bits cannot at the packet's start; they may roll over inside.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import Events
from msg_adapters.message import Statistics
from msg_adapters.packet_decoder import view_words

ENCODING = "libcaer"

_WORD = np.dtype("<u4")
_WRAP_US = 1 << 31
_HALF_US = 1 << 30
_FIFTEEN_BITS = 0x7FFF


class PacketDecoder:
    """Decode libcaer packets."""

    def __init__(self, statistics: Statistics) -> None:
        self._statistics = statistics
        self.reset()

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; times count from `time_base`."""
        whole = payload[: len(payload) // 8 * 8]
        self._statistics.skipped += len(payload) > len(whole)
        words = view_words(whole, _WORD, big_endian, self._statistics)
        data = words[0::2]
        x = (data >> 17).astype(np.uint16)
        y = (data >> 2).astype(np.uint16) & np.uint16(_FIFTEEN_BITS)
        p = (data & 2).astype(np.bool_)
        t = (words[1::2] & np.uint32(_WRAP_US - 1)).astype(np.int64)
        if len(t):
            self._unwrap(t, time_base)
        t *= 1000
        t += time_base
        return Events(x, y, t, p)

    def resync(self) -> None:
        """Do nothing: time_base says where the next packet is."""

    def reset(self) -> None:
        """Forget roll-overs."""
        self._time_base = -1
        self._last = 0
        self._rolled = 0

    def _unwrap(self, t: NDArray[np.int64], time_base: int) -> None:
        """Add the roll-overs since time_base last changed to t (us), in place."""
        if time_base != self._time_base:
            self._time_base, self._last, self._rolled = time_base, int(t[0]), 0
        last = int(t[-1])
        drops = np.flatnonzero(t[:-1] - t[1:] > _HALF_US) + 1
        if self._last - int(t[0]) > _HALF_US:
            drops = np.append(0, drops)
        t += self._rolled * _WRAP_US
        if len(drops):  # summed up at once: random bytes roll over at every third event
            steps = np.zeros(len(t), np.int64)
            steps[drops] = _WRAP_US
            t += np.cumsum(steps)
        self._rolled += len(drops)
        self._statistics.time_wraps += len(drops)
        self._last = last


DECODER = PacketDecoder
