"""What realtime.py measures: scores of windows, and the figures over them with their targets."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scoreboard.uncertainty import direction_errors, normalised_squares
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.evaluation.window_results import MIN_TRUE_SPEED, WindowResult
from emoflow_ros.simulation.simulated_truth import GroundTruth
from emoflow_ros.truth import TrueFlow, TrueTwist

SCENES = ("calm", "forward", "mover", "noisy", "agile", "rotation", "driving")
MIN_WINDOWS = 50  # per scene, for the targets to mean something
PAPER_SPEED_UP = 5000.0  # target: the published loop's time over a warm window's
_FLOW_SCENES = ("calm", "forward", "mover", "noisy")
_TRANSLATING_SCENES = tuple(scene for scene in SCENES if scene != "rotation")


@dataclass(frozen=True)
class Score:
    """One window: its comparison with the truth, and what it cost.

    Attributes:
        result: see WindowResult; `quality.warm` tells warm windows.
        seconds: estimate and flow image, in the stream of windows.
        flow_seconds: the flow image alone; NaN where there is no flow.
        cold_seconds: the same with a fresh estimator; NaN where not measured.
        nees_w, nees_v: see `normalised_errors`.
    """

    result: WindowResult
    seconds: float
    flow_seconds: float
    cold_seconds: float
    nees_w: float
    nees_v: float


class SimulatedTruth:
    """A simulation's truth as the evaluation takes it (a TwistSource and a FlowSource)."""

    name = "simulation"
    description = "simulation, exact"

    def __init__(self, truth: GroundTruth) -> None:
        self._truth = truth

    def twist(self, t: int) -> TrueTwist:
        """Velocity at time t (ns)."""
        linear, angular = self._truth.twist(t)
        return TrueTwist(angular, linear)

    def displacement(self, t0: int, t1: int) -> TrueFlow:
        """Displacement of the pixels of t0 until t1 (ns)."""
        flow = self._truth.displacement(t0, t1)
        valid = np.isfinite(flow).all(axis=-1)
        known = np.where(valid[..., None], flow, 0).astype(np.float32)
        return TrueFlow(known, valid, self._truth.moving_mask(t0))


def normalised_errors(estimate: Estimate, result: WindowResult) -> tuple[float, float]:
    """Square the errors of w and of v's direction, over covariance and degrees of freedom.

    Returns:
        The normalised estimation error squared (Bar-Shalom et al., 2001) of w, over 3, and of
        v on the tangent plane of its direction, over 2. Both are 1 on average for a covariance
        that is right, and NaN where there is no estimate or no true direction, and for an error of
        exactly zero.
    """
    nees_w = normalised_squares(result.angular_error[None], estimate.covariance[None, 3:, 3:])
    errors, covariance = direction_errors(
        result.linear[None], result.true_direction[None], estimate.covariance[None, :3, :3]
    )
    nees_v = normalised_squares(errors, covariance)
    return float(nees_w[0]), float(nees_v[0])


@dataclass(frozen=True)
class Measure:
    """A figure over windows.

    Attributes:
        key, label: names in the JSON file and for people, the unit with the latter.
        of: the figure; NaN where no window has it.
        targets: upper bounds by scene.
        worst: picks the worst of several seeds' figures; unknown if one of them is.
    """

    key: str
    label: str
    of: Callable[[Sequence[Score]], float]
    targets: Mapping[str, float] = field(default_factory=dict)
    worst: Callable[[Iterable[float]], float] = max


def _over(statistic: Callable[[NDArray[np.float64]], Any], values: Iterable[float]) -> float:
    """Apply a statistic to the values that are finite; NaN without any."""
    array = np.array([value for value in values if np.isfinite(value)])
    return float(statistic(array)) if len(array) else float("nan")


def _warm_ms(scores: Sequence[Score]) -> list[float]:
    return [1e3 * s.seconds for s in scores if s.result.quality.warm]


def _flow(scores: Sequence[Score], name: str) -> float:
    return _over(np.mean, [getattr(s.result.flow, name) for s in scores if s.result.flow])


def _angular_rms_deg_s(scores: Sequence[Score]) -> float:
    errors = np.concatenate([s.result.angular_error for s in scores])
    return _over(lambda e: np.degrees(np.sqrt(np.mean(e**2))), errors)


def _angular_rms_percent(scores: Sequence[Score]) -> float:
    true = [s.result.truth for s in scores]
    mean = np.mean([np.degrees(np.linalg.norm(twist.angular)) for twist in true if twist])
    return 100 * _angular_rms_deg_s(scores) / float(mean)


def _observed_percent(scores: Sequence[Score]) -> float:
    moving = [s.result for s in scores if np.isfinite(s.result.true_direction).all()]
    return _over(np.mean, [100.0 * np.isfinite(r.linear).all() for r in moving])


MEASURES = (
    Measure(
        "warm_ms",
        "warm window, median, ms",
        lambda scores: _over(np.median, _warm_ms(scores)),
        dict.fromkeys(SCENES, 12.0),
    ),
    Measure(
        "warm_p99_ms",
        "warm window, 99 %, ms",
        lambda scores: _over(lambda ms: np.percentile(ms, 99), _warm_ms(scores)),
        dict.fromkeys(SCENES, 60.0),
    ),
    Measure(
        "flow_ms",
        "flow image alone, median, ms",
        lambda scores: _over(np.median, [1e3 * s.flow_seconds for s in scores]),
        dict.fromkeys(SCENES, 1.0),
    ),
    Measure(
        "cold_ms",
        "cold window, median, ms",
        lambda scores: _over(np.median, [1e3 * s.cold_seconds for s in scores]),
        dict.fromkeys(SCENES, 400.0),
    ),
    Measure(
        "epe_px",
        "flow EPE, px",
        lambda scores: _flow(scores, "epe_px"),
        dict.fromkeys(_FLOW_SCENES, 0.7),
    ),
    Measure(
        "out_percent",
        "flow outliers (> 3 px), %",
        lambda scores: _flow(scores, "pe3"),
        dict.fromkeys(_FLOW_SCENES, 1.0),
    ),
    Measure("true_px", "true displacement, px", lambda scores: _flow(scores, "truth_px")),
    Measure("w_rms_deg_s", "RMS error of w, deg/s", _angular_rms_deg_s, {"calm": 1.0}),
    Measure("w_rms_percent", "RMS error of w / mean |w|, %", _angular_rms_percent, {"agile": 3.0}),
    Measure(
        "v_error_deg",
        "signed direction error of v, median, deg",
        lambda scores: _over(np.median, [s.result.direction_error_deg for s in scores]),
        dict.fromkeys(_TRANSLATING_SCENES, 5.0),
    ),
    Measure(
        "observed_percent",
        f"v given where |v| >= {MIN_TRUE_SPEED} m/s, %",
        _observed_percent,
        worst=min,
    ),
    Measure(
        "ok_percent",
        "windows with status ok, %",
        lambda scores: _over(np.mean, [100.0 * s.result.ok for s in scores]),
        worst=min,
    ),
    Measure("nees_w", "NEES of w (1 = right)", lambda s: _over(np.mean, [x.nees_w for x in s])),
    Measure("nees_v", "NEES of v (1 = right)", lambda s: _over(np.mean, [x.nees_v for x in s])),
)


def summarise(scene: str, by_seed: Mapping[int, Sequence[Score]]) -> dict[str, Any]:
    """Compute all measures of a scene: over all seeds, per seed, and of the worst seed."""
    everything = [score for scores in by_seed.values() for score in scores]
    seeds = {seed: _figures(scores) for seed, scores in by_seed.items()}
    worst = {}
    for measure in MEASURES:
        values = [figures[measure.key] for figures in seeds.values()]
        worst[measure.key] = None if None in values else measure.worst(values)
    return {
        "targets": {m.key: m.targets[scene] for m in MEASURES if scene in m.targets},
        "all": _figures(everything),
        "worst_seed": worst,
        "seeds": seeds,
    }


def _figures(scores: Sequence[Score]) -> dict[str, Any]:
    values = {measure.key: measure.of(scores) for measure in MEASURES}
    return {
        "windows": len(scores),
        "warm_windows": sum(s.result.quality.warm for s in scores),
        "cold_windows": int(np.isfinite([s.cold_seconds for s in scores]).sum()),
        "events": float(np.median([s.result.events for s in scores])),
        "events_used": float(np.median([s.result.quality.events for s in scores])),
        "models": dict(Counter(s.result.model for s in scores if s.result.ok)),
        **{key: value if np.isfinite(value) else None for key, value in values.items()},
    }
