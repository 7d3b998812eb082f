"""Ablations: one part of the method changed at a time, on the same windows."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from emoflow_ros.config import Config
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.types.estimate import Estimate, Estimator
from emoflow_ros.core.types.events import Window
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.core.types.options import replace_options
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.slicers import Slicer
from emoflow_ros.evaluation.summary import summarise
from emoflow_ros.evaluation.window_run import Evaluation, evaluate
from emoflow_ros.factory import make_estimator
from emoflow_ros.readers import Recording

_Overrides = dict[str, Any]


@dataclass(frozen=True)
class Variant:
    """One row of an ablation.

    Attributes:
        name: for people.
        overrides: option values by dotted name, over the run's configuration.
        cold: whether every window is estimated without what was learnt from those before.
        has_motion: whether the egomotion is estimated at all.
    """

    name: str
    overrides: Mapping[str, Any] = field(default_factory=_Overrides)
    cold: bool = False
    has_motion: bool = True


# By ablation and estimator; what an estimator does not have is missing.
_VARIANTS: dict[str, dict[str, tuple[Variant, ...]]] = {
    "losses": {
        "implicit": (
            Variant("contrast, then contrast and DEC"),
            Variant("contrast and DEC from the start", {"estimator.loss.contrast_only": 0}),
            Variant("contrast alone", {"estimator.loss.geometry_weight": 0.0}, has_motion=False),
        ),
        "lattice": (
            Variant("contrast and DEC"),
            Variant("contrast alone", {"estimator.dec_weight": 1e-3}),
        ),
    },
    "depth": {
        "implicit": (
            Variant("8 layers", {"estimator.field.layers": 8}),
            Variant("4 layers", {"estimator.field.layers": 4}),
        ),
    },
    "early_stop": {
        "implicit": (
            Variant("all iterations", {"estimator.early_stop.patience": 0}),
            Variant("early stopping", {"estimator.early_stop.patience": 45}),
        ),
    },
    "huber": {
        "implicit": (
            Variant("Huber", {"estimator.loss.penalty": "huber"}),
            Variant("squares", {"estimator.loss.penalty": "squares"}),
        ),
        "lattice": (
            Variant("robust", {"estimator.dec_inlier_px": LatticeConfig.dec_inlier_px}),
            Variant("squares", {"estimator.dec_inlier_px": 100.0}),
        ),
    },
    "start": {
        "lattice": (
            Variant("warm (from the window before)"),
            Variant("cold (every window by itself)", cold=True),
        ),
    },
}

ABLATIONS = tuple(_VARIANTS)


@dataclass(frozen=True)
class Row:
    """The figures of one variant; None where unknown.

    Attributes:
        name: the variant.
        overrides: what it changes.
        windows_ok: windows with an estimate.
        epe_px, out_percent: flow errors, as in the summary.
        angular_rms_deg_s: RMS error of w.
        direction_error_deg: median direction error of v.
        seconds_per_window: median.
    """

    name: str
    overrides: dict[str, Any]
    windows_ok: int
    epe_px: float | None
    out_percent: float | None
    angular_rms_deg_s: float | None
    direction_error_deg: float | None
    seconds_per_window: float | None


@dataclass(frozen=True)
class Ablation:
    """The rows of an ablation; fewer than it has variants where Ctrl-C ended it."""

    name: str
    rows: tuple[Row, ...]
    interrupted: bool = False


def variants_of(name: str, config: Config) -> tuple[Variant, ...]:
    """List the variants of an ablation.

    Raises:
        InputError: the configured estimator does not have what is ablated.
    """
    variants = _VARIANTS[name].get(config.method)
    if variants is None:
        able = [n for n, by_method in _VARIANTS.items() if config.method in by_method]
        other = "realtime" if config.method == "implicit" else "paper"
        raise InputError(
            f"--ablate {name}",
            f"the {config.method} estimator of profile {config.profile} has no such part",
            f"use --profile {other}, or one of {', '.join(able)}",
        )
    for variant in variants:
        replace_options(config, variant.overrides)  # refuses before anything is estimated
    return variants


def ablate(
    name: str,
    config: Config,
    recording: Recording,
    slicer: Slicer,
    base: Evaluation,
    *,
    gyro: GyroReadings | None = None,
    max_windows: int | None = None,
) -> Ablation:
    """Evaluate every variant on the windows of a finished run.

    Args:
        name: one of ABLATIONS.
        config: of the finished run.
        recording: its recording.
        slicer: its slicer, in its first state.
        base: the run, which serves the variant that changes nothing.
        gyro: readings for the windows, where a gyro is used.
        max_windows: where the run stopped, if not at the recording's end.

    Raises:
        InputError: see `variants_of`.
    """
    rows: list[Row] = []
    for variant in variants_of(name, config):
        changed = replace_options(config, variant.overrides)
        run = base
        if changed != config or variant.cold:
            estimator = make_estimator(base.camera, changed)
            run = evaluate(
                recording,
                ColdStarts(estimator) if variant.cold else estimator,
                copy.deepcopy(slicer),
                base.truth,
                gyro=gyro,
                max_windows=max_windows,
                progress_bar=True,
            )
        if run.interrupted:
            return Ablation(name, tuple(rows), interrupted=True)
        rows.append(_row(variant, run))
    return Ablation(name, tuple(rows))


class ColdStarts:
    """An estimator that forgets before every window."""

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator

    def estimate(self, window: Window) -> Estimate:
        """Estimate one window from a cold start."""
        self._estimator.reset()
        return self._estimator.estimate(window)

    def reset(self) -> None:
        """Forget previous windows."""
        self._estimator.reset()


def _row(variant: Variant, run: Evaluation) -> Row:
    figures = {m.key: m.value for m in summarise(run.windows)}
    motion = figures if variant.has_motion else {}
    milliseconds = figures.get("runtime_p50_ms")
    return Row(
        name=variant.name,
        overrides=dict(variant.overrides),
        windows_ok=sum(w.ok for w in run.windows),
        epe_px=figures.get("epe_px"),
        out_percent=figures.get("out_percent"),
        angular_rms_deg_s=motion.get("angular_rms_deg_s"),
        direction_error_deg=motion.get("direction_error_deg"),
        seconds_per_window=None if milliseconds is None else milliseconds / 1000,
    )
