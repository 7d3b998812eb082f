"""Confidence intervals and significance by resampling windows (Efron and Tibshirani, 1993)."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_RESAMPLES = 1000
_TAILS = (2.5, 97.5)  # percent: a 95 % interval

Values = NDArray[np.float64]
Statistic = Callable[[Values], float]


def bootstrap_interval(values: Values, statistic: Statistic) -> tuple[float, float]:
    """95 % percentile interval of a statistic, always the same for the same values.

    Args:
        values: (N, ...), the rows that are resampled.
        statistic: from such rows to the figure.

    Returns:
        Lower and upper end; NaN with fewer than two rows.
    """
    if len(values) < 2:
        return float("nan"), float("nan")
    low, high = np.percentile(_draws(values, statistic), _TAILS)
    return float(low), float(high)


def paired_p_value(differences: Values) -> float:
    """Two-sided p-value of a mean difference (N,) of pairs, against the mean being zero.

    The share of resampled means, of the differences less their mean, that are at least as far
    from zero as the mean itself; never below 1 / 1001. NaN with fewer than two pairs.
    """
    if len(differences) < 2:
        return float("nan")
    mean = differences.mean()
    draws = _draws(differences - mean, np.mean)
    return float((1 + (np.abs(draws) >= abs(mean)).sum()) / (1 + _RESAMPLES))


def _draws(values: Values, statistic: Statistic) -> Values:
    rng = np.random.default_rng(0)
    rows = len(values)
    return np.array([statistic(values[rng.integers(rows, size=rows)]) for _ in range(_RESAMPLES)])
