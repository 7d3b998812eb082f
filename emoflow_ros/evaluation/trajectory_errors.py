"""The trajectory that estimated velocities add up to, and its errors against true poses."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from emoflow_ros.core.events import NS_PER_S
from emoflow_ros.evaluation.window_results import WindowResult

RELATIVE_SPAN_S = 1.0
Poses = NDArray[np.float64]
Points = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True)
class Trajectory:
    """An unbroken run of windows: estimated and true poses at the windows' middles.

    Attributes:
        times: (N,) ns.
        estimated: (N, 4, 4) world-from-camera in m; its world is the first camera.
        true: (N, 4, 4) world-from-camera in m, in the truth's world.
    """

    times: Times
    estimated: Poses
    true: Poses

    @property
    def aligned(self) -> Points:
        """Estimated positions (N, 3) moved onto the true ones as a rigid body, without scaling.

        The rotation and translation of least squares (Umeyama, PAMI 1991, scale 1).
        """
        ours, true = self.estimated[:, :3, 3], self.true[:, :3, 3]
        with warnings.catch_warnings():  # on a straight line the roll is arbitrary
            warnings.simplefilter("ignore", UserWarning)
            rotation, _ = Rotation.align_vectors(true - true.mean(axis=0), ours - ours.mean(axis=0))
        return np.asarray(rotation.apply(ours - ours.mean(axis=0)) + true.mean(axis=0))

    @property
    def absolute_errors(self) -> NDArray[np.float64]:
        """Distances (N,) in m of the aligned positions; their RMS is the ATE."""
        return np.asarray(np.linalg.norm(self.aligned - self.true[:, :3, 3], axis=-1))

    @property
    def has_translation(self) -> bool:
        """Whether estimate and truth both move: without that, lengths say nothing."""
        return all(np.ptp(poses[:, :3, 3], axis=0).any() for poses in (self.estimated, self.true))

    @property
    def length(self) -> float:
        """Length of the true path, m."""
        steps = np.diff(self.true[:, :3, 3], axis=0)
        return float(np.linalg.norm(steps, axis=-1).sum())

    def relative_errors(self, span_s: float) -> NDArray[np.float64]:
        """Errors of the motion over `span_s` or just above (Sturm et al., IROS 2012).

        Args:
            span_s: s; 0 takes the motion from each window to the next.

        Returns:
            (M, 2), translation in m and rotation in degrees, for every start that the run holds
            a pose of `span_s` later for; their RMS is the RPE.
        """
        ends = np.searchsorted(self.times, self.times + max(1, round(span_s * NS_PER_S)))
        starts = np.flatnonzero(ends < len(self.times))
        ends = ends[starts]
        ours = np.linalg.inv(self.estimated[starts]) @ self.estimated[ends]
        true = np.linalg.inv(self.true[starts]) @ self.true[ends]
        off = np.linalg.inv(true) @ ours
        angles = Rotation.from_matrix(off[:, :3, :3]).magnitude() if len(off) else np.empty(0)
        return np.stack([np.linalg.norm(off[:, :3, 3], axis=-1), np.degrees(angles)], axis=-1)


def trajectories(windows: Sequence[WindowResult], speed: float | None = None) -> list[Trajectory]:
    """Integrate the estimates over every unbroken run of windows with true poses.

    A run ends at a window without angular velocity and where windows leave a gap. A window whose
    translation is not observable counts as one without translation.

    Args:
        windows: in the order of time.
        speed: the camera's, m/s; None takes that of the truth, window by window (an oracle).

    Returns:
        The runs of at least two windows.
    """
    runs: list[list[WindowResult]] = [[]]
    for window in windows:
        usable = window.pose is not None and np.isfinite(window.angular).all()
        if runs[-1] and (not usable or window.t_start > runs[-1][-1].t_end):
            runs.append([])
        if usable:
            runs[-1].append(window)
    return [_integrated(run, speed) for run in runs if len(run) > 1]


def integrate(times: Times, angular: Points, linear: Points) -> Poses:
    """Add up velocities to poses (N, 4, 4), the first of which is the identity.

    Between two times the camera moves with the mean of their velocities, along a screw.

    Args:
        times: (N,) ns.
        angular: (N, 3) rad/s in the camera's frame.
        linear: (N, 3) m/s in the camera's frame.
    """
    rates = np.zeros((len(times), 4, 4))
    x, y, z = angular.T
    rates[:, 0, 1], rates[:, 0, 2], rates[:, 1, 2] = -z, y, -x
    rates[:, :3, :3] -= rates[:, :3, :3].transpose(0, 2, 1)
    rates[:, :3, 3] = linear
    seconds = np.diff(times) / NS_PER_S
    steps = expm((rates[:-1] + rates[1:]) / 2 * seconds[:, None, None])
    poses = [np.eye(4)]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.stack(poses)


def longest(runs: Sequence[Trajectory]) -> Trajectory | None:
    """Return the run that lasts longest."""
    return max(runs, key=lambda run: int(run.times[-1] - run.times[0]), default=None)


def _integrated(run: Sequence[WindowResult], speed: float | None) -> Trajectory:
    times = np.array([window.t for window in run])
    true = np.stack([window.pose for window in run if window.pose is not None])
    directions = np.nan_to_num([window.linear for window in run])
    speeds = _true_speeds(run, times, true) if speed is None else np.full(len(run), speed)
    angular = np.array([window.angular for window in run])
    return Trajectory(times, integrate(times, angular, speeds[:, None] * directions), true)


def _true_speeds(run: Sequence[WindowResult], times: Times, true: Poses) -> NDArray[np.float64]:
    """True speed (N,) in m/s at the windows' middles; where unknown, that of the poses' steps."""
    slopes = np.gradient(true[:, :3, 3], times / NS_PER_S, axis=0)
    return np.array(
        [
            np.linalg.norm(slope if w.truth is None or w.truth.linear is None else w.truth.linear)
            for w, slope in zip(run, slopes, strict=True)
        ]
    )
