"""Errors of one window, by hand."""

import numpy as np
import pytest

from emoflow_ros.core.estimate import Quality, Status
from emoflow_ros.offline.results import WindowResult
from emoflow_ros.offline.summary import summarise
from emoflow_ros.offline.truth import TrueTwist


def result(linear, true_linear, angular=(0.0, 0.2, 0.0), true_angular=(0.0, 0.1, 0.0), index=0):
    return WindowResult(
        index=index,
        t_start=0,
        t_end=100_000_000,
        events=10,
        status=Status.OK,
        model="full",
        linear=np.array(linear, float),
        angular=np.array(angular, float),
        sigma=np.full(6, np.nan),
        truth=TrueTwist(np.array(true_angular, float), np.array(true_linear, float)),
        flow=None,
        quality=Quality(events=10, runtime_s=0.02),
    )


def test_direction_keeps_its_sign():
    assert result([0, 0, 1], [0, 0, 3]).direction_error_deg == pytest.approx(0)
    assert result([0, 0, -1], [0, 0, 3]).direction_error_deg == pytest.approx(180)
    assert result([1, 0, 0], [0, 0, 3]).direction_error_deg == pytest.approx(90)


def test_slow_truth_has_no_direction():
    slow = result([0, 0, 1], [0, 0, 0.04], true_angular=(0, 0.05, 0))
    assert np.isnan(slow.direction_error_deg)
    assert np.isnan(slow.axis_error_deg)
    assert np.isnan(slow.rate_ratio)


def test_rates():
    w = result([0, 0, 1], [0, 0, 1])
    assert w.rate_ratio == pytest.approx(2.0)
    assert w.axis_error_deg == pytest.approx(0.0)
    np.testing.assert_allclose(w.angular_error, [0, 0.1, 0])


def test_oracles():
    wrong_way = result([0, 0, -1], [0, 0, 3])
    np.testing.assert_allclose(wrong_way.scaled_linear_error, [0, 0, -6])
    np.testing.assert_allclose(wrong_way.turned_linear_error, [0, 0, 0])
    sideways = result([0.6, 0, 0.8], [0, 0, 5])
    np.testing.assert_allclose(sideways.scaled_linear_error, [3, 0, -1])
    np.testing.assert_allclose(sideways.turned_linear_error, [3, 0, -1])


def test_summary_of_velocities():
    """RMS over windows and axes: errors of 6 m/s on one axis, and of (3, 0, -1) m/s."""
    windows = [result([0, 0, -1], [0, 0, 3]), result([0.6, 0, 0.8], [0, 0, 5], index=1)]
    measures = {m.key: m.value for m in summarise(windows)}
    assert measures["oracle_linear_rms_m_s"] == pytest.approx(np.sqrt((36 + 9 + 1) / 6))
    assert measures["oracle_sign_linear_rms_m_s"] == pytest.approx(np.sqrt((9 + 1) / 6))
    assert measures["angular_rms_deg_s"] == pytest.approx(np.degrees(np.sqrt(0.02 / 6)))
    expected = (180 + np.degrees(np.arccos(0.8))) / 2
    assert measures["direction_error_deg"] == pytest.approx(expected)
    assert measures["observable_percent"] == 100.0


def test_windows_without_a_direction_count_as_not_observable():
    windows = [result([np.nan] * 3, [0, 0, 3]), result([0, 0, 1], [0, 0, 3], index=1)]
    measures = {m.key: m for m in summarise(windows)}
    assert measures["observable_percent"].value == 50.0
    assert measures["direction_error_deg"].windows == 1
    assert measures["oracle_linear_rms_m_s"].windows == 1
