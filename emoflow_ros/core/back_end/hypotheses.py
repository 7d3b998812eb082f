"""Ways of the camera that explain the places of patches about as well, and how likely each is.

Tracks that are wrong make false minima, often deeper than that of the true way. So what is told is
the mean over all that were found, and their spread is part of its covariance.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment import Adjusted, of_unit_depth
from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import (
    angles_across,
    carried_on,
    interpolated,
    without_node,
)
from emoflow_ros.core.front_end.appearance import unit

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Guess = tuple[Unknowns, float]  # a way, and what it costs


@dataclass(frozen=True)
class Hypotheses:
    """What the camera may have done.

    Attributes:
        ways: the likeliest first, without depths.
        share: (W,) how likely each is; their sum is 1.
    """

    ways: tuple[Unknowns, ...]
    share: Array

    @classmethod
    def weighed(
        cls, found: Adjusted, others: list[Guess], settings: BackEndSettings
    ) -> "Hypotheses":
        """Weigh ways by exp(-cost/T). T grows with the misfit: errors of tracks go together.

        Args:
            found: the way of the least cost; the only one where the camera only rotates.
            others: that were found, none cheaper. One that ends in the direction of a cheaper one
                is the same.
            settings: of the back end.
        """
        kept: list[Guess] = [(found.x, found.cost)]
        near = np.cos(np.radians(settings.same_direction_deg))
        rivals = sorted(others, key=lambda other: other[1]) if found.translates else []
        for x, cost in rivals:
            if all(unit(x.velocity[-1]) @ unit(y.velocity[-1]) < near for y, _ in kept):
                kept.append((x, cost))
        least = settings.errors.least_cost
        temperature = settings.temperature * max(found.mean_cost(settings), least)
        share = np.exp((found.cost - np.array([cost for _, cost in kept])) / temperature)
        ways = [of_unit_depth(x)[0]._replace(inverse_depth=np.zeros(0)) for x, _ in kept]
        return cls(tuple(ways), share / share.sum())

    @property
    def rival(self) -> Unknowns | None:
        """The likeliest but one: the next adjustment tries it, too."""
        return self.ways[1] if len(self.ways) > 1 else None

    @cached_property
    def mean(self) -> Unknowns:
        """The likeliest way with the mean velocities, the directions of which are averaged."""
        first = self.ways[0]
        angular = np.tensordot(self.share, [x.angular for x in self.ways], 1)
        directions = [np.einsum("kji,kj->ki", x.rotation, unit(x.velocity)) for x in self.ways]
        direction = unit(np.tensordot(self.share, directions, 1))
        speed = np.linalg.norm(first.velocity, axis=1, keepdims=True)
        velocity = np.einsum("kij,kj->ki", first.rotation, speed * direction)
        return first._replace(angular=angular, velocity=velocity)

    def spread(self, times: Times, t: int) -> tuple[Array, Array]:
        """How far the ways lie apart at a time.

        Args:
            times: (K,) ns of the nodes.
            t: ns.

        Returns:
            Covariances (3, 3) of the angular velocity, rad^2/s^2, and of the direction of
            translation, across it, rad^2.
        """
        w, v, _ = interpolated(times, self.mean, t)
        each = [interpolated(times, x, t) for x in self.ways]
        apart = np.array([angular for angular, _, _ in each]) - w
        turned = angles_across(v, np.array([linear for _, linear, _ in each]))
        return (self.share * apart.T) @ apart, (self.share * turned.T) @ turned

    def carried_on(self, seconds: float) -> "Hypotheses":
        """All with another node."""
        return replace(self, ways=tuple(carried_on(x, seconds) for x in self.ways))

    def without_node(self, node: int) -> "Hypotheses":
        """All without a node."""
        return replace(self, ways=tuple(without_node(x, node) for x in self.ways))
