"""Whether a gyro's stamps are on the events' clock, and by how much they are off where not.

Readings and events that come together should have about the same time. Where they have not, there
are two clocks, or one of the two came late. The times alone do not tell which of them it is; the
rotation of the camera, which both measure, does.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro.measurement import GyroMeans
from emoflow_ros.core.gyro.settings import GYRO
from emoflow_ros.core.stream.clock import SAME_CLOCK_NS
from emoflow_ros.core.types.gyro import GyroReadings

Array = NDArray[np.float64]
Times = NDArray[np.int64]

_REACH_NS = SAME_CLOCK_NS + GYRO.beyond_ns


class GyroClock:
    """Notices that the stamps may be on another clock, and finds the offset then.

    Call `note` for each window. While `is_doubtful`, call `add` for each that is estimated by the
    events, and `search` now and then.

    Attributes:
        offset_ns: what is to be added to the gyro's stamps; 0 until something else is found.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        self._apart: deque[int] = deque(maxlen=GYRO.clock_windows)
        self._usual, self._least = 0, GYRO.apart_ns
        self._windows: deque[tuple[int, int, Array]] = deque(maxlen=GYRO.clock_compared)

    def note(self, apart_ns: int, delay_ns: int) -> None:
        """Note how far the readings are from a window that is complete.

        Args:
            apart_ns: from the window's end to the latest reading, without `offset_ns`.
            delay_ns: of event times behind their messages' stamps; 0 where that is not known.
        """
        self._apart.append(apart_ns)
        confirmed = self._usual == 0 and abs(delay_ns) >= GYRO.confirmed_apart_ns
        self._least = GYRO.confirmed_apart_ns if confirmed else GYRO.apart_ns

    @property
    def apart_ns(self) -> int:
        """From the end of a window to the latest reading: of the last windows the least."""
        return min(self._apart, key=lambda apart: abs(apart - self._usual), default=self._usual)

    @property
    def is_doubtful(self) -> bool:
        """Whether the offset is not known and can be found: it is at most a second."""
        unusual = abs(self.apart_ns - self._usual) >= self._least
        return unusual and abs(self.apart_ns) <= SAME_CLOCK_NS

    def add(self, t_start: int, t_end: int, w: Array) -> int:
        """Take what the events of an interval (ns) tell: w (3,), rad/s, in its middle.

        Returns:
            How many there are now.
        """
        third = (t_end - t_start) // 3
        self._windows.append((t_start + third, t_end - third, w))
        return len(self._windows)

    def search(self, readings: GyroReadings) -> bool:
        """Look for the offset; return whether it is found, and in use from now on."""
        if not self._windows:
            return False
        starts, ends, events = map(np.array, zip(*self._windows, strict=True))
        found = find_offset(readings, starts, ends, events)
        if found is None:
            return False
        self.offset_ns, self._usual, self._least = found, self.apart_ns, GYRO.apart_ns
        self._windows.clear()
        return True


def find_offset(readings: GyroReadings, starts: Times, ends: Times, events: Array) -> int | None:
    """Find what is to be added to a gyro's stamps, up to a second, from the rotation of the camera.

    Args:
        readings: the gyro's; a bias does no harm.
        starts, ends: (M,) int64 ns, intervals.
        events: (M, 3) rad/s, angular velocity of the events in their middles.

    Returns:
        The offset in ns; None where the camera rotates too little or too evenly for one to stand
        out, or fewer than 30 intervals have readings for a second on either side.
    """
    if not len(readings):
        return None
    covered = (starts - _REACH_NS >= readings.t[0]) & (ends + _REACH_NS <= readings.t[-1])
    if covered.sum() < GYRO.clock_fewest:
        return None
    starts, ends, events = starts[covered], ends[covered], events[covered]
    means = GyroMeans(readings.t, readings.w)

    def differences(offsets: Times) -> Array:
        """Events less gyro (K, M, 3) for offsets (K,)."""
        earlier = offsets[:, None]
        of_gyro = means.over((starts - earlier).ravel(), (ends - earlier).ravel())
        return events - of_gyro.reshape(len(offsets), len(starts), 3)

    coarse = np.arange(-_REACH_NS, _REACH_NS + 1, GYRO.coarse_ns)
    left = _spread(differences(coarse))
    best = int(left.argmin())
    if not left[best] ** 2 <= (1 - GYRO.explained) * _spread(events[None])[0] ** 2:  # also NaN
        return None
    elsewhere = np.abs(coarse - coarse[best]) > GYRO.near_ns
    if not left[elsewhere].min() >= GYRO.elsewhere * left[best]:
        return None
    fine = coarse[best] + np.arange(-GYRO.near_ns, GYRO.near_ns + 1, GYRO.fine_ns)
    fine = fine[np.abs(fine) <= _REACH_NS]
    found = differences(fine)
    half = len(starts) // 2
    whole, first, second = (
        int(fine[_spread(found[:, part]).argmin()])
        for part in (slice(None), slice(half), slice(half, None))
    )
    return whole if abs(first - second) <= GYRO.coarse_ns else None


def _spread(differences: Array) -> Array:
    """Mean length (K,) of differences (K, M, 3) from their medians."""
    centred = differences - np.median(differences, axis=1, keepdims=True)
    lengths: Array = np.linalg.norm(centred, axis=2).mean(axis=1)
    return lengths
