"""The motions that may explain a window's flow, and how uncertain its egomotion is.

Many motions may explain the flow of a window nearly as well: a rotation looks much like a sideways
translation. Each direction of translation, with the best rotation for it, and a camera that only
rotates have a cost: what they leave of the flow, and how much flow they take. Of two motions that
leave the same residuals, the one that has to move less is likelier. How likely a motion is falls
exponentially with its cost. The estimate is the mean over them, and their spread is a part of its
covariance.

The second part is the error of the flow that the residuals do not show, the third an angle of v
that no flow takes away. The weights of the parts are measured values.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Variance of a node's flow that more events do not reduce, px^2 per window^2 (docs/method.md). It
# comes from depth edges and from the lattice between its nodes.
_LASTING_PX2 = 0.4
_USUAL_MISFIT = 0.13  # least residual cost over what _LASTING_PX2 explains, median over windows
_LEAST_MISFIT, _MOST_MISFIT = 0.2, 5.0  # bounds of a window's misfit over the usual one

# Error of the flow that the residuals do not show, as it comes into w and v, px per window.
_OF_W_PX, _OF_V_PX = 0.21, 0.09
_LEAST_PARALLAX_PX = 0.1
# Variance of v over that of the possible motions: where motions of less flow are likelier and the
# costs have a temperature, and where neither is so.
_OF_SIZED, _OF_UNSIZED = 0.85, 1.5
_LEAST_ANGLE = 0.02  # standard deviation of v that no flow takes away, rad: no calibration is exact
_AGREE = 0.3  # spread of the possible directions of translation up to which they agree, rad


def trusted(information: Array) -> Array:
    """Inverse covariance of a measured flow from the contrast's curvature.

    Args:
        information: (nodes, 2, 2) curvature, px^-2. It grows with the number of events without a
            bound; the flow's error does not shrink like that.

    Returns:
        (nodes, 2, 2).
    """
    result: Array = np.linalg.solve(np.eye(2) + _LASTING_PX2 * information, information)
    return result


@dataclass(frozen=True)
class Explanations:
    """Constant motions, each the best one along its direction of translation.

    The costs are minus twice logarithms of a probability.

    Attributes:
        v: (M, 3) unit directions; zero for a camera that only rotates.
        w: (M, 3) rad per window.
        residual: (M,) cost of what the motion leaves of the flow, and of other knowledge of w.
        size: (M,) cost of how much flow it takes, and of what was known before.
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
    seen = 0.5 * _LASTING_PX2 * float(usable @ np.trace(information, axis1=1, axis2=2))
    misfit = least / max(seen, 1.0) / _USUAL_MISFIT
    return float(np.sqrt(np.clip(misfit, _LEAST_MISFIT, _MOST_MISFIT)))


@dataclass(frozen=True)
class PossibleMotions:
    """The motions that may explain a flow, as a mean and a spread.

    Attributes:
        mean: (6,) w in rad per window and v, less those of the present motion.
        spread: (6, 6) their covariance.
    """

    mean: Array = field(default_factory=lambda: np.zeros(6))
    spread: Array = field(default_factory=lambda: np.zeros((6, 6)))

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
        return float(np.trace(self.spread[3:, 3:])) < _AGREE**2

    def covariance(
        self, parallax_px: float, px_per_rad: float, known: Array | None = None, *, sized: bool
    ) -> Array:
        """Covariance (6, 6) of (w, v), w in rad per window.

        Args:
            parallax_px: size of the flow without the rotation's part, px per window: the shorter,
                the more an error of the flow turns v.
            px_per_rad: focal length.
            known: (3, 3) information on w from elsewhere.
            sized: whether motions of less flow were likelier, and the costs had a temperature.
        """
        of_w = (_OF_W_PX / px_per_rad) ** 2
        of_v = (_OF_V_PX / max(parallax_px, _LEAST_PARALLAX_PX)) ** 2 + _LEAST_ANGLE**2
        scale = np.repeat([1.0, np.sqrt(_OF_SIZED if sized else _OF_UNSIZED)], 3)
        covariance = np.outer(scale, scale) * self.spread + np.diag(np.repeat([of_w, of_v], 3))
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
