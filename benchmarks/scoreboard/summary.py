"""A run as one document: scores by group, rates by group, by criterion and by factor."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from benchmarks.scoreboard.run import Outcome
from benchmarks.scoreboard.score_summary import summarise_scores
from benchmarks.scoreboard.verdicts import CRITERIA, rate
from emoflow_ros.config import Config
from emoflow_ros.evaluation.provenance import machine, versions

FORMAT = 1
_PARTS = 3


def summarise(
    outcomes: Sequence[Outcome], config: Config, missing: Sequence[str], load: float
) -> dict[str, Any]:
    """Collect everything about a run that goes into its JSON file.

    Args:
        outcomes: of the recordings that are there.
        config: of the estimator.
        missing: names of those that are not.
        load: average load of the machine when the run began.
    """
    groups = {name: [o for o in outcomes if o.group == name] for name in _groups(outcomes)}
    every = {"all": outcomes, **groups}
    return {
        "format": FORMAT,
        "date": datetime.now(UTC).date().isoformat(),
        "versions": versions(),
        "machine": machine(),
        "load_average_at_start": load,
        "configuration": config.flat(),
        "missing": list(missing),
        "scores": {name: _scores(some) for name, some in every.items()},
        "rates": {name: rates(some) for name, some in every.items()},
        "factors": breakdown(groups.get("random", [])),
        "recordings": [outcome.document() for outcome in outcomes],
    }


def rates(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Rates of accurate and consistent recordings and of each criterion, percent."""
    verdicts = [outcome.verdict for outcome in outcomes]
    return {
        "recordings": len(outcomes),
        "accurate": rate([verdict.accurate for verdict in verdicts]),
        "consistent": rate([verdict.consistent for verdict in verdicts]),
        **{name: rate([verdict.criteria[name] for verdict in verdicts]) for name in CRITERIA},
    }


def breakdown(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Rates by factor: numbers in three parts of equally many recordings, words as they are.

    Returns:
        One row per factor and value: factor, value, recordings, accurate and consistent in percent.
    """
    rows = []
    for factor in sorted({factor for outcome in outcomes for factor in outcome.factors}):
        having = [outcome for outcome in outcomes if factor in outcome.factors]
        label = _labels([outcome.factors[factor] for outcome in having])
        by_label: dict[str, list[Outcome]] = {}
        for outcome in having:
            by_label.setdefault(label(outcome.factors[factor]), []).append(outcome)
        names = sorted(by_label, key=lambda name: _order(name, having, factor, label))
        for name in names:
            found = rates(by_label[name])
            row = {key: found[key] for key in ("recordings", "accurate", "consistent")}
            rows.append({"factor": factor, "value": name, **row})
    return rows


def _order(
    name: str, outcomes: Sequence[Outcome], factor: str, label: Callable[[Any], str]
) -> tuple[float, str]:
    """Sort key of a value: numbers by size, then words."""
    values = [o.factors[factor] for o in outcomes if label(o.factors[factor]) == name]
    return (min(values), "") if all(map(_is_number, values)) else (np.inf, name)


def _labels(values: Sequence[Any]) -> Callable[[Any], str]:
    """Choose how a factor's values are grouped: by tercile, or each for itself."""
    numbers = [float(value) for value in values if _is_number(value)]
    if len(numbers) < len(values) or len(set(numbers)) <= _PARTS:
        return lambda value: f"{value:.4g}" if _is_number(value) else str(value)
    edges = np.quantile(numbers, [1 / 3, 2 / 3])
    low, high = min(numbers), max(numbers)
    bounds = [low, *edges, high]

    def tercile(value: Any) -> str:
        part = int(np.searchsorted(edges, value, side="left"))
        first, last = f"{bounds[part]:.3g}", f"{bounds[part + 1]:.3g}"
        return first if first == last else f"{first} to {last}"

    return tercile


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scores(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    return summarise_scores([outcome.figures for outcome in outcomes])


def _groups(outcomes: Sequence[Outcome]) -> list[str]:
    return list(dict.fromkeys(outcome.group for outcome in outcomes))
