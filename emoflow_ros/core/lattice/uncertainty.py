"""The motions that may explain a window's flow, and how uncertain its egomotion is.

Many motions may explain the flow of a window nearly as well: a rotation looks much like a sideways
translation. Each direction of translation, with the best rotation for it, and a camera that only
rotates have a cost: what they leave of the flow, and how much flow they take. Of two motions that
leave the same residuals, the one that has to move less is likelier. How likely a motion is falls
exponentially with its cost. The estimate is the mean over them, and their spread is a part of its
covariance.

The other part is the error of the flow that the residuals do not show.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.settings import LATTICE

Array = NDArray[np.float64]


def trusted(information: Array) -> Array:
    """Inverse covariance of a measured flow from the contrast's curvature.

    Args:
        information: (nodes, 2, 2) curvature, px^-2. It grows with the number of events without a
            bound; the flow's error does not shrink like that.

    Returns:
        (nodes, 2, 2).
    """
    result: Array = np.linalg.solve(np.eye(2) + LATTICE.lasting_px2 * information, information)
    return result


@dataclass(frozen=True)
class Explanations:
    """Constant motions, each the best one along its direction of translation.

    The costs are minus twice logarithms of a probability.

    Attributes:
        v: (M, 3) unit directions; zero for a camera that only rotates.
        w: (M, 3) rad per window.
        residual: (M,) cost of what the motion leaves of the flow, and of other knowledge of w.
        size: (M,) cost of how much flow it takes.
    """

    v: Array
    w: Array
    residual: Array
    size: Array

    @property
    def cost(self) -> Array:
        """Both costs (M,)."""
        return self.residual + self.size

    def at(self, k: int) -> "Explanations":
        """Take the k-th motion alone."""
        one = slice(k, k + 1)
        return Explanations(self.v[one], self.w[one], self.residual[one], self.size[one])


def temperature(
    here: Explanations, others: Explanations, usable: NDArray[np.bool_], information: Array
) -> float:
    """Tell by how much the residuals of a window are larger or smaller than usual.

    The error that lasts is not the same in every scene. The result is the geometric mean of what
    the window itself tells, by the least residual, and of what is usual, which is 1.

    Args:
        here: the motion that was fitted.
        others: other motions.
        usable: (nodes,) which nodes count.
        information: (nodes, 2, 2), inverse covariance of the flow, as `trusted` tells it.

    Returns:
        What all costs are to be divided by.
    """
    least = min(float(here.residual[0]), float(others.residual.min()))
    seen = 0.5 * LATTICE.lasting_px2 * float(usable @ np.trace(information, axis1=1, axis2=2))
    misfit = least / max(seen, 1.0) / LATTICE.usual_misfit
    return float(np.sqrt(np.clip(misfit, LATTICE.least_misfit, LATTICE.most_misfit)))


@dataclass(frozen=True)
class PossibleMotions:
    """The motions that may explain a flow, as a mean and a spread.

    Attributes:
        mean: (6,) w in rad per window and v, less those of the present motion.
        spread: (6, 6) their covariance.
    """

    mean: Array
    spread: Array

    @classmethod
    def weigh(
        cls,
        present: tuple[Array, Array],
        here: Explanations,
        translates: Explanations,
        rotation: Explanations,
        temperature: float = 1.0,
    ) -> "PossibleMotions":
        """Weigh motions by exp(-cost / (2 temperature)).

        Before the flow is seen a camera that only rotates is as likely as all translations are.

        Args:
            present: w (3,) in rad per window and unit v (3,) of the present motion.
            here: what it costs.
            translates: other motions.
            rotation: a camera that only rotates.
            temperature: temperature of the window.
        """
        signs = np.where(translates.v @ present[1] < 0, -1.0, 1.0)[:, None]
        alone = np.concatenate([rotation.w[0] - present[0], np.zeros(3)])
        others = np.hstack([translates.w - present[0], signs * translates.v - present[1]])
        apart = np.vstack([np.zeros(6), others, alone])
        cost = np.concatenate([here.cost, translates.cost, rotation.cost])
        weight = np.exp(-0.5 * (cost - cost.min()) / temperature)
        weight[-1] *= len(translates.v)
        weight /= weight.sum()
        mean = weight @ apart
        return cls(mean, (weight[:, None] * apart).T @ apart - np.outer(mean, mean))

    @property
    def agree(self) -> bool:
        """Whether the possible motions agree on a direction of translation."""
        return float(np.trace(self.spread[3:, 3:])) < LATTICE.agree**2

    def covariance(
        self, parallax_px: float, px_per_rad: float, known: Array | None = None
    ) -> Array:
        """Covariance (6, 6) of (w, v), w in rad per window.

        Args:
            parallax_px: size of the flow without the rotation's part, px per window: the shorter,
                the more an error of the flow turns v.
            px_per_rad: focal length.
            known: (3, 3) information on w from elsewhere.
        """
        of_w = LATTICE.flow_error_px / px_per_rad
        of_v = LATTICE.flow_error_px / max(parallax_px, LATTICE.least_flow_px)
        covariance = self.spread + np.diag(np.repeat([of_w, of_v], 3) ** 2)
        if known is None:
            return covariance
        information = np.linalg.inv(covariance)
        information[:3, :3] += known
        return np.linalg.inv(information)


def without_translation(covariance: Array) -> Array:
    """Mark the covariance (6, 6) of (v, w) as without v (REP-145's idiom)."""
    result = np.zeros((6, 6))
    result[0, 0] = -1.0
    result[3:, 3:] = covariance[3:, 3:]
    return result
