"""Log lines that come now and then only, also when the host's clock was set back."""

from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.time import Time

OFTEN_S = 5.0
REMINDER_S = 30.0  # of a problem that lasts until somebody acts


class _SinceBoot(Clock):
    """Steady time, an hour ahead: rclpy takes it that each line was logged at time 0."""

    def now(self) -> Time:
        return super().now() + Duration(seconds=3600)


_CLOCK = _SinceBoot(clock_type=ClockType.STEADY_TIME)


def throttled(seconds: float = OFTEN_S) -> dict[str, Any]:
    """Arguments of a logger's method that let it log once in so many seconds at most.

    By itself rclpy goes by the host's clock, and would be silent for as long as that was set back.
    """
    return {"throttle_duration_sec": seconds, "throttle_time_source_type": _CLOCK}
