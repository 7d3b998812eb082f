"""Where the evidence of motion lies, and whether the rest of the image moves along."""

import numpy as np
import pytest

from emoflow_ros.core.lattice.confinement import is_confined, spot, spread
from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.window_events import WindowEvents

LATTICE = Lattice.with_spacing(346, 260, 26.0)
CONTRAST = Contrast(LATTICE, 1.0)
MOVED = np.zeros(LATTICE.shape, np.float32) + np.array([8.0, -5.0], np.float32)


def spread_of(lattice: Lattice, evidence: np.ndarray) -> float:
    return spread(lattice, spot(lattice, evidence)[1])


def test_spread_is_the_area_of_a_spot():
    """Of m x n nodes the variances are (m^2 - 1) / 12 cells along x, likewise y; noise is even."""
    block = np.zeros((14, 11))
    block[3:8, 2:6] = 2.5
    area = np.sqrt((5**2 - 1) * (4**2 - 1)) * np.prod(1 / LATTICE.per_px) / (346 * 260)
    assert spread_of(LATTICE, block.ravel()) == pytest.approx(area, rel=1e-6)
    assert spread_of(LATTICE, (block + 7 * SHARE).ravel()) == pytest.approx(
        area, rel=1e-6
    )  # even noise


SHARE = np.outer([0.5, *[1] * 12, 0.5], [0.5, *[1] * 9, 0.5])  # of a cell, around a node


def test_evidence_all_over_the_image_spreads_over_all_of_it():
    checkers = np.indices((14, 11)).sum(0) % 2
    assert spread_of(LATTICE, (checkers * SHARE).ravel()) == pytest.approx(1.0, abs=0.02)
    assert spread_of(LATTICE, SHARE.ravel()) == pytest.approx(1.0)
    random = np.random.default_rng(1).gamma(1.0, size=(50, 14, 11)) * SHARE
    assert min(spread_of(LATTICE, e.ravel()) for e in random) > 0.8


def test_evidence_on_a_line_has_no_spread():
    for seed in range(20):
        line = np.zeros((14, 11))
        first, step = np.random.default_rng(seed).integers(1, 5, 2)
        line[first + 2 * np.arange(3), step + np.arange(3)] = 1.0
        assert spread_of(LATTICE, line.ravel()) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("nodes", [3, 4])
def test_few_nodes_cannot_tell_a_spot(nodes):
    lattice = Lattice(64, 64, nodes, nodes)
    one = np.zeros((nodes, nodes))
    one[1, 1] = 1.0
    assert spread_of(lattice, one.ravel()) == pytest.approx(1.0)


def dots(rng, low, high, count: int, *, moves: bool) -> list[np.ndarray]:
    """Points in a box that leave 20 events each, along the flow or all over the box."""
    s = rng.uniform(0, 1, 20 * count)
    points = rng.uniform(low, high, (count, 2)).repeat(20, axis=0)
    if not moves:
        points = rng.uniform(low, high, points.shape).round()
    points = points + moves * (s[:, None] - 0.5) * np.array([8.0, -5.0])
    on = np.repeat(rng.random(count) < 0.5, 20)
    return [points[:, 0], points[:, 1], s, on.astype(float)]


def window(rest_moves: bool | None) -> WindowEvents:
    """A dense spot of 50 x 50 px that moves, and the rest of the image with 1200 events."""
    rng = np.random.default_rng(2)
    parts = [dots(rng, (150, 100), (200, 150), 300, moves=True)]
    if rest_moves is not None:
        parts += [
            dots(rng, low, high, 15, moves=rest_moves)
            for low, high in (
                ((20, 20), (120, 80)), ((230, 20), (330, 80)),
                ((20, 180), (120, 240)), ((230, 180), (330, 240)),
            )
        ]  # fmt: skip
    x, y, s, on = (np.concatenate(c) for c in zip(*parts, strict=True))
    order = np.argsort(s)
    return WindowEvents.prepare(*(c[order].astype(np.float32) for c in (x, y, s)), on[order] > 0.5)


EVIDENCE = np.zeros((14, 11))
EVIDENCE[5:9, 3:7] = 5.0


@pytest.mark.parametrize(("rest_moves", "confined"), [(True, False), (False, True), (None, True)])
def test_a_spot_is_all_that_moves_unless_the_events_elsewhere_move_along(rest_moves, confined):
    events = window(rest_moves)
    assert is_confined(LATTICE, CONTRAST, events, MOVED, EVIDENCE.ravel()) is confined


def test_evidence_all_over_the_image_is_no_spot_whatever_the_events():
    even = np.random.default_rng(1).gamma(1.0, size=14 * 11)
    assert not is_confined(LATTICE, CONTRAST, window(None), MOVED, even)


def test_the_middle_of_the_evidence():
    middle, _ = spot(LATTICE, EVIDENCE.ravel())
    np.testing.assert_allclose(middle, np.array([6.5, 4.5]) / LATTICE.per_px, rtol=1e-5)
