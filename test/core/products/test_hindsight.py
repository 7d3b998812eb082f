"""The scale that the covariance of latest twists gets from the windows that come later."""

from dataclasses import replace

import numpy as np
import pytest
from present_runs import LATE_NS, last

from emoflow_ros.core.products.hindsight import Hindsight
from emoflow_ros.core.products.settings import PRESENT
from emoflow_ros.core.stream.thinning import spread
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import NS_PER_MS
from emoflow_ros.core.types.twist import PresentTwist, Twist

SD = 0.1  # of each axis of w, rad/s


def told(estimate: Estimate, off: float, t: int | None = None) -> PresentTwist:
    """A latest twist whose w is so many standard deviations off the window's in each axis."""
    assert estimate.motion is not None
    at = estimate.t if t is None else t
    within = min(max(at, estimate.t_start), estimate.t_end)
    angular = estimate.motion.angular(within) + off * SD
    covariance = np.diag(np.repeat([1.0, SD**2], 3))
    return PresentTwist(Twist(at, np.zeros(3), angular), covariance)


def scale(hindsight: Hindsight, estimate: Estimate) -> float:
    """Of a latest twist after the window."""
    found = hindsight.scaled(told(estimate, 0.0, estimate.t_end + 10**9)).covariance
    np.testing.assert_allclose(found[:3, :3], np.eye(3))
    np.testing.assert_allclose(found[3:, 3:], found[3, 3] * np.eye(3))
    return float(found[3, 3] / SD**2)


def test_without_a_window_the_covariance_is_as_told() -> None:
    assert scale(Hindsight(), last("calm")[1]) == 1.0


@pytest.mark.parametrize(
    ("off", "expected"),
    [
        (np.sqrt(0.5), 1.0),  # the usual surprise
        (2.0, 1 + 0.1 * (4.0 - 0.5) / 0.5),
        (100.0, 1 + 0.1 * (10.0 - 0.5) / 0.5),  # no surprise counts for more
        (0.0, 0.9),
    ],
)  # fmt: skip
def test_a_window_tells_how_wrong_the_twist_of_its_middle_was(off: float, expected: float) -> None:
    _, estimate = last("calm")
    hindsight = Hindsight()
    for t in (estimate.t - 30 * NS_PER_MS, estimate.t + 1, estimate.t + 30 * NS_PER_MS):
        hindsight.scaled(told(estimate, off if t == estimate.t + 1 else 50.0, t))
    hindsight.learn(estimate)
    assert scale(hindsight, estimate) == pytest.approx(expected)


def test_surprises_are_of_what_was_told_before_the_scale() -> None:
    _, estimate = last("calm")
    hindsight = Hindsight()
    for _ in range(100):
        hindsight.scaled(told(estimate, 2.0))
        hindsight.learn(estimate)
    assert scale(hindsight, estimate) == pytest.approx(8.0, rel=1e-3)
    for _ in range(100):
        hindsight.scaled(told(estimate, 0.0))
        hindsight.learn(estimate)
    assert scale(hindsight, estimate) == pytest.approx(PRESENT.least_scale)


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.OK])
def test_what_a_windows_events_did_not_tell_is_no_measure(status: Status) -> None:
    _, estimate = last("calm")
    hindsight = Hindsight()
    hindsight.scaled(told(estimate, 2.0))
    hindsight.learn(replace(estimate, status=status))
    assert scale(hindsight, estimate) == 1.0


def test_twists_of_other_times_are_no_measure() -> None:
    _, estimate = last("calm")
    hindsight = Hindsight()
    for t in (estimate.t_start - 1, estimate.t_end + 1):
        hindsight.scaled(told(estimate, 50.0, t))
    hindsight.learn(estimate)
    assert scale(hindsight, estimate) == 1.0


def test_what_is_not_finite_is_no_measure() -> None:
    _, estimate = last("calm")
    hindsight = Hindsight()
    hindsight.scaled(told(estimate, np.nan))
    hindsight.learn(estimate)
    assert scale(hindsight, estimate) == 1.0


def test_twists_are_kept_until_no_window_can_come_and_forgotten_where_time_goes_back() -> None:
    _, estimate = last("calm")
    for t in (estimate.t + PRESENT.longest_ns + 1, estimate.t - 1):
        hindsight = Hindsight()
        hindsight.scaled(told(estimate, 50.0))
        hindsight.scaled(told(estimate, 0.0, t))
        assert [x.twist.t for x in hindsight._told] == [t]
    hindsight = Hindsight()
    for t in (estimate.t, estimate.t + PRESENT.longest_ns):
        hindsight.scaled(told(estimate, 0.0, t))
    assert len(hindsight._told) == 2


def test_later_windows_tell_how_sure_fits_are() -> None:
    """Where too few events come for a fit, nothing is learnt of it, and nothing is scaled."""
    its, estimate = last("agile")
    before = its.estimates[its.estimates.index(estimate) - 1]
    for events, is_fit in ((3_000, True), (250, False)):
        present, fresh = its.present(), its.present()
        present.know(replace(before, bound=None))
        window = its.slice(estimate.t)
        present.estimate(replace(window, events=spread(window.events, events)))
        for one in (present, fresh):
            one.know(replace(estimate, bound=None))
        scale = max(PRESENT.least_scale, present._hindsight._surprise / PRESENT.usual_surprise)
        assert (scale != 1.0) is is_fit
        present._before = None  # as for the fresh one
        window = its.slice(estimate.t_end + LATE_NS)
        window = replace(window, events=spread(window.events, events))
        scaled, plain = present.estimate(window), fresh.estimate(window)
        assert scaled is not None and plain is not None
        np.testing.assert_array_equal(scaled.twist.angular, plain.twist.angular)
        np.testing.assert_allclose(
            scaled.covariance[3:, 3:], scale * plain.covariance[3:, 3:], rtol=1e-9
        )
