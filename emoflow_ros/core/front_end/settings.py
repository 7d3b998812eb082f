"""Numbers that tune the front end: one table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FrontEndSettings:
    """How slices are cut and patches followed.

    All were chosen on random recordings and those of another simulator (docs/experiments.md).
    Pixels are those of the tracking image, at most `longer_side_px` wide: they need no scaling with
    the sensor or the rate of events.

    Attributes:
        longer_side_px: longer side of the tracking image at most, px. A finer sensor is reduced:
            640 x 480 is as precise as the events' times allow.
        slice_px: way of a slice at the speed that `slice_share` of the image keeps to, px. Edges
            fire often enough within it, and a wrong flow blurs little.
        slice_share: quantile of the speed.
        longest_slice_s: a longer slice holds too much change of the motion, s.
        most_slices: of one window's new events: bounds the time.
        first_slices: the same while no motion is adjusted: it takes three nodes.
        most_events: of one slice; more are thinned evenly. 60 000 are drawn in 1 ms.
        own_sharpness: sharpness of a slice drawn along the remembered scene's flow, over that
            along the lattice's, from which the former is taken.
        correlation: least one of a patch that was found, and that something is learnt of.
        patience: in how many of the newest nodes a patch may be missing: where an edge stops it
            fires no events, and fires again.
        visible: least amplitude of what a patch shows along the present flow, over that of its
            first appearance.
        any_direction: share of the trace of its structure tensor by which slopes at a pixel may
            have any direction.
        least_speed: of a flow that has a direction, px/s.
        turned: least sine of the angle between the first flow and the present one from which that
            shows something new.
        learning: step of the least mean squares that learn slopes across the first flow.
        adjusted_px: nothing is learnt of a patch found further than this from where the adjusted
            motion puts it, px.
        expected_px: standard deviation of the place where a patch is expected, px.
        reach_px: a patch is not found further from there, px.
        border_px: of the image, where patches would be cut off, px.
        most_patches, distance_px: how many, and how far apart, px; more while the flow turns.
        distance: the same over the longer side of a small image, which has fewer px for its edges.
        edge_share: of the structure tensor's trace in the score of a patch: edges count, too.
        least_score: of a patch over the 99.5 % quantile of the scores.
        noise_px: of a place, however sharp the edges, px: rounding to pixels.
        ageing: growth of that variance per second: appearance changes.
    """

    longer_side_px: int = 640
    slice_px: float = 4.0
    slice_share: float = 0.7
    longest_slice_s: float = 0.1
    most_slices: int = 2
    first_slices: int = 4
    most_events: int = 60_000
    own_sharpness: float = 0.97
    correlation: float = 0.5
    patience: int = 5
    visible: float = 0.5
    any_direction: float = 0.3
    least_speed: float = 3.0
    turned: float = 0.3
    learning: float = 0.6
    adjusted_px: float = 2.0
    expected_px: float = 1.0
    reach_px: float = 7.0
    border_px: int = 5
    most_patches: int = 250
    distance_px: float = 5.0
    distance: float = 0.0145
    edge_share: float = 0.1
    least_score: float = 0.04
    noise_px: float = 0.08
    ageing: float = 3.75
