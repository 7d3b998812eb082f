"""Normal equations of the flow lattice, with a border for the egomotion."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, lapack

from emoflow_ros.core import assembly
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig

Array = NDArray[np.float64]

_RIDGE = 1e-3  # px^-2, holds nodes that no event and no neighbour reaches


class NotPositiveDefiniteError(np.linalg.LinAlgError):
    """The normal equations have no unique minimum: the fit has diverged."""


class NormalEquations:
    """A quadratic model of the cost around a field: step^T H step / 2 - vector^T step.

    Args:
        lattice: of the field.
        further: number m of unknowns beside the field.

    Attributes:
        vector: (n,) the negative gradient.
        band: (n, bandwidth + 1) H in lower band storage (LAPACK's, transposed):
            band[j, i - j] is entry (i, j).
        border: (n, m) second derivatives by field and further unknowns.
        corner: (m, m) second derivatives by the further unknowns.
        corner_vector: (m,) their negative gradient.
    """

    def __init__(self, lattice: Lattice, further: int) -> None:
        self.lattice = lattice
        self.vector = np.zeros(lattice.unknowns)
        self.band = np.zeros((lattice.unknowns, lattice.bandwidth + 1))
        self.border = np.zeros((lattice.unknowns, further))
        self.corner = np.zeros((further, further))
        self.corner_vector = np.zeros(further)

    def clear(self) -> None:
        """Start anew."""
        for part in (self.vector, self.band, self.border, self.corner, self.corner_vector):
            part[:] = 0.0

    def node_information(self) -> Array:
        """Blocks of H for a flow constant over the window, (nodes, 2, 2), neighbours fixed."""
        times = self.lattice.times
        band = self.band.reshape(-1, times, 2, self.band.shape[1])
        xx = band[:, :, 0, 0].sum(1) + 2 * band[:, :-1, 0, 2].sum(1)
        yy = band[:, :, 1, 0].sum(1) + 2 * band[:, :-1, 1, 2].sum(1)
        xy = band[:, :, 0, 1].sum(1) + band[:, :-1, 0, 3].sum(1) + band[:, :-1, 1, 1].sum(1)
        return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)

    def of_common_shift(self) -> tuple[Array, Array]:
        """Negative gradient (2,) and second derivatives (2, 2) by a flow that all nodes share."""
        along = self.band[:, 0] + 2 * self.band[:, 2::2].sum(axis=1)
        xx, yy = along.reshape(-1, 2).sum(axis=0)
        xy = self.band[:, 1::2].sum()
        return self.vector.reshape(-1, 2).sum(axis=0), np.array([[xx, xy], [xy, yy]])

    def add_smoothness(self, flow: NDArray[np.float32], config: LatticeConfig) -> None:
        """Add the smoothness of a field (columns, rows, times, 2), px per window."""
        self.band[:, 0] += _RIDGE
        self.lattice.smoothness(
            flow, config.smoothness, config.edge_px, config.smoothness_in_time,
            self.vector, self.band,
        )  # fmt: skip

    def add_rows(self, normal: Array, by_further: Array, weight: Array, r: Array) -> None:
        """Add weighted squares of residuals that each concern one node at one time.

        Args:
            normal: (nodes, times, 2) derivative of each residual by its node's flow.
            by_further: (nodes, times, m) derivative by the further unknowns.
            weight, r: (nodes, times).
        """
        assembly.add_rows(
            normal, by_further, weight, r,
            self.vector, self.band, self.border, self.corner, self.corner_vector,
        )  # fmt: skip

    def solve(self) -> Array:
        """Return the step (n,) to the minimum.

        Raises:
            NotPositiveDefiniteError: there is none.
        """
        _, step, info = lapack.dpbsv(self.band.T, self.vector, lower=1)
        if info != 0 or not np.isfinite(step).all():
            raise NotPositiveDefiniteError
        return step

    def solve_bordered(self) -> tuple[Array, Array, Array]:
        """Solve for the field and the further unknowns at once, by the Schur complement.

        Returns:
            The steps (n,) and (m,), and the (m, m) information that is left on the further
            unknowns when the field is marginalised.

        Raises:
            NotPositiveDefiniteError: there is no minimum.
        """
        factor, info = lapack.dpbtrf(self.band.T, lower=1)
        if info != 0:
            raise NotPositiveDefiniteError
        both = np.empty((len(self.vector), 1 + len(self.corner)), order="F")
        both[:, 0], both[:, 1:] = self.vector, self.border
        both, _ = lapack.dtbtrs(factor, both, uplo="L", overwrite_b=1)
        of_field, across = both[:, 0], both[:, 1:]
        information = self.corner - across.T @ across
        try:
            further = cho_solve(cho_factor(information), self.corner_vector - across.T @ of_field)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise NotPositiveDefiniteError from error
        left = (of_field - across @ further)[:, None]
        step = lapack.dtbtrs(factor, left, uplo="L", trans="T")[0][:, 0]
        if not np.isfinite(step).all():
            raise NotPositiveDefiniteError
        return step, further, information
