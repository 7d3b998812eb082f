"""Intervals and p-values against textbook formulas and hand-made draws."""

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from emoflow_ros.evaluation.metrics import bootstrap_interval, paired_p_value


def test_interval_of_a_normal_mean():
    """The textbook's +-1.96 standard errors."""
    values = np.random.default_rng(1).normal(10, 2, 400)
    low, high = bootstrap_interval(values, np.mean)
    error = 1.96 * values.std() / np.sqrt(len(values))
    assert low == pytest.approx(values.mean() - error, abs=0.03)
    assert high == pytest.approx(values.mean() + error, abs=0.03)


def test_rows_are_resampled_whole():
    """The ratio of two columns that are proportional has no spread."""
    column = np.random.default_rng(2).uniform(1, 2, 50)
    rows = np.stack([column, 3 * column], axis=1)
    interval = bootstrap_interval(rows, lambda pairs: pairs[:, 1].sum() / pairs[:, 0].sum())
    assert interval == pytest.approx((3, 3))


def test_one_row_has_no_interval_and_one_pair_no_p_value():
    assert np.isnan(bootstrap_interval(np.ones(1), np.mean)).all()
    assert np.isnan(paired_p_value(np.ones(1)))


@pytest.mark.parametrize("mean", [0.05, 0.1, 0.2])
def test_p_value_is_that_of_the_t_test(mean):
    values = np.random.default_rng(3).normal(mean, 1, 200)
    assert paired_p_value(values) == pytest.approx(ttest_1samp(values, 0).pvalue, abs=0.03)


def test_p_value_does_not_depend_on_the_order_of_runs():
    values = np.random.default_rng(4).normal(0.1, 1, 100)
    assert paired_p_value(-values) == pytest.approx(paired_p_value(values))


def test_extreme_p_values():
    assert paired_p_value(np.zeros(20)) == 1.0
    assert paired_p_value(np.full(20, 0.5)) == pytest.approx(1 / 1001)
