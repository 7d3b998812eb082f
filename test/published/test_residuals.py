"""Residuals of a motion by hand and by differences; their covariance by Monte-Carlo."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from emoflow_ros.core.geometry.camera_motion import motion_matrices
from emoflow_ros.published.assess import epipolar_residuals, rotation_residuals

Array = NDArray[np.float64]

SAMPLES = 1500
PATCH = 0.2  # of bearings: within it the flow has one error
NOISE = 0.03  # 1/s: 0.6 px over 90 ms at a focal length of 226 px
MOTIONS = 60


class Scene:
    """Bearings with the exact flow (N, 2) 1/s of a random motion before a relief of 1 to 4 m."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.bearings = rng.uniform((-0.77, -0.58), (0.77, 0.58), (SAMPLES, 2))
        patches = (self.bearings // PATCH).astype(int)
        _, self.patch = np.unique(patches, axis=0, return_inverse=True)
        self.patches = int(self.patch.max()) + 1
        depth = rng.uniform(1, 4, self.patches)[self.patch]
        v, w = rng.normal(size=(2, 3))
        self.v, self.w = v / np.linalg.norm(v), 0.2 * w
        a, b = motion_matrices(self.bearings)
        self.rotation = b @ self.w
        self.flow = (a @ self.v) / depth[:, None] + self.rotation

    def noise(self, rng: np.random.Generator) -> Array:
        """Normal errors (N, 2), the same for all samples of a patch."""
        return rng.normal(scale=NOISE, size=(self.patches, 2))[self.patch]

    @property
    def share(self) -> float:
        return self.patches / SAMPLES


def everywhere(vector: Array) -> Array:
    return np.broadcast_to(vector, (SAMPLES, 3))


def normalised(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def test_exact_flow_leaves_nothing_and_a_shift_across_the_line_leaves_itself() -> None:
    for seed in range(20):
        scene = Scene(np.random.default_rng(seed))
        v, w = everywhere(-3 * scene.v), everywhere(scene.w)  # neither sign nor scale matters
        assert np.abs(epipolar_residuals(scene.bearings, scene.flow, v, w).r).max() < 1e-12
        a, _ = motion_matrices(scene.bearings)
        line = a @ scene.v / np.linalg.norm(a @ scene.v, axis=1, keepdims=True)
        across = np.stack([line[:, 1], -line[:, 0]], axis=1)
        shifted = scene.flow + 0.3 * across + 0.7 * line
        r = epipolar_residuals(scene.bearings, shifted, v, w).r
        np.testing.assert_allclose(np.abs(r), 0.3, atol=1e-12)
        shift = np.tile([0.1, -0.2], (SAMPLES, 1))
        r = rotation_residuals(scene.bearings, scene.rotation + shift, w).r
        np.testing.assert_allclose(r.reshape(-1, 2), shift)


def test_derivatives_of_both_kinds() -> None:
    rng = np.random.default_rng(1)
    scene = Scene(rng)
    flow = scene.flow + scene.noise(rng)
    v, w = everywhere(scene.v), everywhere(scene.w)
    h = 1e-6
    full = epipolar_residuals(scene.bearings, flow, v, w)
    turning = rotation_residuals(scene.bearings, flow, w)
    a, _ = motion_matrices(scene.bearings)
    far = np.linalg.norm(a @ scene.v, axis=1) > 0.5  # from the focus of expansion
    assert far.sum() > SAMPLES // 2
    for step in h * full.freedom.T:
        ahead, behind = (
            epipolar_residuals(scene.bearings, flow, v + sign * step[:3], w + sign * step[3:]).r
            for sign in (1, -1)
        )
        found = full.by_motion @ step / h
        np.testing.assert_allclose(found[far], ((ahead - behind) / (2 * h))[far], rtol=0.05)
    for step in h * np.eye(3):
        ahead, behind = (
            rotation_residuals(scene.bearings, flow, w + sign * step).r for sign in (1, -1)
        )
        slope = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(turning.by_motion[:, 3:] @ step / h, slope, atol=1e-6)
    assert not turning.by_motion[:, :3].any()


def test_errors_of_random_motions_are_as_large_as_the_covariance_says() -> None:
    """The mean normalised squared error of w and of v across its direction is about 1."""
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(MOTIONS):
        scene = Scene(rng)
        flow = scene.flow + scene.noise(rng)
        across = np.linalg.svd(scene.v[None])[2][1:]

        def motion(x: Array, scene: Scene = scene, across: Array = across) -> tuple[Array, Array]:
            v = scene.v + x[:2] @ across
            return v / np.linalg.norm(v), scene.w + x[2:]

        def left(x: Array, scene: Scene = scene, flow: Array = flow) -> Array:
            v, w = motion(x)
            return epipolar_residuals(scene.bearings, flow, everywhere(v), everywhere(w)).r

        v, w = motion(least_squares(left, np.zeros(5)).x)
        residuals = epipolar_residuals(scene.bearings, flow, everywhere(v), everywhere(w))
        covariance = residuals.covariance(scene.share)
        tangent = residuals.freedom[:3, :2].T
        towards = tangent @ scene.v
        angle = np.arccos(np.clip(v @ scene.v, -1, 1)) * towards / np.linalg.norm(towards)
        errors.append(
            (
                normalised(w - scene.w, covariance[3:, 3:]),
                normalised(angle, tangent @ covariance[:3, :3] @ tangent.T),
            )
        )
    of_w, of_v = np.mean(errors, axis=0)
    assert 0.5 < of_w < 2
    assert 0.5 < of_v < 2


def test_errors_of_random_rotations_are_as_large_as_the_covariance_says() -> None:
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(MOTIONS):
        scene = Scene(rng)
        flow = scene.rotation + scene.noise(rng)
        _, b = motion_matrices(scene.bearings)
        w = np.linalg.lstsq(b.reshape(-1, 3), flow.ravel(), rcond=None)[0]
        residuals = rotation_residuals(scene.bearings, flow, everywhere(w))
        covariance = residuals.covariance(scene.share)
        assert not covariance[:3].any()
        errors.append(normalised(w - scene.w, covariance[3:, 3:]))
    assert 0.5 < np.mean(errors) < 2


def test_a_fit_that_stopped_short_says_so() -> None:
    """Exact flow and a motion beside the true one: the covariance reaches as far as the truth."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        scene = Scene(rng)
        covariance = epipolar_residuals(
            scene.bearings, scene.flow, everywhere(scene.v), everywhere(scene.w)
        ).covariance(scene.share)
        assert np.abs(covariance).max() < 1e-12
        off = rng.normal(scale=0.02, size=3)
        short = epipolar_residuals(
            scene.bearings, scene.flow, everywhere(scene.v), everywhere(scene.w + off)
        )
        assert normalised(off, short.covariance(scene.share)[3:, 3:]) < 0.7


def test_inliers_lie_within_three_robust_deviations() -> None:
    rng = np.random.default_rng(5)
    scene = Scene(rng)
    flow = scene.rotation + rng.normal(scale=NOISE, size=(SAMPLES, 2))
    flow[:150] += 10.0  # a tenth of the samples sees something else
    residuals = rotation_residuals(scene.bearings, flow, everywhere(scene.w))
    assert residuals.scale == pytest.approx(1.13 * NOISE, rel=0.1)
    assert not residuals.inliers[:300].any()
    assert residuals.inliers[300:].mean() > 0.99


def test_what_nothing_tells_is_unknown() -> None:
    """Without translation the flow says nothing of its direction."""
    rng = np.random.default_rng(6)
    scene = Scene(rng)
    flow = scene.rotation
    residuals = epipolar_residuals(
        scene.bearings, flow, everywhere(scene.v), everywhere(scene.w + 1e-3)
    )
    covariance = residuals.covariance(scene.share)
    assert np.trace(covariance[:3, :3]) > 1
    assert np.trace(covariance[3:, 3:]) < 1e-3
