"""Compiled loops of the motion prior: its residuals and its part of the normal equations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment_kernels import NODE, POSE, Unknowns
from emoflow_ros.core.numerics.jit import njit

Array = NDArray[np.float64]

_compiled = njit(nogil=True)


class Prior(NamedTuple):
    """What is known of the motion besides.

    Attributes:
        seconds: (K - 1,) between the nodes.
        angular_walk, velocity_walk: random walk's power spectral density of angular velocity,
            rad^2/s^3, and of velocity.
        speed_sd: standard deviation of each component of the velocity.
        measured: (M, 3) rad/s, mean angular velocities over windows.
        measured_share: (M, K) how much of each window lies between a node and the next one, and
            last what lies after the newest.
        measured_root: (M, 3, 3) square root of the information.
        measured_outlier: distance in standard deviations from which a measurement counts little.
        measured_biased: (M,) whether its error holds a bias that all of these share.
        bias_information: (3, 3) inverse covariance of the bias.
    """

    seconds: Array
    angular_walk: float
    velocity_walk: float
    speed_sd: float
    measured: Array
    measured_share: Array
    measured_root: Array
    measured_outlier: float
    measured_biased: NDArray[np.bool_]
    bias_information: Array


class BiasEquations(NamedTuple):
    """Normal equations of the bias that measured angular velocities share.

    Attributes:
        information: (3, 3) on it, the motion being known.
        right: (3,) their right side.
        cross: (12 K, 3) of the nodes and the bias.
    """

    information: Array
    right: Array
    cross: Array


@_compiled
def rotation_vector(matrix: Array) -> tuple[float, float, float]:
    """Logarithm of a rotation (3, 3) below 180 degrees."""
    x = 0.5 * (matrix[2, 1] - matrix[1, 2])
    y = 0.5 * (matrix[0, 2] - matrix[2, 0])
    z = 0.5 * (matrix[1, 0] - matrix[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2] - 1.0)
    angle = math.atan2(sine, cosine)
    factor = angle / sine if sine > 1e-9 else 1.0
    return factor * x, factor * y, factor * z


@_compiled
def motion_prior(x: Unknowns, prior: Prior, matrix: Array, right: Array) -> float:
    """Add the motion prior to the normal equations, and return its cost.

    Between nodes white noise drives the accelerations (Barfoot, State Estimation for Robotics,
    2017, ch. 11): for position and velocity the residuals are p' - p - dt v and v' - v with the
    covariance q [dt^3/3, dt^2/2; dt^2/2, dt].

    Args:
        x: where it is linearised.
        prior: its strength, and what was measured.
        matrix, right: of the nodes, changed; nothing is added to empty ones.
    """
    cost, build = 0.0, len(right) > 0
    rows = np.zeros((2, 4 * 3))  # by rotation (or position) and rate at both nodes
    places = np.empty(12, np.int64)
    relative, turn = _turns(x)
    for k in range(len(prior.seconds)):
        dt = prior.seconds[k]
        for kind in range(2):
            density = prior.angular_walk if kind == 0 else prior.velocity_walk
            m00, m01, m11 = 12 / (density * dt**3), -6 / (density * dt**2), 4 / (density * dt)
            offset = 3 * kind
            for a in range(12):
                part, axis = a // 3, a % 3
                node = k if part < 2 else k + 1
                places[a] = NODE * node + offset + axis + (POSE if part % 2 else 0)
            for axis in range(3):
                rows[:] = 0.0
                if kind == 0:
                    first = turn[k, axis] - dt * x.angular[k, axis]
                    second = x.angular[k + 1, axis] - x.angular[k, axis]
                    for b in range(3):
                        rows[0, b] = -relative[k, b, axis]
                else:
                    first = x.position[k + 1, axis] - x.position[k, axis]
                    first -= dt * x.velocity[k, axis]
                    second = x.velocity[k + 1, axis] - x.velocity[k, axis]
                    rows[0, axis] = -1.0
                rows[0, 3 + axis] = -dt
                rows[0, 6 + axis] = 1.0
                rows[1, 3 + axis] = -1.0
                rows[1, 9 + axis] = 1.0
                cost += 0.5 * (m00 * first**2 + 2 * m01 * first * second + m11 * second**2)
                if build:
                    for a in range(12):
                        la = m00 * rows[0, a] + m01 * rows[1, a]
                        lb = m01 * rows[0, a] + m11 * rows[1, a]
                        if la == 0.0 and lb == 0.0:
                            continue
                        right[places[a]] -= la * first + lb * second
                        for b in range(12):
                            matrix[places[a], places[b]] += la * rows[0, b] + lb * rows[1, b]
    slow = 1.0 / prior.speed_sd**2
    for k in range(len(x.position)):
        for a in range(3):
            cost += 0.5 * slow * x.velocity[k, a] ** 2
            if build:
                u = NODE * k + 9 + a
                matrix[u, u] += slow
                right[u] -= slow * x.velocity[k, a]
    return cost + _measured(x, prior, relative, turn, matrix, right)


@_compiled
def _turns(x: Unknowns) -> tuple[Array, Array]:
    """Rotations from each node to the next one, (K - 1, 3, 3), and their logarithms (K - 1, 3)."""
    count = len(x.position) - 1
    relative, turn = np.zeros((count, 3, 3)), np.empty((count, 3))
    for k in range(count):
        for i in range(3):
            for j in range(3):
                for m in range(3):
                    relative[k, i, j] += x.rotation[k, m, i] * x.rotation[k + 1, m, j]
        turn[k, 0], turn[k, 1], turn[k, 2] = rotation_vector(relative[k])
    return relative, turn


@_compiled
def _measured(
    x: Unknowns, prior: Prior, relative: Array, turn: Array, matrix: Array, right: Array
) -> float:
    """Add measured mean angular velocities, and return their robust cost.

    A window's mean is that of the turns between the nodes within it, and of the newest angular
    velocity after them. So it holds the way, and the angular velocities at the nodes follow a hand
    that trembles faster than a window is long. A gyro's bias is taken out of the equations (Schur);
    its measurements are no outliers.
    """
    cost, build, newest = 0.0, len(right) > 0, len(turn)
    rows = np.empty((newest + 2, 3, 3))  # by each rotation, and by the newest angular velocity
    bias = _no_bias(x, prior)
    for m in range(len(prior.measured)):
        error = _apart(x, prior, relative, turn, m, rows)
        residual, squares = prior.measured_root[m] @ error, 0.0
        for a in range(3):
            squares += residual[a] ** 2
        biased, bound = prior.measured_biased[m], prior.measured_outlier**2
        cost += 0.5 * squares if biased else 0.5 * squares / (1 + squares / bound)
        if not (build or biased):
            continue
        weight = 1.0 if biased else 1 / (1 + squares / bound) ** 2
        information = weight * (prior.measured_root[m].T @ prior.measured_root[m])
        if biased:
            _add_to_bias(bias, information, error, rows)
        if not build:
            continue
        for k in range(newest + 2):
            if not np.any(rows[k]):
                continue
            u, pull = _first_unknown(k, newest), rows[k].T @ information
            right[u : u + 3] -= pull @ error
            for i in range(newest + 2):
                if np.any(rows[i]):
                    v = _first_unknown(i, newest)
                    matrix[u : u + 3, v : v + 3] += pull @ rows[i]
    if not np.any(prior.measured_biased):
        return cost
    likeliest = np.linalg.solve(bias.information, bias.right)
    if build:
        matrix -= bias.cross @ np.linalg.solve(bias.information, bias.cross.T)
        right -= bias.cross @ likeliest
    return cost - 0.5 * float(bias.right @ likeliest)


@_compiled
def gyro_bias(x: Unknowns, prior: Prior) -> BiasEquations:
    """Normal equations of the bias that measured angular velocities share, along a way."""
    relative, turn = _turns(x)
    bias, rows = _no_bias(x, prior), np.empty((len(turn) + 2, 3, 3))
    for m in np.flatnonzero(prior.measured_biased):
        error = _apart(x, prior, relative, turn, m, rows)
        _add_to_bias(bias, prior.measured_root[m].T @ prior.measured_root[m], error, rows)
    return bias


@_compiled
def _no_bias(x: Unknowns, prior: Prior) -> BiasEquations:
    return BiasEquations(
        prior.bias_information.copy(), np.zeros(3), np.zeros((NODE * len(x.position), 3))
    )


@_compiled
def _add_to_bias(bias: BiasEquations, information: Array, error: Array, rows: Array) -> None:
    """Add a measurement; what is measured is the mean angular velocity and the bias."""
    bias.information[:] += information
    bias.right[:] -= information @ error
    for k in range(len(rows)):
        if np.any(rows[k]):
            u = _first_unknown(k, len(rows) - 2)
            bias.cross[u : u + 3] += rows[k].T @ information


@_compiled
def _apart(x: Unknowns, prior: Prior, relative: Array, turn: Array, m: int, rows: Array) -> Array:
    """How far a window's mean (3,) lies from what was measured; derivatives into rows."""
    error, newest = -prior.measured[m], len(turn)
    rows[:] = 0.0
    for k in range(newest):
        rate = prior.measured_share[m, k] / prior.seconds[k]
        for a in range(3):
            error[a] += rate * turn[k, a]
            rows[k + 1, a, a] += rate
            for b in range(3):
                rows[k, a, b] -= rate * relative[k, b, a]
    after = prior.measured_share[m, newest]
    for a in range(3):
        error[a] += after * x.angular[newest, a]
        rows[newest + 1, a, a] = after
    return error


@_compiled
def _first_unknown(k: int, newest: int) -> int:
    """First of a node's rotation; after the newest one, of its angular velocity."""
    return NODE * k if k <= newest else NODE * newest + POSE


@_compiled
def prior_cost(x: Unknowns, prior: Prior) -> float:
    """Cost of the motion prior alone."""
    return motion_prior(x, prior, np.empty((0, 0)), np.empty(0))
