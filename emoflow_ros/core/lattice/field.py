"""The lattice field: flow on a coarse grid in space and time, linear in between."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.field_kernels import advance, at_time, bilinear, material_derivative

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
        """Interpolate values at the nodes (nodes, n) at points (N, 2) px, (N, n).

        Beyond the border they are constant; a point that is not finite gets NaN.
        """
        grid = np.ascontiguousarray(values).reshape(self.columns, self.rows, -1)
        found: NDArray[np.float64] = bilinear(grid, points, self.per_px)
        return found

    def at_time(self, flow: NDArray[np.float32], s: float) -> NDArray[np.float32]:
        """Interpolate a field in time, (columns, rows, 2); constant before 0 and after 1."""
        return at_time(flow, s)

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
        return advance(flow, np.asarray(points, np.float64), start, end, steps, self.per_px)


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
