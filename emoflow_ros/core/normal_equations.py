"""Normal equations of the flow lattice, with a border for the egomotion."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, lapack

from emoflow_ros.core.lattice import Lattice

Array = NDArray[np.float64]


class NotPositiveDefiniteError(np.linalg.LinAlgError):
    """The normal equations have no unique minimum: the fit has diverged."""


class NormalEquations:
    """A quadratic model of the cost around a field: step^T H step / 2 - vector^T step.

    Attributes:
        vector: (n,) the negative gradient.
        band: (n, bandwidth + 1) H in lower band storage (LAPACK's, transposed):
            band[j, i - j] is entry (i, j).
    """

    def __init__(self, lattice: Lattice) -> None:
        self.lattice = lattice
        self.vector = np.zeros(lattice.unknowns)
        self.band = np.zeros((lattice.unknowns, lattice.bandwidth + 1))

    def clear(self) -> None:
        """Start anew."""
        self.vector[:] = 0.0
        self.band[:] = 0.0

    def node_information(self) -> Array:
        """Blocks of H for a flow constant over the window, (nodes, 2, 2), neighbours fixed."""
        times = self.lattice.times
        band = self.band.reshape(-1, times, 2, self.band.shape[1])
        xx = band[:, :, 0, 0].sum(1) + 2 * band[:, :-1, 0, 2].sum(1)
        yy = band[:, :, 1, 0].sum(1) + 2 * band[:, :-1, 1, 2].sum(1)
        xy = band[:, :, 0, 1].sum(1) + band[:, :-1, 0, 3].sum(1) + band[:, :-1, 1, 1].sum(1)
        return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)

    def add_rows(self, normal: Array, weight: Array, r: Array) -> None:
        """Add weighted squares of residuals that each concern one node at one time.

        Args:
            normal: (nodes, times, 2) derivative of each residual by its node's flow.
            weight, r: (nodes, times).
        """
        weighted = weight[..., None] * normal
        self.vector -= (weighted * r[..., None]).ravel()
        self.band[0::2, 0] += (weighted[..., 0] * normal[..., 0]).ravel()
        self.band[1::2, 0] += (weighted[..., 1] * normal[..., 1]).ravel()
        self.band[0::2, 1] += (weighted[..., 0] * normal[..., 1]).ravel()

    def solve(self) -> Array:
        """Return the step (n,) to the minimum.

        Raises:
            NotPositiveDefiniteError: there is none.
        """
        _, step, info = lapack.dpbsv(self.band.T, self.vector, lower=1)
        if info != 0 or not np.isfinite(step).all():
            raise NotPositiveDefiniteError
        return step

    def solve_bordered(
        self, border: Array, corner: Array, corner_vector: Array
    ) -> tuple[Array, Array, Array]:
        """Solve for the field and m further unknowns at once, by the Schur complement.

        Args:
            border: (n, m) second derivatives across.
            corner: (m, m) second derivatives of the further unknowns.
            corner_vector: (m,) their negative gradient.

        Returns:
            The steps (n,) and (m,), and the (m, m) information that is left on the further
            unknowns when the field is marginalised.

        Raises:
            NotPositiveDefiniteError: there is no minimum.
        """
        factor, info = lapack.dpbtrf(self.band.T, lower=1)
        if info != 0:
            raise NotPositiveDefiniteError
        both = np.column_stack([self.vector, border])
        solved, _ = lapack.dpbtrs(factor, both, lower=1)
        information = corner - border.T @ solved[:, 1:]
        information = 0.5 * (information + information.T)
        try:
            further = cho_solve(cho_factor(information), corner_vector - border.T @ solved[:, 0])
        except (np.linalg.LinAlgError, ValueError) as error:
            raise NotPositiveDefiniteError from error
        step = solved[:, 0] - solved[:, 1:] @ further
        if not np.isfinite(step).all():
            raise NotPositiveDefiniteError
        return step, further, information
