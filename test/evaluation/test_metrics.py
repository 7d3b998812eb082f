"""Metrics against hand-computed cases and a slow, obvious implementation.

Intervals and p-values against textbook formulas and hand-made draws.
"""

import math

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from emoflow_ros.core.types.events import Events
from emoflow_ros.evaluation import metrics
from emoflow_ros.evaluation.metrics import bootstrap_interval, paired_p_value


def slow_flow_errors(flow, truth):
    """One pixel after the other, with `math` only."""
    epe, above, angle, length = [], [0, 0, 0], [], []
    for (u, v), (a, b) in zip(flow.tolist(), truth.tolist(), strict=True):
        if not (math.isfinite(u) and math.isfinite(v)):
            continue
        error = math.sqrt((u - a) ** 2 + (v - b) ** 2)
        epe.append(error)
        for i, limit in enumerate((1, 2, 3)):
            above[i] += error > limit
        cosine = (u * a + v * b + 1) / math.sqrt((u * u + v * v + 1) * (a * a + b * b + 1))
        angle.append(math.degrees(math.acos(min(1.0, max(-1.0, cosine)))))
        length.append(math.sqrt(a * a + b * b))
    n = len(epe)
    return sum(epe) / n, *(100 * k / n for k in above), sum(angle) / n, sum(length) / n, n


def test_hand_computed_flow_errors():
    # Errors of 5, 0 and 1.5 px; the fourth pixel has no estimate.
    flow = np.array([[3.0, 4.0], [1.0, 0.0], [0.0, 2.5], [np.nan, 9.0]])
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    errors = metrics.flow_errors(flow, truth)
    assert errors.pixels == 3
    assert errors.epe_px == pytest.approx(6.5 / 3)
    assert errors.pe1 == pytest.approx(200 / 3)
    assert errors.pe2 == pytest.approx(100 / 3)
    assert errors.pe3 == pytest.approx(100 / 3)
    assert errors.truth_px == pytest.approx(2 / 3)
    first = math.degrees(math.acos(1 / math.sqrt(26)))
    third = math.degrees(math.acos((2.5 + 1) / math.sqrt((2.5**2 + 1) * 2)))
    assert errors.ae_deg == pytest.approx((first + third) / 3)


def test_exactly_three_pixels_is_no_outlier():
    flow = np.array([[3.0, 0.0], [3.001, 0.0]])
    assert metrics.flow_errors(flow, np.zeros((2, 2))).pe3 == 50.0


def test_flow_errors_equal_the_slow_implementation():
    rng = np.random.default_rng(1)
    truth = rng.normal(0, 4, (200, 2))
    flow = truth + rng.normal(0, 2, truth.shape)
    flow[23] = np.nan
    e = metrics.flow_errors(flow, truth)
    ours = (e.epe_px, e.pe1, e.pe2, e.pe3, e.ae_deg, e.truth_px, e.pixels)
    assert ours == pytest.approx(slow_flow_errors(flow, truth), rel=1e-9)
    assert e.pixels == 199


def test_nothing_to_compare_is_none():
    assert metrics.flow_errors(np.full((2, 2), np.nan), np.ones((2, 2))) is None
    assert metrics.flow_errors(np.empty((0, 2)), np.empty((0, 2))) is None


def test_event_mask_marks_the_pixels_with_events():
    events = Events(
        np.array([0, 2, 2], np.uint16),
        np.array([1, 0, 0], np.uint16),
        np.array([1, 2, 3], np.int64),
        np.array([True, False, True]),
    )
    expected = np.array([[False, False, True], [True, False, False]])
    np.testing.assert_array_equal(metrics.event_mask(events, 3, 2), expected)
    np.testing.assert_array_equal(metrics.event_mask(events, 2, 2), expected[:, :2])


def test_known_flow_needs_both_components_finite_and_not_zero():
    truth = np.array([[[1.0, 1.0], [0.0, 1.0], [1.0, 0.0], [np.nan, 1.0], [-1.0, -0.1]]])
    expected = [[True, False, False, False, True]]
    np.testing.assert_array_equal(metrics.known_flow_mask(truth), expected)


def test_pixels_are_taken_row_by_row():
    mask = np.array([[False, True, True], [True, False, False]])
    flow = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    pixels, values = metrics.at_pixels(mask, flow)
    np.testing.assert_array_equal(pixels, [[1, 0], [2, 0], [0, 1]])
    np.testing.assert_array_equal(values, flow[mask])
    assert values.dtype == np.float32


@pytest.mark.parametrize(
    ("a", "b", "degrees"),
    [
        ([1, 0, 0], [2, 0, 0], 0.0),
        ([1, 0, 0], [0, 5, 0], 90.0),
        ([1, 0, 0], [-1, 0, 0], 180.0),  # the sign counts
        ([1, 1, 0], [1, 0, 0], 45.0),
        ([1, 0, 0], [1, 1e-9, 0], math.degrees(1e-9)),  # no loss near zero, unlike acos
    ],
)
def test_angle_between_vectors(a, b, degrees):
    angle = metrics.angle_deg(np.array([a], float), np.array([b], float))
    assert angle[0] == pytest.approx(degrees, abs=1e-12)


def test_angle_to_a_zero_vector_is_undefined():
    assert np.isnan(metrics.angle_deg(np.zeros(3), np.array([1.0, 0, 0])))


def test_interval_of_a_normal_mean():
    """The textbook's +-1.96 standard errors."""
    values = np.random.default_rng(1).normal(10, 2, 400)
    low, high = bootstrap_interval(values, np.mean)
    error = 1.96 * values.std() / np.sqrt(len(values))
    assert low == pytest.approx(values.mean() - error, abs=0.03)
    assert high == pytest.approx(values.mean() + error, abs=0.03)


def _ratio(pairs, axis):
    total = pairs.sum(axis=axis)
    return total[..., 1] / total[..., 0]


def test_rows_are_resampled_whole():
    """The ratio of two columns that are proportional has no spread."""
    column = np.random.default_rng(2).uniform(1, 2, 50)
    rows = np.stack([column, 3 * column], axis=1)
    interval = bootstrap_interval(rows, _ratio)
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


def test_p_value_of_few_pairs_counts_all_signs():
    assert paired_p_value(np.array([1.0, 2.0, 3.0])) == 2 / 8  # +++ and ---
    assert paired_p_value(np.array([-1.0, 2.0, 3.0])) == 4 / 8  # also -++ and +--


def test_values_that_are_not_finite_give_neither_interval_nor_p_value():
    for bad in (np.nan, np.inf):
        values = np.append(np.arange(20.0), bad)
        assert np.isnan(bootstrap_interval(values, np.mean)).all()
        assert np.isnan(paired_p_value(values))


def test_same_values_have_the_same_interval_and_p_value():
    values = np.random.default_rng(5).normal(0.1, 1, 100)
    assert bootstrap_interval(values, np.median) == bootstrap_interval(values, np.median)
    assert paired_p_value(values) == paired_p_value(values)


def test_extreme_p_values():
    assert paired_p_value(np.zeros(20)) == 1.0
    assert paired_p_value(np.full(20, 0.5)) == pytest.approx(1 / 1001)
