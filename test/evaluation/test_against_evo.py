"""Errors of trajectories against the package evo, which defines them for the field."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.types.events import NS_PER_MS
from emoflow_ros.evaluation.trajectory_errors import Trajectory

metrics = pytest.importorskip("evo.core.metrics", reason="no evo: pip install evo")
from evo.core.trajectory import PoseTrajectory3D  # noqa: E402

STEP = 100 * NS_PER_MS
STEPS_PER_S = 10


def wandering(seed: int, scale: float = 1.0, noise: float = 0.0) -> np.ndarray:
    """Poses (60, 4, 4) along a smooth way; noise makes them stray from it."""
    rng = np.random.default_rng(3)
    strayed = np.random.default_rng(seed)
    poses = [np.eye(4)]
    turn, speed = rng.normal(size=3), np.array([0.2, 0.1, 1.0])
    for _ in range(59):
        turn, speed = turn + 0.3 * rng.normal(size=3), speed + 0.1 * rng.normal(size=3)
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec(
            0.1 * (turn + noise * strayed.normal(size=3))
        ).as_matrix()
        step[:3, 3] = 0.1 * scale * (speed + noise * strayed.normal(size=3))
        poses.append(poses[-1] @ step)
    return np.stack(poses)


@pytest.fixture(params=[0, 1, 2])
def run(request: pytest.FixtureRequest) -> Trajectory:
    """A way that strays, at a scale and in a world of its own."""
    estimated = wandering(request.param, scale=0.37, noise=0.3)
    world = np.eye(4)
    world[:3, :3] = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    world[:3, 3] = [5.0, 6.0, -7.0]
    return Trajectory(np.arange(60) * STEP, estimated, world @ wandering(9))


def as_evo(times: np.ndarray, poses: np.ndarray) -> PoseTrajectory3D:
    return PoseTrajectory3D(poses_se3=list(poses), timestamps=times / 1e9)


def both(run: Trajectory, *, scale: bool) -> tuple[PoseTrajectory3D, PoseTrajectory3D]:
    """The true and the aligned estimated trajectory, aligned by evo."""
    true, ours = as_evo(run.times, run.true), as_evo(run.times, run.estimated)
    ours.align(true, correct_scale=scale)
    return true, ours


def test_ate_after_a_similarity_alignment(run: Trajectory) -> None:
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(both(run, scale=True))
    np.testing.assert_allclose(run.scaled().absolute_errors, ape.error, atol=1e-9)
    assert ape.get_statistic(metrics.StatisticsType.rmse) > 0.05


def test_ate_after_a_rigid_alignment(run: Trajectory) -> None:
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(both(run, scale=False))
    np.testing.assert_allclose(run.absolute_errors, ape.error, atol=1e-9)


def test_the_scale_is_umeyama_s(run: Trajectory) -> None:
    true, ours = as_evo(run.times, run.true), as_evo(run.times, run.estimated)
    _, _, scale = ours.align(true, correct_scale=True)
    assert run.best_scale == pytest.approx(scale, rel=1e-9)
    assert 1.5 < scale < 5


@pytest.mark.parametrize(
    ("relation", "column"), [("translation_part", 0), ("rotation_angle_deg", 1)]
)
def test_relative_errors_over_a_second(run: Trajectory, relation: str, column: int) -> None:
    rpe = metrics.RPE(metrics.PoseRelation[relation], delta=STEPS_PER_S, all_pairs=True)
    rpe.process_data(both(run, scale=True))
    np.testing.assert_allclose(run.scaled().relative_errors(1.0)[:, column], rpe.error, atol=1e-6)


def test_ways(run: Trajectory) -> None:
    true = as_evo(run.times, run.true)
    assert run.length == pytest.approx(true.path_length)
    along = true.distances
    np.testing.assert_allclose(run.ways(1.0), along[STEPS_PER_S:] - along[:-STEPS_PER_S])
