"""Events of one window as the fit takes them: weighed, and sorted by the cells of a lattice."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.numerics.smoothing import gaussian, outwards, smooth

PARTS = 4  # parts of the window whose images are compared
PAIRS = PARTS / (PARTS - 1)  # all pairs of events over the pairs of events from different parts

_DENSITY_CELL = LATTICE.density_cell  # numba reads no fields
_DENSITY_TAPS = outwards(gaussian(2.0))  # the density's smoothing, in these cells

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


class CellEvents(NamedTuple):
    """A window's events sorted by the lattice's cell, and by time within each cell.

    All events of a cell have the same nodes. So what depends on the nodes stays in registers while
    a kernel goes through a cell, and the compiler makes vector instructions of such loops.

    Attributes:
        x, y: (N,) px.
        right, down: (N,) place within the cell, from 0 at its left and upper side to 1.
        s: (N,) time in [0, 1] over the window.
        weights: (N,).
        part: (N,) part of the window, 0 to PARTS - 1.
        begin: (cells + 1,) where each cell's events begin; the cells of a column follow each other.
    """

    x: F32
    y: F32
    right: F32
    down: F32
    s: F32
    weights: F32
    part: I32
    begin: I32

    @classmethod
    def of(cls, x: F32, y: F32, s: F32, weights: F32, lattice: Lattice, parts: int) -> "CellEvents":
        """Sort events, (N,) each, by cell; they come in the order of time.

        The parts have equal numbers of them.
        """
        count = len(x)
        cells = (lattice.columns - 1) * (lattice.rows - 1)
        begin = np.zeros(cells + 1, np.int32)
        a, b, c, d, e, f = np.empty((6, count), np.float32)
        result = cls(a, b, c, d, e, f, np.empty(count, np.int32), begin)
        _sort(x, y, s, weights, lattice.per_px, lattice.rows, cells, parts, result)
        return result


@dataclass(frozen=True)
class WindowEvents:
    """Events of one window, in the order of time.

    Attributes:
        x, y: (N,) px.
        s: (N,) time in [0, 1] over the window.
        weights: (N,) polarity (+-1) over the square root of the density around.
    """

    x: F32
    y: F32
    s: F32
    weights: F32
    # Two threads may both sort or thin: the results are equal.
    _sorted: dict[Lattice, CellEvents] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _thinned: dict[int, "WindowEvents"] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def prepare(cls, x: F32, y: F32, s: F32, on: NDArray[np.bool_]) -> "WindowEvents":
        """Weigh events by their polarity and density."""
        both = _count(x, y)
        floor = LATTICE.density_floor * both[0].mean()
        smooth(both, _DENSITY_TAPS)
        size = _DENSITY_CELL / np.sqrt(both[0] / both[1] + floor)
        return cls(x, y, s, _choose(x, y, on, size))

    def every(self, step: int) -> "WindowEvents":
        """Thin out to each step-th event; the weights make up for it.

        The result is kept: the same step gives the same object.
        """
        if step == 1:
            return self
        found = self._thinned.get(step)
        if found is None:
            x, y, s, weights = (
                np.ascontiguousarray(c[::step]) for c in (self.x, self.y, self.s, self.weights)
            )
            found = WindowEvents(x, y, s, weights * np.float32(np.sqrt(step)))
            self._thinned[step] = found
        return found

    def between(self, begin: float, end: float) -> "WindowEvents":
        """Take the events of a part of the window, begin and end in [0, 1], as views."""
        first = int(np.searchsorted(self.s, np.float32(begin)))
        last = int(np.searchsorted(self.s, np.float32(end), side="right"))
        return WindowEvents(*(c[first:last] for c in (self.x, self.y, self.s, self.weights)))

    def at(self, chosen: NDArray[np.bool_]) -> "WindowEvents":
        """Take the events of a mask (N,)."""
        return WindowEvents(*(c[chosen] for c in (self.x, self.y, self.s, self.weights)))

    def on(self, lattice: Lattice) -> CellEvents:
        """Sort them by the cells of a lattice, unless that was done before."""
        found = self._sorted.get(lattice)
        if found is None:
            found = CellEvents.of(self.x, self.y, self.s, self.weights, lattice, PARTS)
            self._sorted[lattice] = found
        return found

    def __len__(self) -> int:
        return len(self.x)


@njit(nogil=True)
def _count(x: F32, y: F32) -> F32:
    """Return (2, rows, columns): the number of events in each density cell, and ones."""
    side = np.float32(_DENSITY_CELL)
    both = np.ones((2, int(y.max() / side) + 1, int(x.max() / side) + 1), np.float32)
    both[0] = 0
    for k in range(len(x)):
        both[0, int(y[k] / side), int(x[k] / side)] += 1
    return both


@njit(nogil=True)
def _choose(x: F32, y: F32, on: NDArray[np.bool_], size: F32) -> F32:
    """Take each event's value (N,) from its density cell's `size`, negative where it is not on."""
    side = np.float32(_DENSITY_CELL)
    weights = np.empty(len(x), np.float32)
    for k in range(len(x)):
        weight = size[int(y[k] / side), int(x[k] / side)]
        weights[k] = weight if on[k] else -weight
    return weights


@njit(nogil=True)
def _sort(
    x: F32, y: F32, s: F32, weights: F32, per_px: F32, rows: int, cells: int, parts: int,
    out: CellEvents,
) -> None:  # fmt: skip
    """Sort events by counting; see `CellEvents.of`."""
    count, down = len(x), np.int32(rows - 1)
    cell = np.empty(count, np.int32)
    right = np.int32(cells // down)
    for k in range(count):
        c = min(np.int32(x[k] * per_px[0]), right - np.int32(1))
        r = min(np.int32(y[k] * per_px[1]), down - np.int32(1))
        cell[k] = c * down + r
        out.begin[cell[k] + 1] += 1
    for i in range(cells):
        out.begin[i + 1] += out.begin[i]
    following = out.begin[:-1].copy()
    for part in range(parts):
        for k in range(part * count // parts, (part + 1) * count // parts):
            i = cell[k]
            at = following[i]
            following[i] = at + 1
            c = i // down
            out.x[at], out.y[at], out.s[at], out.weights[at] = x[k], y[k], s[k], weights[k]
            out.right[at] = x[k] * per_px[0] - np.float32(c)
            out.down[at] = y[k] * per_px[1] - np.float32(i - c * down)
            out.part[at] = part
