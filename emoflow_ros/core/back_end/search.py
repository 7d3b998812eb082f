"""Where the adjustment starts from, and whether the camera translates or only rotates."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment import Adjusted, adjust, free_unknowns
from emoflow_ros.core.back_end.adjustment_kernels import (
    Observations,
    Unknowns,
    likeliest_depths,
)
from emoflow_ros.core.back_end.descent import descend
from emoflow_ros.core.back_end.evidence import Measured
from emoflow_ros.core.back_end.hypotheses import Guess, Hypotheses
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import along
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]
Times = NDArray[np.int64]


def best(
    problem: Observations, start: Unknowns, prior: Prior, others: list[Unknowns],
    settings: BackEndSettings,
) -> tuple[Adjusted, list[Guess]] | None:  # fmt: skip
    """Adjust from a start and from others; take the least cost.

    The others are guesses, so that outliers are told from them step by step (graduated
    non-convexity: Blake and Zisserman, Visual Reconstruction, 1987).

    Args:
        problem: the places of patches.
        start: goes on from the last adjustment.
        prior: of the motion.
        others: that may be better; their depths are looked for.
        settings: of the back end.

    Returns:
        The best, and where the others led to; None if all diverge.
    """
    with ThreadPoolExecutor(1) as beside:  # a second one brings nothing: the start takes a core
        guesses = [beside.submit(_guessed, problem, x, prior, settings) for x in others]
        found = _adjusted(problem, start, prior, settings)
    led: list[Guess] = []
    for guess in filter(None, (guess.result() for guess in guesses)):
        if found is not None and guess[1] >= found.cost:
            led.append(guess)
            continue
        further = _adjusted(problem, guess[0], prior, settings)
        if further is None:
            continue
        if found is None or further.cost < found.cost:
            found, further = further, found
        if further is not None:
            led.append((further.x, further.cost))
    return None if found is None else (found, led)


def _guessed(
    problem: Observations, x: Unknowns, prior: Prior, settings: BackEndSettings
) -> Guess | None:
    """Adjust from a guess of the way alone, its depths being the likeliest ones.

    Returns:
        With its cost; None if it diverges.
    """
    free, cost = free_unknowns(len(x.position), translates=True), np.inf
    x = x._replace(inverse_depth=likeliest_depths(problem, x, settings.outlier))
    with suppress(np.linalg.LinAlgError):
        for outlier, steps in settings.guess:
            x, cost = descend(problem, x, prior, outlier, steps, free, settings.depths)
        return (x, cost) if np.isfinite(cost) else None
    return None


def _adjusted(
    problem: Observations, x: Unknowns, prior: Prior, settings: BackEndSettings
) -> Adjusted | None:
    """Adjust from a start; None if it diverges."""
    with suppress(np.linalg.LinAlgError):
        return adjust(problem, x, prior, settings.outlier, settings.steps, settings.depths)
    return None


def starts(
    t: Times, x: Unknowns, measured: tuple[Measured, ...], before: Hypotheses | None,
    settings: BackEndSettings,
) -> list[Unknowns]:  # fmt: skip
    """List other starts: as measured, and the last rival.

    Without the first a wrong memory would keep itself up: it predicts what it sees. While the
    memory fills, all directions are tried now and then.

    Args:
        t: (K,) ns of the nodes.
        x: the start that goes on from the last adjustment.
        measured: velocities of windows.
        before: what the last adjustment found possible, at these nodes; None if there is none.
        settings: of the back end.
    """
    depths, found = np.ones(len(x.inverse_depth)), list[Unknowns]()
    if measured:
        nearest = np.abs(np.array([m.t for m in measured]) - t[:, None]).argmin(axis=1)
        angular = np.array([measured[n].angular for n in nearest])
        linear = settings.start_speed * np.array([measured[n].direction for n in nearest])
        found.append(along(t, angular, linear, depths))
    if before is not None and before.rival is not None:
        found.append(before.rival._replace(inverse_depth=depths))
    if before is not None and len(t) not in settings.directions_at:
        return found
    for direction in _sphere(settings.directions):
        velocity = np.tile(settings.start_speed * direction, (len(t), 1))
        position = (t - t[-1])[:, None] / NS_PER_S * velocity
        found.append(x._replace(position=position, velocity=velocity, inverse_depth=depths))
    return found


def rotating(
    problem: Observations, translating: Adjusted, prior: Prior, settings: BackEndSettings
) -> Adjusted | None:
    """Adjust a camera that only rotates, from one that translates; None if that diverges."""
    with suppress(np.linalg.LinAlgError):
        return adjust(
            problem, translating.x, prior, settings.outlier, settings.steps, settings.depths,
            translates=False,
        )  # fmt: skip
    return None


def _sphere(count: int) -> Array:
    """Unit vectors (count, 3) spread evenly over the sphere (a Fibonacci lattice)."""
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    azimuth, radius = np.pi * (1 + np.sqrt(5)) * (k + 0.5), np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
