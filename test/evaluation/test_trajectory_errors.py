"""Integrated velocities against closed forms, and pose errors against slow implementations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.types.estimate import Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS
from emoflow_ros.evaluation.summary import summarise
from emoflow_ros.evaluation.trajectory_errors import Trajectory, integrate, longest, trajectories
from emoflow_ros.evaluation.window_results import WindowResult
from emoflow_ros.truth import TrueTwist

STEP = 100 * NS_PER_MS


def pose(rotation, position):
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = Rotation.from_rotvec(rotation).as_matrix(), position
    return transform


def random_poses(n, seed, scale=1.0):
    rng = np.random.default_rng(seed)
    return np.stack([pose(scale * rng.normal(size=3), rng.normal(size=3)) for _ in range(n)])


def test_circle_in_closed_form():
    """Forward at 2 m/s, turning at 0.5 rad/s about y: a circle of 4 m, in any number of steps."""
    times = np.array([0, 300, 1000, 1100, 4000]) * NS_PER_MS
    n = len(times)
    poses = integrate(times, np.tile([0, 0.5, 0], (n, 1)), np.tile([0, 0, 2.0], (n, 1)))
    angle = 0.5 * times / 1e9
    centre_x = np.stack([4 * (1 - np.cos(angle)), 0 * angle, 4 * np.sin(angle)], axis=-1)
    np.testing.assert_allclose(poses[:, :3, 3], centre_x, atol=1e-12)
    turned = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    np.testing.assert_allclose(turned, np.outer(angle, [0, 1, 0]), atol=1e-12)


def test_changing_velocity_is_met_to_second_order():
    """x'(t) = cos t: the trapezoidal rule's error falls fourfold with half the step."""
    errors = []
    for n in (11, 21):
        times = np.linspace(0, 2e9, n).astype(np.int64)
        linear = np.stack([np.cos(times / 1e9), 0 * times, 0 * times], axis=-1)
        poses = integrate(times, np.zeros((n, 3)), linear)
        errors.append(abs(poses[-1, 0, 3] - np.sin(2.0)))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def slow_relative_errors(times, estimated, true, span):
    """Pair by pair, with rotations as matrices and the angle from the trace."""
    found = []
    for i in range(len(times)):
        later = [j for j in range(i + 1, len(times)) if times[j] - times[i] >= span]
        if not later:
            continue
        j = later[0]
        ours = np.linalg.inv(estimated[i]) @ estimated[j]
        theirs = np.linalg.inv(true[i]) @ true[j]
        difference = np.linalg.inv(theirs) @ ours
        angle = np.degrees(np.arccos((np.trace(difference[:3, :3]) - 1) / 2))
        found.append((np.sqrt((difference[:3, 3] ** 2).sum()), angle))
    return found


@pytest.mark.parametrize("span_s", [0.0, 0.25, 0.3, 10.0])
def test_relative_errors_equal_the_slow_implementation(span_s):
    times = np.arange(9) * STEP
    run = Trajectory(times, random_poses(9, 1), random_poses(9, 2))
    ours = run.relative_errors(span_s)
    expected = slow_relative_errors(times, run.estimated, run.true, span_s * 1e9)
    assert len(ours) == len(expected)
    np.testing.assert_allclose(ours, np.reshape(expected, (-1, 2)), atol=1e-6)


def slow_alignment(ours, true):
    """Kabsch's solution by a singular value decomposition."""
    a, b = ours - ours.mean(axis=0), true - true.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    flip = np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))])
    return a @ (vt.T @ flip @ u.T).T + true.mean(axis=0)


def test_absolute_errors_equal_the_slow_implementation():
    run = Trajectory(np.arange(12) * STEP, random_poses(12, 3), random_poses(12, 4))
    aligned = slow_alignment(run.estimated[:, :3, 3], run.true[:, :3, 3])
    expected = [np.sqrt((difference**2).sum()) for difference in aligned - run.true[:, :3, 3]]
    np.testing.assert_allclose(run.absolute_errors, expected, atol=1e-9)


def test_alignment_takes_any_rigid_motion_out_but_no_scale():
    true = random_poses(10, 5)
    moved = pose([0.3, -1.0, 2.0], [5.0, 6.0, -7.0]) @ true
    run = Trajectory(np.arange(10) * STEP, moved, true)
    np.testing.assert_allclose(run.absolute_errors, 0, atol=1e-9)
    moved[:, :3, 3] *= 2
    assert Trajectory(run.times, moved, true).absolute_errors.max() > 0.5


def window(index, start_ms, linear=(0, 0, 1), speed=2.0, usable=True):
    """A window of 100 ms of a camera that turns about y and drives forward on a circle."""
    t = (start_ms + 50) / 1000
    angle = 0.5 * t
    radius = speed / 0.5
    position = [radius * (1 - np.cos(angle)), 0, radius * np.sin(angle)]
    return WindowResult(
        index=index,
        t_start=start_ms * NS_PER_MS,
        t_end=(start_ms + 100) * NS_PER_MS,
        events=10,
        status=Status.OK if usable else Status.DIVERGED,
        model="full",
        linear=np.array(linear, float),
        angular=np.array([0, 0.5, 0]) if usable else np.full(3, np.nan),
        sigma=np.full(6, np.nan),
        truth=TrueTwist(np.array([0, 0.5, 0]), np.array([0, 0, speed])),
        flow=None,
        quality=Quality(events=10),
        pose=pose([0.1, 0.2, 0.3], [3, 2, 1]) @ pose([0, angle, 0], position),
    )


def test_perfect_velocities_have_no_errors():
    measures = {m.key: m for m in summarise([window(k, 100 * k) for k in range(30)])}
    for key in ("rpe_step_deg", "rpe_deg", "oracle_rpe_m", "oracle_ate_m"):
        assert measures[key].value == pytest.approx(0, abs=1e-6), key
    assert measures["rpe_step_deg"].windows == 29
    assert measures["rpe_deg"].windows == 20
    assert measures["oracle_ate_m"].windows == 30
    assert "oracle" in measures["oracle_ate_m"].label


def test_given_speed_is_no_oracle_and_counts_as_given():
    """Twice the true speed on a straight line of 2.9 s at 2 m/s: twice as long after aligning."""
    straight = [
        replace(
            window(k, 100 * k),
            angular=np.zeros(3),
            pose=pose([0, 0, 0], [0, 0, 0.2 * k]),
        )
        for k in range(30)
    ]
    measures = {m.key: m.value for m in summarise(straight, speed=4.0)}
    assert "oracle_ate_m" not in measures
    along = 0.2 * (np.arange(30) - 14.5)
    assert measures["ate_m"] == pytest.approx(np.sqrt((along**2).mean()))
    assert measures["rpe_m"] == pytest.approx(2.0)


def straight(positions, linear=(0, 0, 1)):
    """Windows every 100 ms of a camera that drives along z, through these positions (m)."""
    return [
        replace(
            window(k, 100 * k, linear),
            angular=np.zeros(3),
            truth=None,
            pose=pose([0.1, 0.2, 0.3], [3, 2, 1]) @ pose([0, 0, 0], [0, 0, z]),
        )
        for k, z in enumerate(positions)
    ]


def local_figures(windows):
    keys = ("sim3_ate_m", "way_m", "drift_percent", "drift_deg_m")
    return {m.key: m.value for m in summarise(windows) if m.key in keys}


def test_up_to_scale_a_circle_at_one_speed_has_no_errors():
    found = local_figures([window(k, 100 * k) for k in range(30)])
    assert found.pop("way_m") == pytest.approx(2.0 * 2.9, rel=1e-3)
    assert found == pytest.approx({"sim3_ate_m": 0, "drift_percent": 0, "drift_deg_m": 0}, abs=1e-5)


def test_up_to_scale_nothing_is_taken_from_the_true_speed():
    """Of a camera that speeds up stays what the best straight line through time leaves."""
    steps = np.arange(30)
    positions = 0.2 * steps + 0.01 * steps**2
    line = np.polyval(np.polyfit(steps, positions, 1), steps)
    left = np.sqrt(((line - positions) ** 2).mean())
    assert local_figures(straight(positions))["sim3_ate_m"] == pytest.approx(left)
    assert left > 0.5


def test_up_to_scale_relative_speeds_count_up_to_one_factor():
    """Unknown ones lie between their neighbours."""
    steps = np.arange(30)
    windows = straight(0.2 * steps + 0.01 * steps**2)
    speeds = 7.0 * (0.2 + 0.02 * steps)
    speeds[[0, 11, 12]] = np.nan, np.nan, np.nan
    known = [replace(w, relative_speed=v) for w, v in zip(windows, speeds, strict=True)]
    found = local_figures(known)
    assert found["sim3_ate_m"] == pytest.approx(0, abs=2e-3)
    assert found["drift_percent"] == pytest.approx(0, abs=0.2)
    assert local_figures(windows)["sim3_ate_m"] > 0.5


def test_drift_of_a_direction_that_is_ten_degrees_off():
    """One alignment takes it out of the positions, and none out of the way of a second."""
    off = np.radians(10)
    found = local_figures(straight(0.2 * np.arange(30), (np.sin(off), 0, np.cos(off))))
    assert found["sim3_ate_m"] == pytest.approx(0, abs=1e-9)
    assert found["drift_percent"] == pytest.approx(100 * 2 * np.sin(off / 2))


def test_drift_of_rotation_per_metre():
    """A turn of 3 deg/s that is not there, at 2 m/s."""
    turning = [replace(w, angular=np.radians([0, 0, 3.0])) for w in straight(0.2 * np.arange(30))]
    assert local_figures(turning)["drift_deg_m"] == pytest.approx(1.5)


def test_few_poses_say_nothing_up_to_scale():
    assert "sim3_ate_m" in local_figures([window(k, 100 * k) for k in range(4)])
    assert local_figures([window(k, 100 * k) for k in range(3)]) == {}


def test_rotation_only_has_no_length():
    still = [replace(window(k, 100 * k), linear=np.full(3, np.nan)) for k in range(30)]
    keys = {m.key for m in summarise(still)}
    assert "rpe_deg" in keys
    assert not keys & {"oracle_ate_m", "oracle_rpe_m", "sim3_ate_m", "drift_percent"}


def test_runs_break_at_gaps_and_lost_windows():
    starts = [0, 100, 200, 300, 500, 600, 650, 700, 2000]
    windows = [window(k, start, usable=start != 200) for k, start in enumerate(starts)]
    runs = trajectories(windows)
    middles = [[int(t // NS_PER_MS) - 50 for t in run.times] for run in runs]
    assert middles == [[0, 100], [500, 600, 650, 700]]
    assert longest(runs) is runs[1]
    assert longest([]) is None


def test_length_of_the_true_path():
    poses = np.stack([pose([0, 0, 0], p) for p in ([0, 0, 0], [3, 4, 0], [3, 4, 2])])
    assert Trajectory(np.arange(3) * STEP, poses, poses).length == pytest.approx(7)
