import numpy as np

from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.window_events import PARTS, WindowEvents

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


def test_a_window_without_events_has_empty_cells():
    here = events(2).at(np.zeros(2, bool)).on(LATTICE)
    assert len(here.s) == 0 and not here.begin.any()
