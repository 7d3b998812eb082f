"""Numbers that tune the back end: one table."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ErrorLaw:
    """How the variance of a motion's error goes with what shows it (core.back_end.consistency).

    Powers and factors were chosen on the errors of 85 recordings, 77 of them random, some left out
    in turn to see what it is worth (docs/experiments.md). Angles are in rad, times in s.

    Attributes:
        angular: factor on the covariance of the angular velocity, 1/s.
        direction: factor on the variance of the direction.
        of_gyro: share in it of the variance of a gyro's w over the squared speed.
        bias: factor on the covariance of a gyro's bias.
        first: factor on the lattice's covariance where the memory tells no motion yet.
        share: of the newest window in running means.
        usual_revision, usual_turn: before the first one.
        usual_excess: of a gyro's bias over what was known, squared, over the covariance: that of w
            is scaled by how far this recording's is off. 60 random recordings.
        least_factor: of that scale, for places may tell little.
        least: added to each; the least share of patches, and the least speed (1/s), that count.
        least_cost: of an observation: fewer errors than expected are not believed.
        unknown_angle: that counts where a direction is unknown.
    """

    angular: float = 130.0
    direction: float = 0.37
    of_gyro: float = 0.5
    bias: float = 4.0
    first: float = 3.0
    share: float = 0.15
    usual_revision: float = 0.07
    usual_turn: float = 0.37
    usual_excess: float = 0.27
    least_factor: float = 0.3
    least: float = 0.01
    least_cost: float = 0.6
    unknown_angle: float = 1.2


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
        least_angular_walk_deg, least_velocity_walk: never less: a camera at rest will move.
        speed_sd: standard deviation of each component of the velocity, 1/s.
        depth_sd: of an inverse depth around the mean one.
        depths: least and largest inverse depth.
        lattice_sd_deg: added to the covariance of the lattice's angular velocity, deg/s:
            successive windows overlap, and share their errors.
        gyro_parts: of a window that a gyro tells apart: 1, 2, 4 or 8.
        unseen_px: standard deviation of the way of the image in a window in which the lattice sees
            no motion, px.
        lattice_outlier: distance in standard deviations from which it counts little: far out, for
            its covariance is believed.
        refuted, refuting_share: distance of the lattice's angular velocity from the adjusted one in
            standard deviations, with what is added to its covariance, and share of the patches
            followed so far that the newest slice shows. Above the one and below the other the
            memory is forgotten: a motion has begun at once.
        temperature: cost, times the misfit, by which a way is e times less likely than another.
        same_direction_deg: ways whose directions are nearer are one, deg.
        rotation_cost: cost per patch that a translation must save; below, the camera only rotates.
        directions: of translation that are tried while the memory fills.
        directions_at: numbers of nodes at which they are tried, below `slices`.
        start_speed: of these, 1/s.
        expected_cost: mean robust cost of an observation where the covariance is right.
        errors: how far a motion is to be believed.
        widest_direction_deg: standard deviation of a direction that is reported, deg.
        patch_depth_sd, node_depth_sd: standard deviation of an inverse depth over the mean one, by
            a patch's places or a window's flow, at which it counts half in the scene's depths:
            places are too sure of it.
        steps: of the adjustment at most.
        guess: bounds like `outlier` that the adjustment of a guess begins with, and steps.
    """

    slices: int = 10
    newest: int = 5
    apart_s: float = 0.1
    fewest_patches: int = 12
    outlier: float = 2.0
    angular_walk_deg: float = 40.0
    velocity_walk: float = 1.5
    learning: float = 0.3
    least_angular_walk_deg: float = 3.0
    least_velocity_walk: float = 0.1
    speed_sd: float = 2.0
    depth_sd: float = 2.0
    depths: tuple[float, float] = (0.01, 20.0)
    lattice_sd_deg: float = 1.5
    gyro_parts: int = 4
    unseen_px: float = 1.5
    lattice_outlier: float = 20.0
    refuted: float = 9.0
    refuting_share: float = 0.6
    temperature: float = 20.0
    same_direction_deg: float = 7.0
    rotation_cost: float = 1.25
    directions: int = 18
    directions_at: tuple[int, ...] = (4, 6, 8)
    start_speed: float = 0.3
    expected_cost: float = 0.25
    errors: ErrorLaw = ErrorLaw()
    widest_direction_deg: float = 60.0
    patch_depth_sd: float = 0.03
    node_depth_sd: float = 0.3
    steps: int = 5
    guess: tuple[tuple[float, int], ...] = ((6.0, 3), (2.0, 2))

    @property
    def angular_walk(self) -> float:
        """Power spectral density that the walk of the angular velocity starts with, rad^2/s^3."""
        return float(np.radians(self.angular_walk_deg)) ** 2
