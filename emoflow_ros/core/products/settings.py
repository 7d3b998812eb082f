"""Numbers that tune what is told: a table for the motion of windows, and for the latest twist."""

from dataclasses import dataclass
from math import radians


@dataclass(frozen=True)
class StreamSettings:
    """How rest, darkness, how fast the image moves at most and wide covariances are told.

    Of the stream of twists. Chosen on random recordings with rests and covered lenses. Pixels are
    those of the working image where nothing else is said, so that nothing scales with the sensor.

    Attributes:
        block_px: side of a block, px.
        way_px: that a scene is gauged over, px: a longer one would leave its block.
        longest_px: way of a window from which only its latest part counts, px.
        shortest_px: a shorter way tells too little of a scene, px.
        grid_px: distance between the points whose speed counts, px of the sensor.
        sure: standard deviations of noise by which a scatter is surely more than chance.
        fewest_of_edges: number of events from which edges are looked for.
        edges: variance over that by chance from which there are edges.
        fewest: events of a window from a sensor that works.
        rest_px_s: speed up to which a camera is at rest, px/s.
        depth_m: of the scene, to tell the speed of a camera at rest in m/s.
        least_px_s: speed that is never excluded, px/s.
        supposed: scatter per px and px^2 of the sensor in a block, where no scene was gauged: 0.04
            to 0.5 in 12 random recordings.
        any_w: standard deviation of any w before anything is known, rad/s. Cameras rotate at 16
            deg/s about an axis (RMS of 60 random recordings), and in a hundredth of the time by
            more than 94 deg/s.
        carried_ns: for so long the last motion goes on, ns.
        gap_ns: between windows; after a longer one the stream begins anew, ns.
        unseen: variance of w over that by how fast the image moves at most, where the events show
            no motion.
        lost_px: way after which a scene may be another one, px: a quarter of its width.
        part_ns: the fullest part of a window, ns. The light has changed if in it
        covered: more than this share of the image has events,
        one_sided: at most this share of them of the other polarity,
        apart: and the share of ON events was another one before, by so much.
        kept: of the share before, window by window.
        narrow_w, narrow_v: standard deviations of w, rad/s, and of v, rad, along any axis, up to
            which nothing needs a word.
        few_events: number of events below which the word for a wide one is `events`.
        low_gain: contrast gain below which it is `motion`.
    """

    block_px: int = 8
    way_px: float = 4.0
    longest_px: float = 6.0
    shortest_px: float = 0.5
    grid_px: int = 16
    sure: float = 3.0
    fewest_of_edges: int = 1000
    edges: float = 4.0
    fewest: int = 20
    rest_px_s: float = 3.0
    depth_m: float = 3.0
    least_px_s: float = 0.5
    supposed: float = 0.03
    any_w: float = radians(60.0)
    carried_ns: int = 500_000_000
    gap_ns: int = 1_000_000_000
    unseen: float = 0.3
    lost_px: float = 90.0
    part_ns: int = 20_000_000
    covered: float = 0.7
    one_sided: float = 0.05
    apart: float = 0.3
    kept: float = 0.8
    narrow_w: float = radians(5.0)
    narrow_v: float = radians(15.0)
    few_events: int = 5_000
    low_gain: float = 1.3


@dataclass(frozen=True)
class PresentSettings:
    """How the latest twist is told from the newest events, or from a gyro.

    Events, fading and walk were chosen on 18 random recordings. Nothing scales with the sensor.

    Attributes:
        longest_ns: from the middle of the last window to now; later there is none, ns.
        events, fewest_events: number of events that are enough for six numbers, and that are
            needed.
        fades_s: time in which an angular acceleration becomes smaller by a factor of e, s: this, or
            the window's length if that is shorter, for the change within it is known less well.
        of_walk: variance of w's change over that of the random walk that windows have shown.
        of_direction: the same of v's over that of the options.
        of_fit: the covariance of w now is that of the window's w, that of its change by the slice,
            times this, and that of a random walk from the slice's middle on.
        of_drift: part of the drift that windows have shown in the rate of that walk.
        least_since_s: time at least in which a change that was not expected came about, s: the walk
            is as fast.
        newest_ns: the newest part of the events, which first shows that the camera stops, ns.
        too_fast: w over what the events allow that cannot be, in standard deviations: their speed
            is known within a factor of two.
        mean_ns: time on either side whose readings of a gyro are averaged, ns.
        gyro_error: standard deviation of a difference of two such means, rad/s.
        gyro_fresh_ns: largest age of the newest reading where the gyro alone tells the motion, ns.
        live_gap: variance of w by the gap after readings that end at a mean's middle, (rad/s)^2: as
            much is usual, and not added.
        usual_surprise: mean square of the latest twists' errors by later windows over the told
            covariance: it is scaled by how far that of this recording is off. 60 random recordings.
        least_scale: of the covariance.
        most_surprise: that counts.
        of_surprise: share of a window in that mean.
    """

    longest_ns: int = 600_000_000
    events: int = 8_000
    fewest_events: int = 300
    fades_s: float = 0.06
    of_walk: float = 8.0
    of_direction: float = 0.1
    of_fit: float = 0.2
    of_drift: float = 0.02
    least_since_s: float = 0.02
    newest_ns: int = 20_000_000
    too_fast: float = 3.0
    mean_ns: int = 5_000_000
    gyro_error: float = radians(0.3)
    gyro_fresh_ns: int = 20_000_000
    live_gap: float = 0.025**2
    usual_surprise: float = 0.5
    least_scale: float = 0.5
    most_surprise: float = 10.0
    of_surprise: float = 0.1


STREAM = StreamSettings()
PRESENT = PresentSettings()
