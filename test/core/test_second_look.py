"""A second look at windows, on points that move together."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.contrast import Contrast, WindowEvents
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.normal_equations import NotPositiveDefiniteError
from emoflow_ros.core.second_look import SecondLook, distance, fresh_start

LATTICE = Lattice.with_spacing(160, 120, 26.0)
NODES = LATTICE.columns * LATTICE.rows
CONTRASTS = {scale: Contrast(LATTICE, scale) for scale in (0.25, 0.5)}
MOVED = np.array([9.0, -5.0], np.float32)


ACROSS = LATTICE.pixels.reshape(LATTICE.columns, LATTICE.rows, 1, 2)[..., :1]
TRUE = (np.zeros(LATTICE.shape) + MOVED * (1 + 0.3 * (ACROSS - 80) / 80)).astype(np.float32)


def constant(x: float, y: float) -> np.ndarray:
    return np.zeros(LATTICE.shape, np.float32) + np.array([x, y], np.float32)


@pytest.fixture(scope="module")
def events() -> WindowEvents:
    """300 points, 20 events each along a way that grows to the right, noise of half a pixel."""
    rng = np.random.default_rng(3)
    s = rng.uniform(0, 1, 6000).astype(np.float32)
    points = np.repeat(rng.uniform([12, 12], [148, 108], (300, 2)), 20, axis=0)
    way = MOVED * (1 + 0.3 * (points[:, :1] - 80) / 80)
    x, y = (points + (s[:, None] - 0.5) * way + rng.normal(0, 0.5, (6000, 2))).T
    on = np.repeat(rng.random(300) < 0.5, 20)
    order = np.argsort(s)
    return WindowEvents.prepare(*(c[order].astype(np.float32) for c in (x, y, s)), on[order])


@pytest.fixture(scope="module")
def found(events) -> np.ndarray:
    fresh = fresh_start(CONTRASTS[0.25], events, LATTICE.shape)
    return SecondLook(LATTICE, Contrast, LatticeConfig()).flow(events, fresh)


def test_it_finds_the_flow_by_itself(found):
    errors = np.linalg.norm(found - TRUE, axis=-1)[1:-1, 1:-1]
    assert np.median(errors) < 0.7
    assert errors.max() < 2.0


def test_a_wrong_flow_is_far_from_it_and_the_right_one_close(found):
    evidence = np.ones(NODES)
    assert distance(TRUE, found, evidence) < 0.7
    assert distance(-TRUE, found, evidence) > 15.0


def test_nodes_count_by_their_evidence():
    moved = constant(0, 0)
    moved[0, 0] = 3.0, 4.0
    evidence = np.zeros(NODES)
    evidence[0], evidence[1] = 1.0, 3.0
    assert distance(moved, constant(0, 0), evidence) == pytest.approx(np.sqrt(25 / 4))
    assert distance(moved, constant(0, 0), np.zeros(NODES)) == 0.0


def test_weights_that_are_not_finite_have_no_flow(events):
    broken = replace(events, weights=events.weights * np.float32(np.nan))
    with pytest.raises(NotPositiveDefiniteError):
        SecondLook(LATTICE, Contrast, LatticeConfig()).flow(broken, constant(0, 0))


def test_a_copy_from_a_checkpoint_finds_the_same(events):
    look = SecondLook(LATTICE, Contrast, LatticeConfig())
    flows = [one.begin(events)[1].result() for one in (look, pickle.loads(pickle.dumps(look)))]
    np.testing.assert_array_equal(*flows)
