"""Errors of one window, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.types.estimate import Quality, Status
from emoflow_ros.evaluation.metrics import FlowErrors
from emoflow_ros.evaluation.summary import summarise, summarise_by_truth
from emoflow_ros.evaluation.window_results import WindowResult
from emoflow_ros.truth import TrueTwist, Truth


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
    np.testing.assert_allclose(wrong_way.borrowed_linear_error, [0, 0, 0])
    sideways = result([0.6, 0, 0.8], [0, 0, 5])
    np.testing.assert_allclose(sideways.scaled_linear_error, [3, 0, -1])
    np.testing.assert_allclose(sideways.borrowed_linear_error, [0, 0, -1])


def test_the_paper_borrows_the_sign_of_every_axis():
    """A direction that is 90 degrees off becomes a perfect one."""
    across = result([0.6, -0.8, 0], [3, 4, 0])
    assert across.direction_error_deg == pytest.approx(np.degrees(np.arccos(0.36 - 0.64)))
    np.testing.assert_allclose(across.scaled_linear_error, [0, -8, 0])
    np.testing.assert_allclose(across.borrowed_linear_error, [0, 0, 0], atol=1e-12)


def test_summary_of_velocities():
    """Errors of v: (0, 0, -6) and (3, 0, -1) m/s; of w: 0.1 and 0.3 rad/s on one axis."""
    windows = [
        result([0, 0, -1], [0, 0, 3]),
        result([0.6, 0, 0.8], [0, 0, 5], angular=(0, 0.4, 0), index=1),
    ]
    measures = {m.key: m.value for m in summarise(windows)}
    assert measures["oracle_linear_rms_m_s"] == pytest.approx(np.sqrt((36 + 9 + 1) / 6))
    assert measures["angular_rms_deg_s"] == pytest.approx(np.degrees(np.sqrt((0.01 + 0.09) / 6)))
    # The paper's: the root per window first, then the mean over windows; 0 and (0, 0, -1) m/s.
    assert measures["paper_linear_rms_m_s"] == pytest.approx((0 + np.sqrt(1 / 3)) / 2)
    expected = np.degrees((0.1 + 0.3) / np.sqrt(3) / 2)
    assert measures["paper_angular_rms_deg_s"] == pytest.approx(expected)
    expected = (180 + np.degrees(np.arccos(0.8))) / 2
    assert measures["direction_error_deg"] == pytest.approx(expected)
    assert measures["observable_percent"] == 100.0


class Source:
    """A name is all that a summary asks of a source."""

    def __init__(self, name):
        self.name = name


def test_velocities_against_every_truth():
    """The estimate is 0.1 rad/s off the first truth, and exactly what the second one says."""
    other = TrueTwist(np.array([0, 0.2, 0.0]), None)
    windows = [replace(result([0, 0, 1], [0, 0, 3]), other_truths=(other,)) for _ in range(3)]
    truth = Truth(Source("poses"), None, (Source("gyro"),))
    table = {
        name: {m.key: m.value for m in measures}
        for name, measures in summarise_by_truth(windows, truth).items()
    }
    assert table["poses"]["angular_rms_deg_s"] == pytest.approx(np.degrees(0.1 / np.sqrt(3)))
    assert table["gyro"]["angular_rms_deg_s"] == pytest.approx(0)
    assert table["gyro"]["truth_distance_deg_s"] == pytest.approx(np.degrees(0.1 / np.sqrt(3)))
    assert "direction_error_deg" not in table["gyro"]
    assert summarise_by_truth(windows, Truth(Source("poses"))) == {}


def flow(epe):
    return FlowErrors(epe, 0, 0, 10 * epe, 0, 5.0, 100)


def test_moving_objects_are_shown_where_there_are_any():
    """Windows 0 and 1 of three see one: EPE with its pixels 3 and 5 px, without them 1 and 2."""
    plain = result([0, 0, 1], [0, 0, 3])
    windows = [
        replace(plain, flow=flow(3), static_flow=flow(1)),
        replace(plain, flow=flow(5), static_flow=flow(2)),
        replace(plain, flow=flow(1)),
    ]
    measures = {m.key: m.value for m in summarise(windows)}
    assert measures["epe_px"] == pytest.approx(3)
    assert measures["moving_epe_px"] == pytest.approx(4)
    assert measures["static_epe_px"] == pytest.approx(1.5)
    assert measures["static_out_percent"] == pytest.approx(15)
    assert "static_epe_px" not in {m.key for m in summarise(windows[2:])}


def test_real_time_factor_counts_overlaps_once_and_gaps_not_at_all():
    """100 ms, 50 ms more, then 100 ms after a gap, in 20 ms of computing each."""
    spans = [(0, 100), (50, 150), (400, 500)]
    windows = [
        replace(result([0, 0, 1], [0, 0, 3]), t_start=a * 10**6, t_end=b * 10**6) for a, b in spans
    ]
    measures = {m.key: m for m in summarise(windows)}
    assert measures["real_time_factor"].value == pytest.approx(250 / 60)
    assert measures["real_time_factor"].low < 250 / 60 < measures["real_time_factor"].high


def test_windows_without_a_direction_count_as_not_observable():
    windows = [result([np.nan] * 3, [0, 0, 3]), result([0, 0, 1], [0, 0, 3], index=1)]
    measures = {m.key: m for m in summarise(windows)}
    assert measures["observable_percent"].value == 50.0
    assert measures["direction_error_deg"].windows == 1
    assert measures["oracle_linear_rms_m_s"].windows == 1
