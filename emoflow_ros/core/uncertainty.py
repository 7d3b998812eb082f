"""The motions that may explain a window's flow, and how uncertain its egomotion is.

Many motions may explain the flow of a window nearly as well: a turn looks much like a sideways
travel. Each direction of travel, with the best rotation for it, and a camera that only turns have a
cost: what they leave of the flow, and how much flow they take. Of two motions that leave the same
residuals, the one that has to turn and to travel less is likelier. How likely a motion is falls
exponentially with its cost. The estimate is the mean over them, and their spread is a part of its
covariance.

The second part is the error of the flow that the residuals do not show. Two other explanations of
the window show how large it is: a fresh fit of the flow (core.second_look) and the scene of an
earlier window (core.earlier_scene). The third part is an angle of v that no flow takes away. The
weights of the parts are measured values.
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

# The weights were chosen on simulated recordings: those of w in docs/method.md, those of v in
# docs/experiments.md, "Covariance of v".
_OF_W, _OF_V = 0.35, 0.15  # shares of the distance of the second fit that are w's and v's errors
# With an earlier scene: share of the same distance that is w's error, and share of the squared
# difference of the two values of w that is the variance.
_OF_W_TOO, _OF_EARLIER = 0.15, 0.05
# Bounds of that distance, px per window. One distance is a sample and may be small by chance.
_LEAST_PX, _MOST_PX = 0.3, 4.0
_LEAST_PARALLAX_PX = 0.1
# Variance of v over that of the possible motions: where motions of less flow are likelier and the
# costs have a temperature, and where neither is so.
_OF_SIZED, _OF_UNSIZED = 0.85, 1.5
_LEAST_ANGLE = 0.02  # standard deviation of v that no flow takes away, rad: no calibration is exact
_CLAIMED = 0.3  # spread of the possible directions of travel from which none is claimed, rad
_LASTING = 2  # number of windows before this one that are compared
_CONFIRMING = 1  # number of these that must have told the same direction, and none another one
_SAME = np.cos(np.radians(40.0))  # cosine of the largest angle between two same directions


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
    """Constant motions, each the best one along its direction of travel.

    The costs are minus twice logarithms of a probability.

    Attributes:
        v: (M, 3) unit directions; zero for a camera that only turns.
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
class Disagreement:
    """How far other explanations of a window lie from its estimate.

    Attributes:
        second_look_px: distance to a fresh fit of the flow, px per window.
        earlier_px: distance to the flow by an earlier scene, px per window; NaN without one.
        w: (3,) angular velocity by that scene, rad per window; None without one.
    """

    second_look_px: float
    earlier_px: float = float("nan")
    w: Array | None = None


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
        travels: Explanations,
        rotation: Explanations,
        temperature: float = 1.0,
    ) -> "PossibleMotions":
        """Weigh motions by exp(-cost / (2 temperature)).

        Before the flow is seen a camera that only turns is as likely as all travels together.

        Args:
            present: w (3,) in rad per window and unit v (3,) of the present motion.
            here: what it costs.
            travels: other motions.
            rotation: a camera that only turns.
            temperature: temperature of the window.
        """
        signs = np.where(travels.v @ present[1] < 0, -1.0, 1.0)[:, None]
        turn = np.concatenate([rotation.w[0] - present[0], np.zeros(3)])
        others = np.hstack([travels.w - present[0], signs * travels.v - present[1]])
        apart = np.vstack([np.zeros(6), others, turn])
        cost = np.concatenate([here.cost, travels.cost, rotation.cost])
        weight = np.exp(-0.5 * (cost - cost.min()) / temperature)
        weight[-1] *= len(travels.v)
        weight /= weight.sum()
        mean = weight @ apart
        return cls(mean, (weight[:, None] * apart).T @ apart - np.outer(mean, mean))

    def covariance(
        self,
        apart: Disagreement,
        w: Array,
        parallax_px: float,
        px_per_rad: float,
        known: Array | None = None,
        *,
        sized: bool,
    ) -> Array:
        """Covariance (6, 6) of (w, v), w in rad per window.

        Args:
            apart: how far other explanations lie from the estimate.
            w: (3,) the estimate, rad per window.
            parallax_px: size of the flow without the rotation's part, px per window: the shorter,
                the more an error of the flow turns v.
            px_per_rad: focal length.
            known: (3, 3) information on w from elsewhere.
            sized: whether motions of less flow were likelier, and the costs had a temperature.
        """
        look = float(np.clip(apart.second_look_px, _LEAST_PX, _MOST_PX))
        share = _OF_W if apart.w is None else _OF_W_TOO
        of_w = (share * look / px_per_rad) ** 2
        if apart.w is not None:
            of_w += _OF_EARLIER * float(((w - apart.w) ** 2).sum()) / 3
        of_v = (_OF_V * look / max(parallax_px, _LEAST_PARALLAX_PX)) ** 2 + _LEAST_ANGLE**2
        scale = np.repeat([1.0, np.sqrt(_OF_SIZED if sized else _OF_UNSIZED)], 3)
        covariance = np.outer(scale, scale) * self.spread + np.diag(np.repeat([of_w, of_v], 3))
        if known is None:
            return covariance
        information = np.linalg.inv(covariance)
        information[:3, :3] += known
        return np.linalg.inv(information)


class Claims:
    """Decides window by window whether a direction of travel can be claimed."""

    def __init__(self) -> None:
        self._told: list[Array] = []

    def claim(self, v: Array, possible: PossibleMotions) -> bool:
        """Tell whether a direction can be claimed. Call it once per window.

        The motions that are possible have to agree on it. One of the last two windows must have
        told the same direction, and none another one: a direction that a few events suggest does
        not last.

        Args:
            v: (3,) unit, with its sign.
            possible: motions in this window.
        """
        agree = float(np.trace(possible.spread[3:, 3:])) < _CLAIMED**2
        told = v if agree else np.zeros(3)
        earlier = [told @ before for before in self._told if before.any()]
        self._told = [*self._told, told][-_LASTING:]
        return agree and len(earlier) >= _CONFIRMING and bool(min(earlier) > _SAME)


def without_travel(covariance: Array) -> Array:
    """Mark the covariance (6, 6) of (v, w) as without v (REP-145's idiom)."""
    result = np.zeros((6, 6))
    result[0, 0] = -1.0
    result[3:, 3:] = covariance[3:, 3:]
    return result
