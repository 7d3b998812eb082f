import numpy as np
import pytest

from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.window_events import PARTS, WindowEvents

LATTICE = Lattice(120, 90, 5, 4)


def events(count: int = 1000) -> WindowEvents:
    rng = np.random.default_rng(1)
    x, y = rng.integers(0, 120, count).astype("f4"), rng.integers(0, 90, count).astype("f4")
    x[:2], y[:2] = [0, 119], [0, 89]
    s = np.sort(rng.random(count)).astype("f4")
    return WindowEvents(x, y, s, np.arange(1, count + 1, dtype="f4"))  # weights number them


def test_events_are_sorted_by_cell_and_by_time_within_a_cell():
    given = events()
    here = given.on(LATTICE)
    assert here.begin[0] == 0 and here.begin[-1] == len(given)
    number = here.weights.astype(int) - 1
    np.testing.assert_array_equal(np.sort(number), np.arange(len(given)))
    for mine, its in ((here.x, given.x), (here.y, given.y), (here.s, given.s)):
        np.testing.assert_array_equal(mine, its[number])
    at = np.stack([given.x, given.y], axis=1)[number] * LATTICE.per_px
    cell = np.minimum(at.astype(int), [3, 2])
    np.testing.assert_array_equal(
        np.repeat(np.arange(12), np.diff(here.begin)), cell[:, 0] * 3 + cell[:, 1]
    )
    np.testing.assert_allclose(np.stack([here.right, here.down], axis=1), at - cell, atol=1e-5)
    for begin, end in zip(here.begin[:-1], here.begin[1:], strict=True):
        assert (np.diff(number[begin:end]) > 0).all()


def test_parts_are_of_equal_numbers_in_the_order_of_time():
    given = events(1001)
    here = given.on(LATTICE)
    number = here.weights.astype(int) - 1
    np.testing.assert_array_equal(np.bincount(here.part), np.diff(np.arange(5) * 1001 // PARTS))
    assert (np.diff(here.part[np.argsort(number)]) >= 0).all()


def test_they_are_sorted_once_for_each_lattice():
    given = events()
    assert given.on(LATTICE) is given.on(Lattice(120, 90, 5, 4))
    assert given.on(LATTICE) is not given.on(Lattice(120, 90, 4, 4))
    assert given.every(2).on(LATTICE) is not given.on(LATTICE)
    assert given.every(2) is given.every(2)
    assert given.every(1) is given


def test_a_part_holds_the_events_of_its_times_both_ends_included():
    whole = events()
    begin, end = whole.s[100], whole.s[300]
    part = whole.between(begin, end)
    inside = (whole.s >= begin) & (whole.s <= end)
    assert 0 < np.count_nonzero(inside) < len(whole)
    for name in ("x", "y", "s", "weights"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[inside])
    assert len(whole.between(-0.2, -0.1)) == len(whole.between(1.1, 1.2)) == 0


def test_a_window_without_events_has_empty_cells():
    here = events(2).at(np.zeros(2, bool)).on(LATTICE)
    assert len(here.s) == 0 and not here.begin.any()


def evenly(per_pixel: int, seed=4) -> WindowEvents:
    """Every pixel of 120 x 88 has this many events, in random order."""
    pixels = np.tile(np.arange(120 * 88), per_pixel)
    rng = np.random.default_rng(seed)
    rng.shuffle(pixels)
    y, x = np.divmod(pixels, 120)
    s = rng.random(len(pixels)).astype(np.float32)
    return WindowEvents.prepare(x.astype(np.float32), y.astype(np.float32), s, s < 0.5)


def test_weights_are_the_inverse_root_of_the_density_with_the_polaritys_sign():
    sparse, dense = evenly(1), evenly(4)
    np.testing.assert_allclose(np.abs(sparse.weights), np.abs(sparse.weights[0]), rtol=1e-5)
    np.testing.assert_allclose(np.abs(dense.weights), np.abs(sparse.weights[0]) / 2, rtol=1e-5)
    np.testing.assert_array_equal(dense.weights > 0, dense.s < 0.5)


def test_strong_texture_counts_no_more_than_weak():
    """Four times the events in one half: the weights make up for nearly all of it."""
    y, x = np.mgrid[:88, :120].reshape(2, -1)
    repeats = np.where(x < 60, 4, 1)
    x, y = (np.repeat(c, repeats).astype(np.float32) for c in (x, y))
    weights = WindowEvents.prepare(x, y, np.zeros_like(x), np.ones(len(x), bool)).weights
    ratio = weights[x > 90].mean() / weights[x < 30].mean()
    assert 1.7 < ratio < 2


def test_a_lone_event_stays_weak():
    y, x = np.mgrid[:88, :60].reshape(2, -1).astype(np.float32)
    x, y = np.append(x, 119), np.append(y, 0).astype(np.float32)
    weights = WindowEvents.prepare(
        x.astype(np.float32), y, np.zeros(len(x), np.float32), np.ones(len(x), bool)
    ).weights
    assert 2 < weights[-1] / weights[0] < 10  # by its density alone it would be 30 and more


def test_thinning_weighs_as_if_the_rest_had_never_been():
    events = evenly(6)
    thin = events.every(3)
    assert len(thin) == len(events) // 3
    np.testing.assert_array_equal(thin.x, events.x[::3])
    np.testing.assert_array_equal(thin.s, events.s[::3])
    np.testing.assert_allclose(np.abs(thin.weights), np.abs(evenly(2).weights[0]), rtol=1e-5)
    assert (thin.weights**2).sum() == pytest.approx((events.weights**2).sum(), rel=1e-5)
