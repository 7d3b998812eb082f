"""The trajectory that estimated velocities add up to, and its errors against true poses.

The definitions are those of the package `evo` (github.com/MichaelGrupp/evo), which a test compares.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.evaluation.window_results import WindowResult

RELATIVE_SPAN_S = 1.0
_FEWEST_POSES = 4  # a similarity has 7 unknowns: it fits any two positions exactly
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
        return self._rotated + self.true[:, :3, 3].mean(axis=0)

    @property
    def _rotated(self) -> Points:
        """Estimated positions (N, 3) around their mean, rotated onto the true ones."""
        ours, true = (_around_mean(poses[:, :3, 3]) for poses in (self.estimated, self.true))
        with warnings.catch_warnings():  # on a straight line the roll is arbitrary
            warnings.simplefilter("ignore", UserWarning)
            rotation, _ = Rotation.align_vectors(true, ours)
        return np.asarray(rotation.apply(ours))

    @property
    def best_scale(self) -> float:
        """Factor of the estimated lengths in the similarity of least squares (Umeyama)."""
        rotated = self._rotated
        along = (rotated * _around_mean(self.true[:, :3, 3])).sum()
        return float(along / (rotated**2).sum())

    def scaled(self) -> "Trajectory":
        """Return the same run, its estimated lengths at the best scale.

        Aligned as a rigid body then, it is aligned by a similarity: the rotation does not depend
        on the scale.
        """
        estimated = self.estimated.copy()
        estimated[:, :3, 3] *= self.best_scale
        return replace(self, estimated=estimated)

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
        return float(self._way[-1])

    @property
    def _way(self) -> NDArray[np.float64]:
        """Length (N,) of the true path up to each pose, m."""
        steps = np.diff(self.true[:, :3, 3], axis=0)
        return np.concatenate([[0.0], np.linalg.norm(steps, axis=-1).cumsum()])

    def ways(self, span_s: float) -> NDArray[np.float64]:
        """Lengths (M,) in m of the true path over the spans of `relative_errors`."""
        starts, ends = self._spans(span_s)
        return np.asarray(self._way[ends] - self._way[starts])

    def relative_errors(self, span_s: float) -> NDArray[np.float64]:
        """Errors of the motion over `span_s` or just above (Sturm et al., IROS 2012).

        Args:
            span_s: s; 0 takes the motion from each window to the next.

        Returns:
            (M, 2), translation in m and rotation in degrees, for every start that the run holds
            a pose of `span_s` later for; their RMS is the RPE.
        """
        starts, ends = self._spans(span_s)
        ours = np.linalg.inv(self.estimated[starts]) @ self.estimated[ends]
        true = np.linalg.inv(self.true[starts]) @ self.true[ends]
        off = np.linalg.inv(true) @ ours
        angles = Rotation.from_matrix(off[:, :3, :3]).magnitude() if len(off) else np.empty(0)
        return np.stack([np.linalg.norm(off[:, :3, 3], axis=-1), np.degrees(angles)], axis=-1)

    def _spans(self, span_s: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and last poses (M,) of all spans that the run holds."""
        ends = np.searchsorted(self.times, self.times + max(1, round(span_s * NS_PER_S)))
        starts = np.flatnonzero(ends < len(self.times))
        return starts, ends[starts]


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
    return [
        _integrated(run, _true_speeds(run) if speed is None else np.full(len(run), speed))
        for run in _unbroken(windows)
    ]


def local_path(windows: Sequence[WindowResult]) -> Trajectory | None:
    """Integrate the longest run up to scale, and scale it to the truth as a whole.

    The speeds are the relative ones of the windows. Where none is known, they lie between those
    before and after; where the run has none at all, it is taken to have one speed.

    Returns:
        None without a run of poses enough for a similarity to leave errors, or where nothing moves.
    """
    run = longest([_integrated(run, _relative_speeds(run)) for run in _unbroken(windows)])
    if run is None or len(run.times) < _FEWEST_POSES or not run.has_translation:
        return None
    return run.scaled()


def _unbroken(windows: Sequence[WindowResult]) -> list[list[WindowResult]]:
    runs: list[list[WindowResult]] = [[]]
    for window in windows:
        usable = window.pose is not None and np.isfinite(window.angular).all()
        if runs[-1] and (not usable or window.t_start > runs[-1][-1].t_end):
            runs.append([])
        if usable:
            runs[-1].append(window)
    return [run for run in runs if len(run) > 1]


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


def _integrated(run: Sequence[WindowResult], speeds: NDArray[np.float64]) -> Trajectory:
    times, true = _times(run), _true_poses(run)
    directions = np.nan_to_num([window.linear for window in run])
    angular = np.array([window.angular for window in run])
    return Trajectory(times, integrate(times, angular, speeds[:, None] * directions), true)


def _times(run: Sequence[WindowResult]) -> Times:
    return np.array([window.t for window in run])


def _true_poses(run: Sequence[WindowResult]) -> Poses:
    return np.stack([window.pose for window in run if window.pose is not None])


def _relative_speeds(run: Sequence[WindowResult]) -> NDArray[np.float64]:
    """Speeds (N,) up to one factor for the run."""
    speeds, times = np.array([window.relative_speed for window in run]), _times(run)
    known = np.isfinite(speeds)
    return np.interp(times, times[known], speeds[known]) if known.any() else np.ones(len(run))


def _true_speeds(run: Sequence[WindowResult]) -> NDArray[np.float64]:
    """True speed (N,) in m/s at the windows' middles; where unknown, that of the poses' steps."""
    slopes = np.gradient(_true_poses(run)[:, :3, 3], _times(run) / NS_PER_S, axis=0)
    return np.array(
        [
            np.linalg.norm(slope if w.truth is None or w.truth.linear is None else w.truth.linear)
            for w, slope in zip(run, slopes, strict=True)
        ]
    )


def _around_mean(points: Points) -> Points:
    return points - points.mean(axis=0)
