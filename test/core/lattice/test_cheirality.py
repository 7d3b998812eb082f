"""Direction of translation with its sign, from nothing but a noisy flow: search, then cheirality.

The search knows a direction up to its sign; the sign is the one that puts the scene before the
camera. Hundreds of random motions, through three lenses; the truth serves the comparison only.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import cheirality
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice

Array = NDArray[np.float64]

LENSES = {
    "plumb_bob": (-0.34, 0.14, 0.0004, -0.0003),
    "rational_polynomial": (0.52, -2.7, 8e-4, -5e-4, 1.58, 0.4, -2.5, 1.5),
    "equidistant": (-0.048, 0.0113, -0.0554, 0.0215),
}
LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
MOTIONS = 200  # for each lens
INLIER_PX = 0.7
CERTAIN = np.tile(np.eye(2), (NODES, 1, 1))


@pytest.fixture(scope="module", params=LENSES)
def epipolar(request) -> NodeEpipolar:
    camera = Camera(346, 260, 226.4, 226.2, 173.6, 133.7, request.param, LENSES[request.param])
    return NodeEpipolar(camera, LATTICE, INLIER_PX)


def noisy_flow(epipolar: NodeEpipolar, v: Array, w: Array, rng, noise_px: float) -> Array:
    """Flow at the nodes, px per window, of a relief that is passed in 7 to 28 windows."""
    inverse_depth = np.exp(-rng.uniform(np.log(7), np.log(28), NODES))
    exact = inverse_depth[:, None] * (epipolar.a @ v) + epipolar.b @ w
    return exact + rng.normal(scale=noise_px, size=exact.shape)


def agreement_with(epipolar: NodeEpipolar, flow: Array, v: Array, w: Array) -> float:
    """Cheirality, all nodes counting alike."""
    normalised = np.einsum("nij,nj->ni", epipolar.to_bearing, flow)
    return cheirality(epipolar.bearings, normalised, v, w, np.ones(NODES))


def signed_direction(epipolar: NodeEpipolar, flow: Array) -> tuple[Array, float]:
    """Best direction of the search, turned so that the scene lies in front; the agreement."""
    found = epipolar.search(flow, CERTAIN)
    best = int(found.cost.argmin())
    agreement = agreement_with(epipolar, flow, found.v[best], found.w[best])
    return np.copysign(1.0, agreement) * found.v[best], abs(agreement)


@pytest.mark.parametrize(
    ("noise_px", "typical_deg", "wrong_percent"), [(0.2, 10, 0), (1.0, 10, 0), (4.0, 20, 2)]
)
def test_random_motions_keep_their_sign_in_noise(epipolar, noise_px, typical_deg, wrong_percent):
    """White noise of up to half of the translational flow, which is 8 to 32 px."""
    rng = np.random.default_rng(1)
    angles = []
    for _ in range(MOTIONS):
        v = rng.normal(size=3)
        v /= np.linalg.norm(v)
        flow = noisy_flow(epipolar, v, rng.normal(scale=0.02, size=3), rng, noise_px)
        found, _ = signed_direction(epipolar, flow)
        angles.append(np.degrees(np.arccos(np.clip(found @ v, -1, 1))))
    assert np.median(angles) < typical_deg  # directions of the search are 16 degrees apart
    assert 100 * np.mean(np.array(angles) > 90) <= wrong_percent


def test_opposite_motions_are_found_opposite(epipolar):
    """The same noise: nothing but the sign of the translational flow tells them apart."""
    for seed in range(50):
        rng = np.random.default_rng(seed)
        v, w = rng.normal(size=(2, 3))
        v /= np.linalg.norm(v)
        ahead, back = (
            signed_direction(
                epipolar, noisy_flow(epipolar, sign * v, 0.02 * w, np.random.default_rng(seed), 0.1)
            )[0]
            for sign in (1, -1)
        )
        assert ahead @ v > 0.9
        assert back @ v < -0.9


def test_agreement_is_low_where_nothing_tells_the_sign(epipolar):
    """A rotation has no sign of v; agreement of its noise is far below that of a translation.

    For any v, that is: the one found in the noise is the one that it agrees with.
    """
    rng = np.random.default_rng(2)
    v = np.array([0.6, -0.48, 0.64])
    of_rotations, of_translations = [], []
    for _ in range(50):
        w = rng.normal(scale=0.02, size=3)
        turning = epipolar.b @ w + rng.normal(scale=0.2, size=(NODES, 2))
        found = epipolar.score(v, turning, CERTAIN)
        of_rotations.append(abs(agreement_with(epipolar, turning, v, found.w[0])))
        of_translations.append(signed_direction(epipolar, noisy_flow(epipolar, v, w, rng, 0.2))[1])
    assert np.median(of_rotations) < 0.4
    assert min(of_translations) > 0.9


@pytest.mark.parametrize("sign", [1, -1])
def test_a_scene_behind_the_camera_costs_its_whole_flow(epipolar, sign):
    """A tenth of the flow turned round stays on its lines: what is wrong is its side alone."""
    v = np.array([0.6, -0.48, 0.64])
    flow = noisy_flow(epipolar, v, np.zeros(3), np.random.default_rng(13), 0.0)
    turned = np.arange(NODES) % 10 == 0
    flow[turned] *= -1
    found = epipolar.score(sign * v, flow, 1e4 * CERTAIN)
    np.testing.assert_allclose(found.w[0], 0, atol=1e-6)
    squares = (flow[turned & epipolar.usable] ** 2).sum(-1)
    assert found.residual == pytest.approx(
        1e4 * np.sum(squares / (1 + squares / INLIER_PX**2)), rel=1e-3
    )
