"""Direction of travel with its sign, from nothing but a noisy flow: search, then cheirality.

The search knows a direction up to its sign; the sign is the one that puts the scene before the
camera. Hundreds of random motions, through three lenses; the truth serves the comparison only.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.epipolar import cheirality
from emoflow_ros.core.lattice import Lattice

Array = NDArray[np.float64]

LENSES = {
    "plumb_bob": (-0.34, 0.14, 0.0004, -0.0003),
    "rational_polynomial": (0.52, -2.7, 8e-4, -5e-4, 1.58, 0.4, -2.5, 1.5),
    "equidistant": (-0.048, 0.0113, -0.0554, 0.0215),
}
LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
MOTIONS = 200  # for each lens


@pytest.fixture(scope="module", params=LENSES)
def epipolar(request) -> NodeEpipolar:
    camera = Camera(346, 260, 226.4, 226.2, 173.6, 133.7, request.param, LENSES[request.param])
    return NodeEpipolar(camera, LATTICE, 0.7)


def noisy_flow(epipolar: NodeEpipolar, v: Array, w: Array, rng, noise_px: float) -> Array:
    """Flow at the nodes, px per window, of a relief that is passed in 7 to 28 windows."""
    inverse_depth = np.exp(-rng.uniform(np.log(7), np.log(28), NODES))
    exact = inverse_depth[:, None] * (epipolar.a @ v) + epipolar.b @ w
    return exact + rng.normal(scale=noise_px, size=exact.shape)


def signed_direction(epipolar: NodeEpipolar, flow: Array) -> tuple[Array, float]:
    """Best direction of the search, turned so that the scene lies in front; the agreement."""
    directions, rotations, costs = epipolar.search(flow, np.tile(np.eye(2), (NODES, 1, 1)))
    best = int(costs.argmin())
    normalised = np.einsum("nij,nj->ni", epipolar.to_bearing, flow)
    agreement = cheirality(
        epipolar.bearings, normalised, directions[best], rotations[best], np.ones(NODES)
    )
    return np.copysign(1.0, agreement) * directions[best], abs(agreement)


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
    """A rotation has no sign of v; agreement of its noise is far below that of a translation."""
    rng = np.random.default_rng(2)
    v = np.array([0.6, -0.48, 0.64])
    of_rotations, of_translations = [], []
    for _ in range(50):
        w = rng.normal(scale=0.02, size=3)
        turning = epipolar.b @ w + rng.normal(scale=0.2, size=(NODES, 2))
        of_rotations.append(signed_direction(epipolar, turning)[1])
        of_translations.append(signed_direction(epipolar, noisy_flow(epipolar, v, w, rng, 0.2))[1])
    assert np.median(of_rotations) < 0.4
    assert min(of_translations) > 0.9
