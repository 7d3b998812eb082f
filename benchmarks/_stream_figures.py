"""What stream.py reports of a recording: how often there is a twist, and how right it is."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks._rows import Row
from benchmarks.scoreboard.uncertainty import normalised_squares, sigma_along

Array = NDArray[np.float64]

INTERVAL_S = 0.1
MOVING_PX_S = 5.0
SIGMAS = 3.0
NEES = (0.5, 2.0)


@dataclass
class Heard:
    """What one topic said: per message its time in the recording, s, w and its covariance."""

    times: list[float] = field(default_factory=list)
    angular: list[Array] = field(default_factory=list)
    covariance: list[Array] = field(default_factory=list)


@dataclass(frozen=True)
class Stream:
    """One recording as a subscriber saw it.

    Attributes:
        seed: of the recording.
        duration_s: of the recording.
        twist: times of `egomotion/twist`, s.
        now, windows: `egomotion/twist_now` and `egomotion/twist_with_covariance`.
        statuses: of the windows.
    """

    seed: int
    duration_s: float
    twist: Sequence[float]
    now: Heard
    windows: Heard
    statuses: Sequence[str]


def intervals(
    times: Sequence[float], duration_s: float, speed: Callable[[float], float]
) -> dict[str, tuple[int, int]]:
    """Count the 100 ms intervals after the first twist, and those with a twist: moving, at rest.

    Args:
        times: of twists, s.
        duration_s: of the recording.
        speed: px/s of the image at a time, s.
    """
    counts = {"moving": [0, 0], "rest": [0, 0]}
    first = math.ceil(min(times, default=0.0) / INTERVAL_S)
    number = np.floor(np.asarray(times) / INTERVAL_S).astype(int)
    for k in range(first, math.floor(duration_s / INTERVAL_S)):
        kind = "moving" if speed((k + 0.5) * INTERVAL_S) > MOVING_PX_S else "rest"
        counts[kind][0] += 1
        counts[kind][1] += bool((number == k).any())
    return {kind: (all_of, heard) for kind, (all_of, heard) in counts.items()}


def longest_silence(times: Sequence[float], duration_s: float) -> float:
    """Return the longest time without a twist from the first one to the end, s, or infinity."""
    if not times:
        return math.inf
    return float(np.diff([*sorted(times), duration_s]).max())


def errors(heard: Heard, truth: Callable[[float], Array]) -> tuple[Array, Array, Array]:
    """Return the NEES of w (N,), NaN where the error is exactly zero, and which exceed 3 sigma.

    Of normal errors with that covariance 0.3 % do along each axis (N, 3), but along their own
    direction (N,) up to 2.9 %: so many if it is the same in all directions (chi squared).
    """
    if not heard.times:
        return np.empty(0), np.empty(0, bool), np.empty((0, 3), bool)
    error = np.array(heard.angular) - np.array([truth(t) for t in heard.times])
    covariance = np.array(heard.covariance)
    missed = np.linalg.norm(error, axis=1) > SIGMAS * sigma_along(error, covariance)
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return normalised_squares(error, covariance), missed, np.abs(error) > SIGMAS * deviation


def figures(
    stream: Stream, speed: Callable[[float], float], truth: Callable[[float], Array]
) -> dict[str, Any]:
    """Compute what is reported of a recording; `truth` is w at a time, rad/s."""
    found: dict[str, Any] = {
        "seed": stream.seed,
        "first_s": min(stream.twist, default=None),
        "intervals": intervals(stream.twist, stream.duration_s, speed),
        "silence_s": longest_silence(stream.twist, stream.duration_s),
        "statuses": dict(Counter(stream.statuses)),
    }
    for name, heard in (("now", stream.now), ("windows", stream.windows)):
        nees, missed, by_axis = errors(heard, truth)
        known, some = len(nees) > 0, nees[np.isfinite(nees)]
        found[name] = {
            "twists": len(nees),
            "nees": float(some.mean()) if len(some) else None,
            "missed_percent": 100.0 * float(missed.mean()) if known else None,
            "missed_by_axis_percent": 100.0 * float(by_axis.mean()) if known else None,
        }
    return found


def rows(recordings: Sequence[dict[str, Any]]) -> list[Row]:
    """Sum up recordings beside the targets."""

    def share(kind: str) -> float | None:
        counts = [r["intervals"][kind] for r in recordings]
        total = sum(all_of for all_of, _ in counts)
        return 100.0 * sum(heard for _, heard in counts) / total if total else None

    silence = max(r["silence_s"] for r in recordings)
    windows = sum(sum(r["statuses"].values()) for r in recordings)
    dropped = sum(r["statuses"].get("dropped", 0) for r in recordings)
    found = [
        Row("windows dropped, %", 100.0 * dropped / windows if windows else None),
        Row("100 ms intervals with a twist, moving, %", share("moving"), at_least=95.0),
        Row("100 ms intervals with a twist, at rest, %", share("rest"), at_least=95.0),
        Row("longest silence, s", silence if math.isfinite(silence) else None, at_most=0.5),
    ]
    for name in ("now", "windows"):
        heard = [r[name] for r in recordings]
        nees = [topic["nees"] for topic in heard if topic["nees"] is not None]
        right = 100.0 * float(np.mean([NEES[0] <= n <= NEES[1] for n in nees])) if nees else None
        missed, by_axis = (
            _over_twists(heard, figure) for figure in ("missed_percent", "missed_by_axis_percent")
        )
        found += [
            Row(f"recordings with a NEES of w of 0.5 to 2, {name}, %", right, at_least=80.0),
            Row(f"3-sigma misses of w, {name}, %", missed, at_most=1.0),
            Row(f"the same by axis, {name}, %", by_axis, at_most=1.0),
        ]
    return found


def _over_twists(heard: Sequence[dict[str, Any]], figure: str) -> float | None:
    """Mean of a figure of recordings over all of their twists; None without any."""
    twists = sum(topic["twists"] for topic in heard)
    total = sum(topic["twists"] * (topic[figure] or 0.0) for topic in heard)
    return total / twists if twists else None
