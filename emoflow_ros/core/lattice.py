"""The lattice field: flow on a coarse grid in space and time, linear in between."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

F32 = NDArray[np.float32]

TIMES = 2  # of the nodes of a fit: start and end of the window
_MOST_NODES = 18
# Midpoint steps per window of the dense products. Error below 1e-3 px where the flow is linear in
# time; some tenths of a px in intervals that end beside the kink of a strong tremor.
_SUBSTEPS = 4
_MOST_STEPS = 256  # bound the time that an interval far longer than the window takes


@dataclass(frozen=True)
class Lattice:
    """Nodes at equal distances over a sensor, from corner to corner, and over a window.

    Fields on it are (columns, rows, times, 2) in px per window; flattened in this order
    they are the unknowns of the normal equations, whose band is then narrow.

    Args:
        width, height: sensor size in pixels.
        columns, rows: nodes along x and y, at least 3 each.
        times: nodes in time: 2 for a fit, 1 where a field does not change within the window, more
            for sampling only.
    """

    width: int
    height: int
    columns: int
    rows: int
    times: int = TIMES

    @classmethod
    def with_spacing(cls, width: int, height: int, spacing_px: float) -> "Lattice":
        """Build the lattice whose nodes are about `spacing_px` apart, or more on large sensors.

        A lattice finer against the image than _MOST_NODES along its longer side would cost
        more than all events do.
        """
        spacing_px = max(spacing_px, (max(width, height) - 1) / (_MOST_NODES - 1))
        columns = max(3, round((width - 1) / spacing_px) + 1)
        rows = max(3, round((height - 1) / spacing_px) + 1)
        return cls(width, height, columns, rows)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of a field."""
        return self.columns, self.rows, self.times, 2

    @property
    def unknowns(self) -> int:
        """Number of values in a field."""
        return self.columns * self.rows * self.times * 2

    @property
    def bandwidth(self) -> int:
        """Largest distance of two coupled unknowns: two columns, by second differences."""
        return 4 * self.rows * self.times

    @cached_property
    def per_px(self) -> NDArray[np.float32]:
        """Cells per pixel in x and y, (2,)."""
        return np.array(
            [(self.columns - 1) / (self.width - 1), (self.rows - 1) / (self.height - 1)],
            np.float32,
        )

    @cached_property
    def pixels(self) -> NDArray[np.float64]:
        """Where the nodes are, (columns * rows, 2) px."""
        x = np.linspace(0, self.width - 1, self.columns)
        y = np.linspace(0, self.height - 1, self.rows)
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)

    @cached_property
    def to_image(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Linear interpolation to all pixels: weights (width, columns) and (height, rows)."""
        hat_x = np.maximum(0, 1 - np.abs(np.arange(self.width)[:, None] * self.per_px[0]
                                         - np.arange(self.columns)))  # fmt: skip
        hat_y = np.maximum(0, 1 - np.abs(np.arange(self.height)[:, None] * self.per_px[1]
                                         - np.arange(self.rows)))  # fmt: skip
        return hat_x.astype(np.float32), hat_y.astype(np.float32)

    @cached_property
    def second_differences(self) -> tuple[tuple[NDArray[np.int64], NDArray[np.float64]], ...]:
        """Nodes and coefficients of the second differences along x, y and across."""
        n = np.arange(self.columns * self.rows).reshape(self.columns, self.rows)
        straight = np.array([1.0, -2.0, 1.0])
        along_x = np.stack([n[:-2], n[1:-1], n[2:]], -1).reshape(-1, 3)
        along_y = np.stack([n[:, :-2], n[:, 1:-1], n[:, 2:]], -1).reshape(-1, 3)
        corners = [n[:-1, :-1], n[:-1, 1:], n[1:, :-1], n[1:, 1:]]
        across = np.stack(corners, -1).reshape(-1, 4)
        twist = np.sqrt(2.0) * np.array([1.0, -1.0, -1.0, 1.0])
        return (along_x, straight), (along_y, straight), (across, twist)

    def acceleration(self, flow: NDArray[np.float32]) -> NDArray[np.float32]:
        """Material derivative du/ds + (u . grad) u at the nodes, (columns, rows, 2)."""
        result = np.empty((self.columns, self.rows, 2), np.float32)
        material_derivative(flow, self.per_px, result)
        return result

    def interpolate(
        self, values: NDArray[np.float64], points: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Interpolate values at the nodes (nodes,) at points (N, 2) px, (N,)."""
        grid = values.reshape(self.columns, self.rows)
        return map_coordinates(grid, (points * self.per_px).T, order=1, mode="nearest")

    def at_time(self, flow: NDArray[np.float32], s: float) -> NDArray[np.float32]:
        """Interpolate a field in time, (columns, rows, 2); constant before 0 and after 1."""
        return _at_time(flow, s)

    def image(self, still: NDArray[np.float32]) -> NDArray[np.float32]:
        """Interpolate values (columns, rows, 2) at every pixel, (height, width, 2)."""
        hat_x, hat_y = self.to_image
        return np.stack([hat_y @ still[..., d].T @ hat_x.T for d in range(2)], axis=-1)

    def advance(
        self, flow: NDArray[np.float32], points: NDArray[np.float64], start: float, end: float
    ) -> NDArray[np.float64]:
        """Carry points (N, 2) px along dx/ds = u(s, x) from time `start` to `end`.

        The midpoint method, second order, with steps of at most 1 / 4 window (of more where the
        way is longer than 64 windows).
        """
        steps = min(_MOST_STEPS, max(1, int(np.ceil(abs(end - start) * _SUBSTEPS))))
        return _advance(flow, np.asarray(points, np.float64), start, end, steps, self.per_px)


@dataclass(frozen=True)
class LatticeFlow:
    """The flow of one window as an estimate carries it (a FlowSampler).

    Before and after the window the flow stays what it is at the window's start and end.

    Attributes:
        lattice: where the nodes are.
        values: the field, px per window.
        t_start, t_end: the window, ns.
    """

    lattice: Lattice
    values: NDArray[np.float32]
    t_start: int
    t_end: int

    def _position(self, t: int) -> float:
        return (t - self.t_start) / (self.t_end - self.t_start)

    def velocity(self, t: int) -> NDArray[np.float32]:
        """Flow at time t (ns), (height, width, 2) in px/s."""
        still = self.lattice.at_time(self.values, self._position(t))
        return self.lattice.image(still * np.float32(1e9 / (self.t_end - self.t_start)))

    def displacement(self, t0: int, t1: int) -> NDArray[np.float32]:
        """Displacement of the pixels of t0 until t1 (ns), (height, width, 2) px."""
        moved = self._advance(self._pixels, t0, t1)
        shape = (self.lattice.height, self.lattice.width, 2)
        return (moved - self._pixels).astype(np.float32).reshape(shape)

    def tracks(self, points: NDArray[np.float64], times: Sequence[int]) -> NDArray[np.float64]:
        """Positions (len(times), N, 2) px of points (N, 2) given at times[0] (ns)."""
        positions = [np.asarray(points, np.float64)]
        for t0, t1 in pairwise(times):
            positions.append(self._advance(positions[-1], t0, t1))
        return np.stack(positions)

    def _advance(self, points: NDArray[np.float64], t0: int, t1: int) -> NDArray[np.float64]:
        start, end = self._position(t0), self._position(t1)
        return self.lattice.advance(self.values, points, start, end)

    @property
    def _pixels(self) -> NDArray[np.float64]:
        grid = np.meshgrid(np.arange(self.lattice.width), np.arange(self.lattice.height))
        return np.stack(grid, axis=-1).reshape(-1, 2).astype(np.float64)


@numba.njit(cache=True, nogil=True)
def _advance(
    flow: F32, points: NDArray[np.float64], start: float, end: float, steps: int, per_px: F32
) -> NDArray[np.float64]:
    """Carry points (N, 2) px along a field by the midpoint method; see `Lattice.advance`."""
    h = (end - start) / steps
    x, y = points[:, 0].astype(np.float32), points[:, 1].astype(np.float32)
    moved, halfway = np.zeros((2, len(x)), np.float32), np.empty((2, len(x)), np.float32)
    for k in range(steps):
        s = start + k * h
        _step(_at_time(flow, s), per_px, x, y, moved, moved, 0.5 * h, halfway)
        _step(_at_time(flow, s + 0.5 * h), per_px, x, y, halfway, moved, h, moved)
    out = np.empty_like(points)
    for i in range(len(points)):
        known = np.isfinite(points[i, 0]) and np.isfinite(points[i, 1])
        for d in range(2):
            out[i, d] = points[i, d] + moved[d, i] if known else np.nan
    return out


@numba.njit(cache=True, nogil=True)
def _step(still: F32, per_px: F32, x: F32, y: F32, at: F32, begin: F32, h: float, out: F32) -> None:
    """Take one step of points: out = begin + h times the field at (x, y) + at.

    Displacements are in float32, and columns apart from rows: twice as fast as points in float64.

    Args:
        still: (columns, rows, 2) the field, constant beyond its border.
        per_px: cells per pixel in x and y.
        x, y: (N,) px.
        at, begin, out: (2, N) px; `out` is written and may be `begin`.
        h: length of the step.
    """
    columns, rows = still.shape[:2]
    nodes = np.ascontiguousarray(still).ravel()
    zero, one, share = np.float32(0), np.float32(1), np.float32(h)
    last_x, last_y = np.float32(columns - 1), np.float32(rows - 1)
    last_column, last_row = np.int32(columns - 2), np.int32(rows - 2)
    u, v = np.uint32(0), np.uint32(1)  # indices without a sign cannot count from the end
    down, right = np.uint32(2), np.uint32(2 * rows)
    for i in range(len(x)):
        px, py = (x[i] + at[0, i]) * per_px[0], (y[i] + at[1, i]) * per_px[1]
        px, py = px if px > zero else zero, py if py > zero else zero  # NaN becomes 0, too
        px, py = px if px < last_x else last_x, py if py < last_y else last_y
        c, r = min(np.int32(px), last_column), min(np.int32(py), last_row)
        a, b = px - np.float32(c), py - np.float32(r)
        h11 = a * b
        h10, h01 = a - h11, b - h11
        h00 = one - a - h01
        for d, component in ((0, u), (1, v)):
            node = np.uint32(np.int32(2) * (c * np.int32(rows) + r)) + component
            left = h00 * nodes[node] + h01 * nodes[node + down]
            step = left + h10 * nodes[node + right] + h11 * nodes[node + right + down]
            out[d, i] = begin[d, i] + share * step


@numba.njit(cache=True, nogil=True)
def _at_time(flow: F32, s: float) -> F32:
    """Interpolate a field in time; see `Lattice.at_time`."""
    last = flow.shape[2] - 1
    at = min(1.0, max(0.0, s)) * last
    q = min(int(at), last - 1)
    return flow[:, :, q] + np.float32(at - q) * (flow[:, :, q + 1] - flow[:, :, q])


@numba.njit(cache=True, nogil=True)
def bilinear(
    grid: NDArray[np.float32], points: NDArray[np.float64], per_px: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Interpolate a grid (columns, rows, 2) at points (N, 2) px, constant beyond its border.

    Args:
        grid: the values at the nodes.
        points: x and y; a point that is not finite gets NaN.
        per_px: cells per pixel in x and y.

    Returns:
        (N, 2).
    """
    columns, rows = grid.shape[:2]
    out = np.empty((len(points), 2), np.float32)
    for i in range(len(points)):
        x, y = points[i, 0] * per_px[0], points[i, 1] * per_px[1]
        if not (np.isfinite(x) and np.isfinite(y)):
            out[i] = np.nan
            continue
        x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
        c, r = min(int(x), columns - 2), min(int(y), rows - 2)
        a, b = x - c, y - r
        for d in range(2):
            left = (1 - b) * grid[c, r, d] + b * grid[c, r + 1, d]
            right = (1 - b) * grid[c + 1, r, d] + b * grid[c + 1, r + 1, d]
            out[i, d] = (1 - a) * left + a * right
    return out


@numba.njit(cache=True, fastmath=True, nogil=True)
def material_derivative(flow: F32, per_px: F32, out: F32) -> None:
    """Differentiate a field along its own motion, du/ds + (u . grad) u, over the whole window.

    Central differences of the mean in space, one-sided at the border.

    Args:
        flow: (columns, rows, times, 2) px per window.
        per_px: (2,) lattice cells per pixel in x and y.
        out: (columns, rows, 2) px per window squared, written.
    """
    columns, rows, times, _ = flow.shape
    mean = np.zeros((columns, rows, 2), np.float32)
    for q in range(times):
        mean += flow[:, :, q] / np.float32(times)
    for c in range(columns):
        before, after = max(c - 1, 0), min(c + 1, columns - 1)
        per_x = per_px[0] / np.float32(after - before)
        for r in range(rows):
            above, below = max(r - 1, 0), min(r + 1, rows - 1)
            per_y = per_px[1] / np.float32(below - above)
            for d in range(2):
                out[c, r, d] = (
                    flow[c, r, -1, d]
                    - flow[c, r, 0, d]
                    + mean[c, r, 0] * per_x * (mean[after, r, d] - mean[before, r, d])
                    + mean[c, r, 1] * per_y * (mean[c, below, d] - mean[c, above, d])
                )
