"""The camera's way over the nodes: carried on, centred, put together, and read off at a time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment import Adjusted
from emoflow_ros.core.back_end.adjustment_kernels import NODE, Unknowns, rotated
from emoflow_ros.core.back_end.prior_kernels import rotation_vector
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.front_end.appearance import unit
from emoflow_ros.core.types.estimate import Motion
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True)
class MotionAt:
    """The motion at one time, in the camera's frame of that time.

    Attributes:
        angular: (3,) rad/s.
        linear: (3,) mean depths per second; zeros where the camera only rotates.
        covariance: (3, 3) of the angular velocity, by the normal equations.
    """

    angular: Array
    linear: Array
    covariance: Array


def first_node(angular: Array, velocity: Array) -> Unknowns:
    """Begin a way: one node at the origin, with its velocities (3,)."""
    return Unknowns(
        np.eye(3)[None], np.zeros((1, 3)), angular[None].copy(), velocity[None].copy(), np.zeros(0)
    )


def carried_on(x: Unknowns, seconds: float) -> Unknowns:
    """Add a node with the velocities of the last one, and make it the common frame's origin."""
    change = rotated(x.rotation[-1], x.angular[-1] * seconds)
    place = x.position[-1] + x.velocity[-1] * seconds
    return Unknowns(
        change.T @ np.concatenate([x.rotation, change[None]]),
        (np.concatenate([x.position, place[None]]) - place) @ change,
        np.concatenate([x.angular, x.angular[-1:]]),
        np.concatenate([x.velocity, x.velocity[-1:]]) @ change,
        x.inverse_depth,
    )


def superfluous_node(times: Times, settings: BackEndSettings) -> int | None:
    """Which node to forget: one close behind another, or else the oldest; None if none is to go.

    So nodes reach far back where slices are short.

    Args:
        times: (K,) ns of the nodes.
        settings: of the back end.
    """
    node = len(times) - 1 - settings.newest
    if node > 0 and times[node] - times[node - 1] < settings.apart_s * NS_PER_S:
        return node
    return 0 if len(times) > settings.slices else None


def without_node(x: Unknowns, node: int) -> Unknowns:
    """Forget a node."""
    kept = np.arange(len(x.position)) != node
    return Unknowns(
        x.rotation[kept], x.position[kept], x.angular[kept], x.velocity[kept], x.inverse_depth
    )


def along(t: Times, angular: Array, linear: Array, inverse_depth: Array) -> Unknowns:
    """Put a way together from velocities in the camera's frame at each node, (K, 3) each.

    Args:
        t: (K,) ns of the nodes.
        angular: rad/s.
        linear: mean depths per second.
        inverse_depth: (J,) of the patches.
    """
    rotation, position = np.empty((len(t), 3, 3)), np.empty((len(t), 3))
    velocity = np.empty((len(t), 3))
    rotation[-1], position[-1], velocity[-1] = np.eye(3), 0.0, linear[-1]
    for k in range(len(t) - 2, -1, -1):
        seconds = (t[k + 1] - t[k]) / NS_PER_S
        rotation[k] = rotated(rotation[k + 1], -angular[k] * seconds)
        velocity[k] = rotation[k] @ linear[k]
        position[k] = position[k + 1] - velocity[k] * seconds
    return Unknowns(rotation, position, angular, velocity, inverse_depth)


def motion_at(times: Times, adjusted: Adjusted, t: int) -> MotionAt:
    """Read the motion off at a time, as `interpolated`, with its covariance."""
    angular, linear, (node, share) = interpolated(times, adjusted.x, t)
    by_unknowns = np.zeros((NODE * len(times), 3))
    for k, weight in ((node, 1 - share), (node + 1, share)):
        by_unknowns[NODE * k + 6 : NODE * k + 9] = weight * np.eye(3)
    chosen = by_unknowns[adjusted.free]
    return MotionAt(angular, linear, chosen.T @ adjusted.covariance @ chosen)


def interpolated(times: Times, x: Unknowns, t: int) -> tuple[Array, Array, tuple[int, float]]:
    """Interpolate velocities at a time, linear between the nodes and held beyond them.

    Args:
        times: (K,) ns of the nodes, K > 1.
        x: the way.
        t: ns.

    Returns:
        Angular velocity (3,) rad/s and velocity (3,) in mean depths per second, both in the
        camera's frame; node before t, and share of the way to the next one.
    """
    node, share = between(times, t)
    rotation, _ = pose(times, x, t)
    velocity = mixed(x.velocity, node, share)
    return mixed(x.angular, node, share), rotation.T @ velocity, (node, share)


def pose(times: Times, x: Unknowns, t: int) -> tuple[Array, Array]:
    """Interpolate rotation (3, 3) to the common frame and position (3,) at a time (ns)."""
    node, share = between(times, t)
    step = np.array(rotation_vector(x.rotation[node].T @ x.rotation[node + 1]))
    return rotated(x.rotation[node], share * step), mixed(x.position, node, share)


def between(times: Times, t: int) -> tuple[int, float]:
    """Node before a time, the first or last one at most, and share of the way to the next one."""
    t = min(max(t, int(times[0])), int(times[-1]))
    node = min(int(np.searchsorted(times, t, "right")) - 1, len(times) - 2)
    return node, float((t - times[node]) / (times[node + 1] - times[node]))


def mixed(values: Array, node: int, share: float) -> Array:
    """Mean of the values (K, ...) of a node and the next one."""
    return np.asarray((1 - share) * values[node] + share * values[node + 1])


@dataclass(frozen=True)
class AdjustedMotion:
    """Motion over the nodes of an adjustment (a Motion).

    Attributes:
        times: (K,) ns.
        x: the way.
        translates: whether the direction of translation is known.
        ahead: whose change of the angular velocity goes on after the newest node, as the lattice's;
            None if there is none.
        by_gyro: whose angular velocity counts instead.
    """

    times: Times
    x: Unknowns
    translates: bool
    ahead: Motion | None
    by_gyro: Motion | None = None

    def angular(self, t: int) -> Array:
        """Angular velocity at time t (ns), (3,) rad/s."""
        if self.by_gyro is not None:
            return self.by_gyro.angular(t)
        newest = int(self.times[-1])
        own = mixed(self.x.angular, *between(self.times, t))
        if t <= newest or self.ahead is None:
            return own
        return own + self.ahead.angular(t) - self.ahead.angular(newest)

    def linear(self, t: int) -> Array:
        """Direction of the linear velocity at time t (ns), (3,) unit, or zeros."""
        linear = interpolated(self.times, self.x, t)[1]
        norm = float(np.linalg.norm(linear))
        return linear / norm if self.translates and norm > 0 else np.zeros(3)


def angles_across(direction: Array, others: Array) -> Array:
    """Angles (..., 3), rad, from a direction (3,) to others (..., 3), as vectors across it."""
    direction, others = unit(direction), unit(others)
    along = others @ direction
    angle = np.arccos(np.clip(along, -1, 1))
    return np.asarray(angle[..., None] * unit(others - along[..., None] * direction))
