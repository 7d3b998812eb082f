"""Compiled loops of the adjustment: residuals, their derivatives, and the normal equations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NODE = 12  # unknowns of a node: rotation, position, angular velocity, velocity
POSE = 6  # the first of them, which observations depend on
_DEPTHS = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0)  # inverse, over the mean one
_NEAREST = 1e-3  # least depth over that of the anchor

_compiled = njit(nogil=True)


class Observations(NamedTuple):
    """Where patches were seen.

    Attributes:
        patch, node: (O,) which patch was seen at which node.
        seen: (O, 2) on the undistorted normalised plane.
        root: (O, 2, 2) square root of the information on that plane.
        anchor: (J,) the node that a patch's depth is given at.
        bearing: (J, 2) where it was seen there.
        depth_mean, depth_sd: (J,) what is known of the inverse depth besides.
    """

    patch: Index
    node: Index
    seen: Array
    root: Array
    anchor: Index
    bearing: Array
    depth_mean: Array
    depth_sd: Array


class Unknowns(NamedTuple):
    """What is adjusted.

    Attributes:
        rotation: (K, 3, 3) from the camera at each node to the common frame.
        position: (K, 3) of the camera in the common frame.
        angular: (K, 3) rad/s in the camera's frame.
        velocity: (K, 3) in the common frame, mean depths per second.
        inverse_depth: (J,) at each patch's anchor.
    """

    rotation: Array
    position: Array
    angular: Array
    velocity: Array
    inverse_depth: Array


class Equations(NamedTuple):
    """Normal equations of nodes and depths.

    Attributes:
        matrix, right: (12 K, 12 K), its lower triangle, and (12 K,) of the nodes.
        cross: (J, 6 K) of depths and poses.
        own, own_right: (J,) of the depths.
    """

    matrix: Array
    right: Array
    cross: Array
    own: Array
    own_right: Array


@_compiled
def rotated(rotation: Array, step: Array) -> Array:
    """Rotation (3, 3) times the exponential of a rotation vector (3,)."""
    angle = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    a = math.sin(angle) / angle if angle > 1e-9 else 1.0
    b = (1 - math.cos(angle)) / angle**2 if angle > 1e-6 else 0.5
    x, y, z = step[0], step[1], step[2]
    change = np.empty((3, 3))
    change[0, 0], change[1, 1], change[2, 2] = (
        1 - b * (y * y + z * z), 1 - b * (x * x + z * z), 1 - b * (x * x + y * y)
    )  # fmt: skip
    change[0, 1], change[1, 0] = b * x * y - a * z, b * x * y + a * z
    change[0, 2], change[2, 0] = b * x * z + a * y, b * x * z - a * y
    change[1, 2], change[2, 1] = b * y * z - a * x, b * y * z + a * x
    out = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += rotation[i, k] * change[k, j]
    return out


@_compiled
def _point(o: Observations, x: Unknowns, n: int, q: Array) -> None:
    """Write the patch of observation n, over its depth at the anchor, in its node's frame."""
    j, k = o.patch[n], o.node[n]
    i = o.anchor[j]
    rho = x.inverse_depth[j]
    for a in range(3):
        q[a] = 0.0
    for a in range(3):  # in the common frame, relative to the node
        ray = x.rotation[i, a, 0] * o.bearing[j, 0] + x.rotation[i, a, 1] * o.bearing[j, 1]
        ray += x.rotation[i, a, 2] + rho * (x.position[i, a] - x.position[k, a])
        for b in range(3):
            q[b] += x.rotation[k, a, b] * ray


@_compiled
def observation_cost(o: Observations, x: Unknowns, outlier: float, squares: Array) -> float:
    """Robust cost of all observations; their squares over the variance are written into (O,)."""
    q = np.empty(3)
    cost = 0.0
    for n in range(len(o.patch)):
        _point(o, x, n, q)
        z = max(q[2], _NEAREST)
        ex, ey = q[0] / z - o.seen[n, 0], q[1] / z - o.seen[n, 1]
        rx = o.root[n, 0, 0] * ex + o.root[n, 0, 1] * ey
        ry = o.root[n, 1, 0] * ex + o.root[n, 1, 1] * ey
        squares[n] = rx * rx + ry * ry
        cost += 0.5 * squares[n] / (1 + squares[n] / outlier**2)
    for j in range(len(o.anchor)):
        cost += 0.5 * ((x.inverse_depth[j] - o.depth_mean[j]) / o.depth_sd[j]) ** 2
    return cost


@_compiled
def likeliest_depths(o: Observations, x: Unknowns, outlier: float) -> Array:
    """Inverse depths (J,), out of some, at which each patch's robust cost along a way is least."""
    least, likeliest = np.full(len(o.anchor), np.inf), np.ones(len(o.anchor))
    squares = np.empty(len(o.patch))
    for depth in _DEPTHS:
        tried = Unknowns(
            x.rotation, x.position, x.angular, x.velocity, np.full(len(o.anchor), depth)
        )
        observation_cost(o, tried, outlier, squares)
        cost = np.zeros(len(o.anchor))
        for n in range(len(o.patch)):
            cost[o.patch[n]] += squares[n] / (1 + squares[n] / outlier**2)
        for j in range(len(cost)):
            if cost[j] < least[j]:
                least[j], likeliest[j] = cost[j], depth
    return likeliest


@_compiled
def observe(o: Observations, x: Unknowns, outlier: float, equations: Equations) -> None:
    """Add the observations to the normal equations (Geman and McClure's weights).

    Args:
        o, x: observations and where they are linearised.
        outlier: distance in standard deviations from which an observation counts little.
        equations: added to.
    """
    matrix, right, cross, own, own_right = equations
    q, ray = np.empty(3), np.empty(3)
    rows = np.empty((2, 13))  # by node's pose, by anchor's pose, by depth
    at = np.empty((2, 3))
    for n in range(len(o.patch)):
        j, k = o.patch[n], o.node[n]
        i = o.anchor[j]
        _point(o, x, n, q)
        z = max(q[2], _NEAREST)
        px, py = q[0] / z, q[1] / z
        ex, ey = px - o.seen[n, 0], py - o.seen[n, 1]
        rx = o.root[n, 0, 0] * ex + o.root[n, 0, 1] * ey
        ry = o.root[n, 1, 0] * ex + o.root[n, 1, 1] * ey
        weight = 1.0 / (1 + (rx * rx + ry * ry) / outlier**2)
        rho = x.inverse_depth[j]
        bx, by = o.bearing[j, 0], o.bearing[j, 1]
        for a in range(2):  # a row of `at` is weight times d residual / d q
            l0, l1 = weight * o.root[n, a, 0], weight * o.root[n, a, 1]
            at[a, 0], at[a, 1], at[a, 2] = l0 / z, l1 / z, -(l0 * px + l1 * py) / z
        for a in range(2):
            # by the node's rotation: at x hat(q)
            rows[a, 0] = at[a, 1] * q[2] - at[a, 2] * q[1]
            rows[a, 1] = at[a, 2] * q[0] - at[a, 0] * q[2]
            rows[a, 2] = at[a, 0] * q[1] - at[a, 1] * q[0]
            depth = 0.0
            for b in range(3):  # at in the common frame
                ray[b] = (
                    at[a, 0] * x.rotation[k, b, 0]
                    + at[a, 1] * x.rotation[k, b, 1]
                    + at[a, 2] * x.rotation[k, b, 2]
                )
                rows[a, 3 + b] = -rho * ray[b]
                rows[a, 9 + b] = rho * ray[b]
                depth += ray[b] * (x.position[i, b] - x.position[k, b])
            rows[a, 12] = depth
            c0 = ray[0] * x.rotation[i, 0, 0] + ray[1] * x.rotation[i, 1, 0]
            c0 += ray[2] * x.rotation[i, 2, 0]
            c1 = ray[0] * x.rotation[i, 0, 1] + ray[1] * x.rotation[i, 1, 1]
            c1 += ray[2] * x.rotation[i, 2, 1]
            c2 = ray[0] * x.rotation[i, 0, 2] + ray[1] * x.rotation[i, 1, 2]
            c2 += ray[2] * x.rotation[i, 2, 2]
            # by the anchor's rotation: -c x hat(b)
            rows[a, 6] = -(c1 - c2 * by)
            rows[a, 7] = -(c2 * bx - c0)
            rows[a, 8] = -(c0 * by - c1 * bx)
        rx, ry = weight * rx, weight * ry
        own[j] += rows[0, 12] ** 2 + rows[1, 12] ** 2
        own_right[j] -= rows[0, 12] * rx + rows[1, 12] * ry
        u, v = NODE * k, NODE * i  # the anchor is an earlier node
        for a in range(POSE):
            ra, rb, sa, sb = rows[0, a], rows[1, a], rows[0, POSE + a], rows[1, POSE + a]
            right[u + a] -= ra * rx + rb * ry
            right[v + a] -= sa * rx + sb * ry
            cross[j, POSE * k + a] += ra * rows[0, 12] + rb * rows[1, 12]
            cross[j, POSE * i + a] += sa * rows[0, 12] + sb * rows[1, 12]
            for b in range(POSE):
                matrix[u + a, v + b] += ra * rows[0, POSE + b] + rb * rows[1, POSE + b]
            for b in range(a + 1):
                matrix[u + a, u + b] += ra * rows[0, b] + rb * rows[1, b]
                matrix[v + a, v + b] += sa * rows[0, POSE + b] + sb * rows[1, POSE + b]
    for j in range(len(o.anchor)):
        precision = 1.0 / o.depth_sd[j] ** 2
        own[j] += precision
        own_right[j] -= precision * (x.inverse_depth[j] - o.depth_mean[j])


@_compiled
def share_of_depths(equations: Equations) -> tuple[Array, Array]:
    """What the depths take off the equations of the poses: (6 K, 6 K), (6 K,) (Schur)."""
    scaled = equations.cross / equations.own.reshape(-1, 1)
    return scaled.T @ equations.cross, equations.own_right @ scaled
