"""From the sensor's clock to ROS time.

A driver stamps a message with the host's time when its first event arrived, which is the event's
time plus a delay that varies but is never negative. The smallest differences between stamp and
sensor time therefore lie along the true offset (plus the smallest delay), and their slope over
time is the drift of one clock against the other. Where they leave that line for seconds, the
host's clock was set anew, and the line is fitted to what came after.

A sensor whose times are ROS time already differs by a delay alone, and its times are left as they
are. Such a clock may also have been set from the host's once: as soon as the differences move away
further than they scatter, the drift is followed there, too.
"""

from collections import deque
from enum import StrEnum

import numpy as np

from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S

# Event times closer than this to the stamps are ROS time, or were.
SAME_CLOCK_NS = NS_PER_S

_BUCKET_NS = NS_PER_S  # the smallest difference of each second is kept
_BUCKETS = 60
_MIN_BUCKETS = 5  # before that a slope would be noise
# How fast the offset may change, in ns per ns: below 1, so that time never goes back.
_START_SLEW = 0.5
# Differences this far from their line, for more than _MIN_BUCKETS seconds: a clock was set anew.
# With events on ROS time (within SAME_CLOCK_NS of the stamps) it may be a delay.
_STEP_NS = 100 * NS_PER_MS
# A clock on ROS time drifts if its differences move by more than this, and than their scatter.
_MIN_DRIFT_NS = NS_PER_MS
_DRIFT_IN_SCATTERS = 3.0
_TRACKING_SLEW = 1e-3


class Timestamps(StrEnum):
    """Which time the output is stamped with."""

    HEADER = "header"  # follow each message's stamp
    SENSOR = "sensor"  # the events' own times
    FUSED = "fused"  # sensor time on ROS's clock: offset estimated, drift tracked


class ClockMap:
    """Map the times of one sensor to ROS time; increasing times give increasing times.

    Args:
        timestamps: what to map to.

    Attributes:
        drift_ppm: how much faster ROS time runs than the sensor's clock, in parts per million;
            0 until there is evidence.
    """

    def __init__(self, timestamps: Timestamps) -> None:
        self._timestamps = timestamps
        self.reset()

    def reset(self) -> None:
        """Forget the offset, for example after a jump in time."""
        self.drift_ppm = 0.0
        self._first: int | None = None
        self._on_ros_time = self._timestamps is Timestamps.SENSOR
        self._scatter = 0.0  # of the smallest differences about their line, ns: the largest so far
        self._delay = 0  # of a sensor that is on ROS time, or was; another clock hides its own
        # The offset in use is `_held` at sensor time `_since` and moves from there towards the
        # line `_target` + `drift_ppm` * (t - `_reference`).
        self._since = self._held = self._reference = self._target = 0
        self._slew = _START_SLEW
        self._far = 0  # how many of the latest minima are far from the line
        self._minima: deque[tuple[int, int]] = deque(maxlen=_BUCKETS)  # (sensor time, difference)

    def observe(self, sensor: int, stamp: int) -> None:
        """Take the time of a message's first event and the message's stamp, both in ns."""
        if self._timestamps is Timestamps.SENSOR:
            return
        difference = stamp - sensor
        if self._first is None:
            self._first = self._since = self._reference = sensor
            self._aim(difference)
            self._held = 0 if self._on_ros_time else self._target
        self._held = self.offset(sensor)
        self._since = max(self._since, sensor)
        if self._timestamps is Timestamps.HEADER:
            self._reference, self._target = sensor, difference
        else:
            self._track(sensor, difference)

    def offset(self, t: int) -> int:
        """ROS time minus sensor time at sensor time t, in ns."""
        line = 0 if self._on_ros_time else self._line(t)
        reach = round(self._slew * max(0, t - self._since))
        return self._held + min(max(line - self._held, -reach), reach)

    def to_ros(self, t: int) -> int:
        """Map a sensor time to ROS time, in ns; before the first observation it is unchanged."""
        return t + self.offset(t)

    @property
    def delay_ns(self) -> int:
        """Smallest difference between stamps and event times that are taken for ROS time, ns.

        It may be a delay, or the offset of a clock that is not quite on ROS time. 0 where event
        times are not taken for ROS time.
        """
        return self._delay if self._on_ros_time else 0

    def _line(self, t: int) -> int:
        return self._target + round(self.drift_ppm * 1e-6 * (t - self._reference))

    def _track(self, sensor: int, difference: int) -> None:
        assert self._first is not None
        if self._minima and self._minima[-1][0] // _BUCKET_NS == sensor // _BUCKET_NS:
            if difference >= self._minima[-1][1]:
                return
            self._minima.pop()
        elif self._is_line_wanted():
            self._fit()
        self._minima.append((sensor, difference))
        if len(self._minima) < _MIN_BUCKETS:
            self._reference = sensor
            self._aim(min(d for _, d in self._minima))

    def _aim(self, difference: int) -> None:
        """Set what the offset moves to, and decide whether the sensor is on ROS time (still)."""
        if len(self._minima) <= _MIN_BUCKETS:  # there was no slope yet
            fused = self._timestamps is Timestamps.FUSED
            self._on_ros_time = fused and abs(difference) < SAME_CLOCK_NS
            self._delay = difference if self._on_ros_time else 0
        self._target = difference - self._delay
        if abs(self._target) > max(_MIN_DRIFT_NS, _DRIFT_IN_SCATTERS * self._scatter):
            self._on_ros_time = False

    def _is_line_wanted(self) -> bool:
        """Tell whether to fit the finished seconds; those before a step are forgotten.

        While the latest minima are far from the line, it stays: their messages may be late.
        """
        if len(self._minima) < _MIN_BUCKETS:
            return False
        t, difference = self._minima[-1]
        most = SAME_CLOCK_NS if self._on_ros_time else _STEP_NS
        is_far = abs(difference - self._delay - self._line(t)) > most
        self._far = self._far + 1 if is_far else 0
        if self._far <= _MIN_BUCKETS:
            return not is_far
        while len(self._minima) > self._far:
            self._minima.popleft()
        self._far = 0
        return True

    def _fit(self) -> None:
        """Fit the line through the minima of the finished seconds (Theil-Sen)."""
        self._reference = self._minima[-1][0]
        base = self._minima[-1][1]
        t, d = np.array([(a - self._reference, b - base) for a, b in self._minima], float).T
        i, j = np.triu_indices(len(t), 1)
        # Not scipy.stats.theilslopes: importing scipy.stats makes the node start 1.5 s later.
        slope = float(np.median((d[j] - d[i]) / (t[j] - t[i])))
        self.drift_ppm = slope * 1e6
        intercept = float(np.median(d - slope * t))
        scatter = float(np.percentile(np.abs(d - slope * t - intercept), 90))
        self._scatter = max(self._scatter, scatter)
        self._aim(base + round(intercept))
        is_near = abs(self._line(self._since) - self._held) < _STEP_NS
        self._slew = _TRACKING_SLEW if is_near or self._on_ros_time else _START_SLEW
