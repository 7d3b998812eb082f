"""The real-time estimator's first window, where a memory expects a motion and a flow."""

from dataclasses import replace

import numpy as np
import pytest
from test_estimator import Run, endpoint_error, run_of, same

from emoflow_ros.core.types.events import Window
from emoflow_ros.core.types.expected import Expected


@pytest.fixture(scope="module")
def calm() -> Run:
    return run_of("calm")


def expecting(run: Run, window: Window, push: float = 0.0) -> Window:
    """The window with its true motion expected, and its true flow plus a push, px/s, along x."""
    t = (window.t_start + window.t_end) // 2
    linear, angular = run.recording.truth.twist(t)
    true = np.nan_to_num(run.recording.truth.flow(t)) + np.array([push, 0.0])

    def flow(points):
        x, y = np.round(points).astype(int).T
        return true[y, x].astype(np.float64)

    expected = Expected(flow, angular, linear / np.linalg.norm(linear))
    return replace(window, expected=expected)


def test_the_first_window_starts_from_what_is_expected(calm):
    cold, window = calm.estimates[0], calm.windows[0]
    found = calm.estimator().estimate(expecting(calm, window))
    assert found.quality.warm
    assert found.quality.iterations < cold.quality.iterations
    warm = replace(calm, windows=[window], estimates=[found])
    assert endpoint_error(warm, 0)[0] < 1.1 * endpoint_error(calm, 0)[0]


def test_it_starts_cold_where_something_else_is_seen(calm):
    window = expecting(calm, calm.windows[0], push=500.0)
    found, cold = calm.estimator().estimate(window), calm.estimates[0]
    assert not found.quality.warm
    assert found.angular.tolist() == cold.angular.tolist()
    t = cold.t
    assert np.array_equal(found.flow.velocity(t), cold.flow.velocity(t))


def test_what_is_expected_does_not_count_after_another_window(calm):
    estimator = calm.estimator()
    estimator.estimate(calm.windows[0])
    found = estimator.estimate(expecting(calm, calm.windows[1], push=300.0))
    assert same(found, calm.estimates[1])
