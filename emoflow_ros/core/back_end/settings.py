"""Numbers that tune the back end: one table."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BackEndSettings:
    """How the motion is adjusted to the places of patches.

    All were chosen on random recordings and those of another simulator (docs/experiments.md).
    Lengths are in mean depths of the scene, so that nothing scales with the scene.

    Attributes:
        slices: nodes of the adjustment at most.
        newest: of these are all slices; earlier ones are thinned out.
        apart_s: that earlier ones lie apart at least, s.
        fewest_patches: with fewer there is no adjustment.
        outlier: distance in standard deviations from which a place counts little.
        angular_walk_deg, velocity_walk: random walk of angular velocity, deg/s per square root of
            a second, and of velocity, 1/s per square root of a second, before anything is known.
        learning: share of the newest evidence in what is learnt of them.
        learnt_excess: factor on what is learnt: cameras move by fits and starts.
        angular_walks_deg, velocity_walks: least and largest of them.
        speed_sd: standard deviation of each component of the velocity, 1/s.
        depth_sd: of an inverse depth around the mean one.
        depths: least and largest inverse depth.
        most_growth: share of a patch's area that it may change by from node to node: else its depth
            is not believed.
        lattice_sd_deg, gyro_sd_deg: added to the covariance of the lattice's angular velocity, and
            of a gyro's, deg/s: successive windows overlap, and share their errors.
        lattice_outlier: distance in standard deviations from which it counts little: far out, for
            its covariance is believed.
        refuted, refuting_cost: distance of the lattice's angular velocity from the adjusted one in
            standard deviations, with what is added to its covariance, and mean robust cost of an
            observation over `expected_cost`. Beyond both the memory is forgotten: a motion has
            begun at once.
        rotation_cost: cost per patch that a translation must save; below, the camera only rotates.
        surely_translates: cost per patch from which that is checked now and then only.
        check_every: adjustments between such checks.
        directions: of translation that are tried while the memory fills.
        directions_at: numbers of nodes at which they are tried.
        start_speed: of these, 1/s.
        expected_cost: mean robust cost of an observation where the covariance is right.
        least_cost: over that: fewer errors than expected are not believed.
        excess: factor on the covariance (core.back_end.consistency).
        leakage: standard deviation of the velocity per rad/s of rotation, besides: a share of a
            rotation is taken for travel.
        fewest_shown: patches that are counted at least there.
        revision_share: of the newest revision in their mean.
        usual_revision, most_revision: before the first one, and at most.
        widest_direction_deg: standard deviation of a direction that is reported, deg.
        settled_s: that the nodes reach back before the flow is fitted again with their motion, s.
        steps, rotation_steps: of the adjustment at most, and of a camera that only rotates.
        guess: bounds like `outlier` that the adjustment of a guess begins with, and steps.
        promising: cost after these over the least so far up to which a guess is adjusted further.
    """

    slices: int = 14
    newest: int = 5
    apart_s: float = 0.06
    fewest_patches: int = 12
    outlier: float = 2.0
    angular_walk_deg: float = 40.0
    velocity_walk: float = 1.5
    learning: float = 0.3
    learnt_excess: float = 1.4
    angular_walks_deg: tuple[float, float] = (10.0, 400.0)
    velocity_walks: tuple[float, float] = (0.3, 5.0)
    speed_sd: float = 2.0
    depth_sd: float = 2.0
    depths: tuple[float, float] = (0.01, 20.0)
    most_growth: float = 0.5
    lattice_sd_deg: float = 1.5
    gyro_sd_deg: float = 0.6
    lattice_outlier: float = 20.0
    refuted: float = 9.0
    refuting_cost: float = 1.3
    rotation_cost: float = 1.25
    surely_translates: float = 3.75
    check_every: int = 3
    directions: int = 18
    directions_at: tuple[int, ...] = (4, 6, 8)
    start_speed: float = 0.3
    expected_cost: float = 0.25
    least_cost: float = 0.6
    excess: float = 50.0
    leakage: float = 0.01
    fewest_shown: int = 5
    revision_share: float = 0.1
    usual_revision: float = 0.1
    most_revision: float = 2.0
    widest_direction_deg: float = 60.0
    settled_s: float = 0.3
    steps: int = 5
    rotation_steps: int = 6
    guess: tuple[tuple[float, int], ...] = ((6.0, 3), (2.0, 2))
    promising: float = 1.05

    @property
    def angular_walk(self) -> float:
        """Power spectral density that the walk of the angular velocity starts with, rad^2/s^3."""
        return float(np.radians(self.angular_walk_deg)) ** 2
