"""The compiled terms of the epipolar constraint against the same in NumPy."""

import numpy as np
import pytest
from motion_fields import (
    INLIER_PX,
    LATTICE,
    NODES,
    motion_field,
    random_motions,
    structure_residuals,
)

from emoflow_ros.core.lattice.constraints import add_constraint, add_structure
from emoflow_ros.core.lattice.egomotion import MOTION_UNKNOWNS, Motion, Residuals
from emoflow_ros.core.lattice.normal_equations import NormalEquations

STIFFNESS, SHARE = 3.0, 1.5


def equations_of(*terms: tuple[Residuals, np.ndarray]) -> NormalEquations:
    equations = NormalEquations(LATTICE, MOTION_UNKNOWNS)
    for found, weight in terms:
        equations.add_rows(found.by_flow, found.by_motion, weight, found.r)
    return equations


def assert_same(found: NormalEquations, expected: NormalEquations) -> None:
    for one, other in zip(found.parts, expected.parts, strict=True):
        assert np.abs(other).max() > 0
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())


@pytest.fixture
def usable(epipolar):
    """As if the lens had no inverse at every eleventh node."""
    return epipolar.usable & (np.arange(NODES) % 11 > 0)


@pytest.fixture
def scene(epipolar, usable):
    """A flow with noise, a motion that changes, and depths; a fifth of the flow is reversed.

    Nodes that do not count hold a flow of 10 000 px.
    """
    rng = np.random.default_rng(5)
    v, w, inverse_depth = next(random_motions(4))
    flow = motion_field(epipolar, v, w, inverse_depth)[:, None] + rng.normal(
        size=(NODES, LATTICE.times, 2)
    )
    flow[::5] *= -1
    flow[~usable] = 1e4
    motion = Motion(w + rng.normal(scale=0.01, size=(2, 3)), v + 0.2 * rng.normal(size=(2, 3)), 1.3)
    return flow, motion, inverse_depth


@pytest.mark.parametrize("front", [-1.0, 0.0, 1.0])
def test_the_constraint_and_what_would_come_from_behind(epipolar, scene, usable, front):
    flow, motion, _ = scene
    dec = epipolar.residuals(flow, motion)
    length = structure_residuals(epipolar, flow, motion, np.zeros(NODES))
    behind = front * length.r < 0
    assert behind.any() == (front != 0) and not behind.all()
    expected = equations_of(
        (dec, usable[:, None] * STIFFNESS * epipolar.robust_weight(dec.r)),
        (length, (usable[:, None] & behind) * STIFFNESS * epipolar.robust_weight(length.r)),
    )
    found = equations_of()
    add_constraint(
        *epipolar.kernel_arguments(flow, motion), usable, INLIER_PX, STIFFNESS, front,
        *found.parts,
    )  # fmt: skip
    assert_same(found, expected)


def test_known_depths(epipolar, scene, usable):
    """Nodes without information on their depth do not count."""
    flow, motion, inverse_depth = scene
    information = np.random.default_rng(6).uniform(0, 50, NODES)
    information[::7] = 0.0
    heading = motion.at(0.5)[1]
    residuals = structure_residuals(epipolar, flow, motion, inverse_depth)
    squared = ((epipolar.a @ heading) ** 2).sum(-1) + epipolar.soft**2
    counted = usable & (information > 0)
    variance = np.where(counted, squared / np.where(counted, information, 1.0), np.inf)[:, None]
    weight = SHARE / variance / (1 + residuals.r**2 / (9 * variance + 1)) ** 2
    found = equations_of()
    add_structure(
        *epipolar.kernel_arguments(flow, motion), usable, heading, motion.speed,
        inverse_depth, information, SHARE, *found.parts,
    )  # fmt: skip
    assert_same(found, equations_of((residuals, weight)))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_scene_behind_the_camera_is_known_by_the_sign_of_v(epipolar, sign):
    """Whichever sign v has in the fit: `front` says along which one the camera moves."""
    v = np.array([0.8, 0.0, 0.6])
    flow = np.repeat(0.05 * (epipolar.a @ v)[:, None], LATTICE.times, 1)
    flow[::10] *= -1
    motion = Motion.constant(np.zeros(3), sign * v)
    added = []
    for front in (0.0, float(sign)):
        found = equations_of()
        add_constraint(
            *epipolar.kernel_arguments(flow, motion), epipolar.usable, INLIER_PX, STIFFNESS, front,
            *found.parts,
        )  # fmt: skip
        added.append(found.band[:, 0].reshape(NODES, -1).sum(1))
    length = np.linalg.norm(flow[:, 0], axis=-1)
    expected = LATTICE.times * STIFFNESS / (1 + (length / INLIER_PX) ** 2) ** 2
    expected[(np.arange(NODES) % 10 > 0) | ~epipolar.usable] = 0.0
    np.testing.assert_allclose(added[1] - added[0], expected, rtol=1e-3, atol=1e-9)
