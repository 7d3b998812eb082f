"""Where the adjustment starts from, and whether the camera travels or only rotates."""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment import Adjusted, adjust
from emoflow_ros.core.back_end.adjustment_kernels import Observations, Unknowns
from emoflow_ros.core.back_end.evidence import Measured
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import along

Array = NDArray[np.float64]
Times = NDArray[np.int64]


def best(
    problem: Observations, start: Unknowns, prior: Prior, others: list[Unknowns],
    settings: BackEndSettings, *, full: bool,
) -> Adjusted | None:  # fmt: skip
    """Adjust from a start, and from others if it fits badly; take the least cost.

    Args:
        problem: the places of patches.
        start: goes on from the last adjustment.
        prior: of the motion.
        others: that may be better.
        settings: of the back end.
        full: whether the memory is full: while it fills, all starts are tried.

    Returns:
        None if all diverge.
    """
    found = _adjusted(problem, start, prior, settings.steps, settings)
    if MODE >= 1:
        if True:
            made = _annealed(problem, start, prior, ((8.0, 4), (4.0, 4), (2.0, settings.steps)), settings)
        if made is not None and (found is None or made.cost < found.cost):
            found = made
    if full and found is not None and found.mean_cost(settings) < settings.doubtful_cost and MODE < 2:
        return found
    for x in others:
        made = _annealed(problem, x, prior, ((8.0, 6), (4.0, 4), (2.0, settings.steps)), settings) if MODE else _adjusted(problem, x, prior, settings.first_steps, settings)
        if made is not None and (found is None or made.cost < found.cost):
            found = made
    return found


import os
MODE = int(os.environ.get("GNC", "0"))


def _annealed(problem, x, prior, plan, settings):
    found = None
    with suppress(np.linalg.LinAlgError):
        for outlier, steps in plan:
            found = adjust(problem, x, prior, outlier, steps, settings.depths)
            x = found.x
        return found
    return None


def _adjusted(
    problem: Observations, x: Unknowns, prior: Prior, steps: int, settings: BackEndSettings
) -> Adjusted | None:
    with suppress(np.linalg.LinAlgError):
        return adjust(problem, x, prior, settings.outlier, steps, settings.depths)
    return None


def starts(
    t: Times, x: Unknowns, measured: tuple[Measured, ...], settings: BackEndSettings, *, first: bool
) -> list[Unknowns]:
    """List other starts: as measured and at one place, and while the memory fills, directions.

    Without the former a wrong memory would keep itself up: it predicts what it sees.

    Args:
        t: (K,) ns of the nodes.
        x: the start that goes on from the last adjustment.
        measured: velocities of windows.
        settings: of the back end.
        first: whether there is no last adjustment.
    """
    depths = np.ones(len(x.inverse_depth))
    found = []
    if measured:
        nearest = np.abs(np.array([m.t for m in measured]) - t[:, None]).argmin(axis=1)
        angular = np.array([measured[n].angular for n in nearest])
        linear = settings.start_speed * np.array([measured[n].direction for n in nearest])
        found = [along(t, angular, direction * linear, depths) for direction in (1.0, 0.0)]
    if len(t) < settings.slices and (first or len(t) in settings.directions_at):
        still = along(t, x.angular, np.zeros((len(t), 3)), depths)
        for direction in _sphere(settings.directions):
            velocity = np.tile(settings.start_speed * direction, (len(t), 1))
            seconds = (t - t[-1])[:, None] * 1e-9
            found.append(
                still._replace(rotation=x.rotation, position=seconds * velocity, velocity=velocity)
            )
    return found


def rotating(
    problem: Observations, travelling: Adjusted, prior: Prior, settings: BackEndSettings
) -> Adjusted | None:
    """Adjust a camera that only rotates, from one that travels; None if that diverges."""
    with suppress(np.linalg.LinAlgError):
        return adjust(
            problem, travelling.x, prior, settings.outlier, settings.rotation_steps,
            settings.depths, travels=False,
        )  # fmt: skip
    return None


def _sphere(count: int) -> Iterator[Array]:
    """Unit vectors spread evenly over the sphere (a Fibonacci lattice)."""
    for k in range(count):
        z = 1 - (2 * k + 1) / count
        azimuth, radius = np.pi * (1 + np.sqrt(5)) * (k + 0.5), np.sqrt(1 - z * z)
        yield np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), z])
