"""Numbers that tune how a gyro is used: one table."""

from dataclasses import dataclass
from math import radians


@dataclass(frozen=True)
class GyroSettings:
    """How far a gyro is believed, and what counts as a fault of it.

    Chosen on recordings with a gyro, real ones and simulated ones with faults. Nothing scales with
    the sensor. What is known of a particular gyro is in GyroConfig.

    Attributes:
        acceleration: how a camera may rotate beyond the last reading, rad/s^2.
        curvature: and between two, rad/s^3.
        clock_s: standard deviation of the offset between the clocks, s.
        floor, relative_floor: standard deviation of the difference between events and gyro although
            both are right, because of the calibration and the choice of the window: a constant,
            rad/s, and a share of the angular velocity.
        gross: likewise the share from which a difference counts as disagreement.
        telling: standard deviations of w from which agreement says something.
        rejected_share, accepted_share: of the windows that disagree, from which a gyro is rejected,
            and below which it is used again.
        memory_s: time constant of that share, s; and the time of agreement after which a gyro is
            confirmed, or used again.
        first_memory_s: time constant until a gyro is confirmed, s.
        retry_s: time of disagreement after which a rejected gyro's bias is doubted once more, s.
        at_rest: standard deviation of w, rad/s, where the gyro is steady and the events show no
            motion. If it is an even rotation all the same, it is one in all windows:
        rest_s: together they count as one in so long, s.
        correlated_s: errors of the events' estimates that are nearer in time go together, s.
        most_doubt: of the bias, over what is expected of it.
        frozen_ns, frozen_readings: time and number of equal readings of a gyro that is frozen.
        at_range: share of the range from which a reading counts as at its end.
        steady_ns, look_ns: time of readings without motion, and of those that are looked at
            together, ns.
        quiet: noise density beyond which no gyro counts as steady, rad/s per square root of Hz.
        units: relative error of a scale up to which it looks like wrong units.
        compared, fewest_compared: windows in which gyro and events are compared.
        better: share of the given axes' squared residual that other axes may leave.
        clock_windows: of which the one whose readings are nearest counts: the others waited.
        apart_ns: a difference between readings and events that is no delay of messages, ns: a busy
            node lets events wait for 0.2 s.
        confirmed_apart_ns: the same where the messages' stamps confirm it.
        beyond_ns: that an offset is looked for beyond the largest that is taken, ns.
        coarse_ns, fine_ns: steps of the search, ns. What two halves of the windows say may be one
            coarse step apart.
        near_ns: around the best offset, ns.
        clock_compared, clock_fewest: windows that are compared for it, at most and at least.
        explained: share of the rotation's square, by the best offset.
        elsewhere: what all offsets leave that are not near it, over what it leaves.
    """

    acceleration: float = 20.0
    curvature: float = 1000.0
    clock_s: float = 0.5e-3
    floor: float = radians(0.3)
    relative_floor: float = 0.03
    gross: float = 0.12
    telling: float = 3.0
    rejected_share: float = 0.6
    accepted_share: float = 0.3
    memory_s: float = 2.0
    first_memory_s: float = 0.4
    retry_s: float = 3.0
    at_rest: float = radians(0.15)
    rest_s: float = 10.0
    correlated_s: float = 0.25
    most_doubt: float = 8.0
    frozen_ns: int = 50_000_000
    frozen_readings: int = 10
    at_range: float = 0.99
    steady_ns: int = 500_000_000
    look_ns: int = 250_000_000
    quiet: float = radians(0.03)
    units: float = 0.35
    compared: int = 60
    fewest_compared: int = 8
    better: float = 0.5
    clock_windows: int = 20
    apart_ns: int = 300_000_000
    confirmed_apart_ns: int = 100_000_000
    beyond_ns: int = 50_000_000
    coarse_ns: int = 5_000_000
    fine_ns: int = 500_000
    near_ns: int = 60_000_000
    clock_compared: int = 90
    clock_fewest: int = 30
    explained: float = 0.7
    elsewhere: float = 1.5


GYRO = GyroSettings()
