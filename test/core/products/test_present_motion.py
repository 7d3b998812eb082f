"""The latest twist on simulated recordings, whose motion is known at every instant."""

from dataclasses import replace

import numpy as np
import pytest
from present_runs import LATE_NS, SLICE_NS, Run, degrees, last, run

from emoflow_ros.core.geometry.camera_motion import SplineMotion
from emoflow_ros.core.products import present_motion
from emoflow_ros.core.products.present_scene import SeenScene
from emoflow_ros.core.products.settings import PRESENT
from emoflow_ros.core.stream.thinning import spread
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.core.types.twist import PresentTwist

STEP_NS = 20 * NS_PER_MS


def test_it_follows_a_motion_that_changes_where_the_last_window_does_not() -> None:
    its, present = run("agile"), run("agile").present()
    errors, held, squares = [], [], []
    for estimate in its.estimates[4:]:
        present.know(estimate)
        for k in range(3):
            t = estimate.t_end + LATE_NS + k * STEP_NS
            found = present.estimate(its.slice(t))
            if found is None:
                continue
            error = found.twist.angular - its.angular(t)
            errors.append(degrees(error))
            held.append(degrees(estimate.angular - its.angular(t)))
            squares.append(error @ np.linalg.solve(found.covariance[3:, 3:], error) / 3)
    assert len(errors) > 30
    assert np.sqrt(np.mean(np.square(errors))) < 0.5 * np.sqrt(np.mean(np.square(held)))
    assert 0.3 < np.mean(squares) < 3


def test_variance_grows_with_the_change_that_the_window_did_not_tell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As by a random walk that is as fast, besides what window and fit leave open."""
    its, estimate = last("agile")
    present = its.present()
    present.know(estimate)
    t = estimate.t_end + LATE_NS
    found = present.estimate(its.slice(t))
    assert found is not None and estimate.motion is not None and estimate.angular_walk
    angular, end = estimate.motion.angular, estimate.t_end - 5 * NS_PER_MS
    length = (estimate.t_end - estimate.t_start) / NS_PER_S
    slope, fades = (angular(estimate.t_end) - angular(estimate.t_start)) / length, min(0.06, length)
    told = angular(end) + slope * fades * (1 - np.exp(-(t - end) / (fades * NS_PER_S)))
    change = found.twist.angular - told
    rest = min(length, SLICE_NS / NS_PER_S) / 2
    seconds = (t - end) / NS_PER_S - rest
    drift = 8 * estimate.angular_walk
    square = change @ change / 3 * rest / seconds
    of_window, of_walk = estimate.covariance[3:, 3:], (square + 0.02 * drift * rest) * np.eye(3)
    of_fit = found.covariance[3:, 3:] - of_window - of_walk
    before = estimate.covariance[3:, 3:] + drift * seconds * np.eye(3)
    assert np.linalg.eigvalsh(of_fit).min() > 0
    assert np.linalg.eigvalsh(0.2 * before - of_fit).min() > 0  # the slice told something
    monkeypatch.setattr(present_motion, "PRESENT", replace(PRESENT, of_fit=2 * PRESENT.of_fit))
    twice = present.estimate(its.slice(t))
    assert twice is not None
    assert twice.covariance[3:, 3:] - found.covariance[3:, 3:] == pytest.approx(of_fit)
    assert square > np.radians(1) ** 2


def after_slices(estimates: list[Estimate], its: Run) -> PresentTwist:
    """The latest twist after the last of the windows, of which each had its slice."""
    present, found = its.present(), None
    for estimate in estimates:
        present.know(estimate)
        if estimate.told:
            found = present.estimate(its.slice(estimate.t_end + LATE_NS))
    assert found is not None
    return found


def test_the_same_windows_and_slices_give_the_same_bits() -> None:
    its, estimate = last("agile")
    first, second = (after_slices([its.estimates[5], estimate], its) for _ in range(2))
    np.testing.assert_array_equal(first.twist.angular, second.twist.angular)
    np.testing.assert_array_equal(first.covariance, second.covariance)


@pytest.mark.parametrize("status", [Status.LOST, Status.STILL])
def test_a_window_without_a_flow_makes_it_forget_the_slices_before(status: Status) -> None:
    its, estimate = last("agile")
    lost = replace(estimate, status=status, flow=None)
    alone = after_slices([estimate], its)
    forgot = after_slices([its.estimates[5], lost, estimate], its)
    kept = after_slices([its.estimates[5], estimate], its)
    np.testing.assert_array_equal(forgot.twist.angular, alone.twist.angular)
    np.testing.assert_array_equal(forgot.covariance, alone.covariance)
    assert degrees(kept.twist.angular - alone.twist.angular) > 0.01


def test_slices_one_after_another_tell_more_than_each_alone_where_windows_come_late() -> None:
    """60 slices a second, with each window's estimate 160 ms after its end."""
    its, late = run("agile"), 160 * NS_PER_MS
    first = its.estimates[4].t_end + late
    together, errors, alone = its.present(), [], []
    known = None
    for t in range(first, its.recording.t_end, NS_PER_S // 60):
        there = [e for e in its.estimates if e.t_end + late <= t][-1]
        if there is not known:
            together.know(there)
            known = there
        fresh = its.present()
        fresh.know(there)
        pair = [present.estimate(its.slice(t)) for present in (together, fresh)]
        assert pair[0] is not None and pair[1] is not None
        for found, list_ in zip(pair, (errors, alone), strict=True):
            list_.append(degrees(found.twist.angular - its.angular(t)))
    assert len(errors) > 30
    assert np.sqrt(np.mean(np.square(errors))) < 0.6 * np.sqrt(np.mean(np.square(alone)))


def test_of_a_slice_the_share_counts_that_no_other_has_seen() -> None:
    its, estimate = last("calm")
    present = its.present()
    present.know(estimate)
    scene, part = present._scene, its.slice(estimate.t_end + LATE_NS)
    assert scene is not None
    expected = scene.expected(part.t_end - SLICE_NS // 2, None)
    gained = []
    for share in (1.0, 0.25):
        shown = present._fit(expected, part, share)
        assert shown is not None
        gained.append(np.linalg.inv(shown.covariance) - np.linalg.inv(expected.covariance))
    np.testing.assert_allclose(gained[1], 0.25 * gained[0], rtol=1e-6, atol=1e-6 * gained[0].max())


def test_where_time_goes_back_a_slice_is_taken_for_itself() -> None:
    its, estimate = last("agile")
    earlier, later = (estimate.t_end + LATE_NS + k * STEP_NS for k in range(2))
    present, fresh = its.present(), its.present()
    for one in (present, fresh):
        one.know(estimate)
    present.estimate(its.slice(later))
    again, alone = present.estimate(its.slice(earlier)), fresh.estimate(its.slice(earlier))
    assert again is not None and alone is not None
    np.testing.assert_array_equal(again.twist.angular, alone.twist.angular)


def test_with_too_few_events_what_the_slice_before_has_shown_goes_on() -> None:
    its, estimate = last("agile")
    present = its.present()
    present.know(replace(estimate, bound=None))
    first = estimate.t_end + LATE_NS
    present.estimate(its.slice(first))
    shown, window = present._before, its.slice(first + STEP_NS)
    few = present.estimate(replace(window, events=spread(window.events, 250)))
    assert shown is not None and few is not None
    expected = shown.scene.motion + shown.carried_on(window.t_end).mean
    np.testing.assert_allclose(few.twist.angular, expected[:3])


def scene_of_a_turn(t: int, w: float) -> SeenScene:
    """A scene that a camera has shown which turns about x, and travels along z."""
    motion = np.array([w, 0, 0, 0, 0, 1.0])
    drift = np.repeat([0.5, 0.02], 3)
    return SeenScene(
        t, t + NS_PER_S, 100 * NS_PER_MS, motion, np.array([2.0, 0, 0]), 1e-4 * np.eye(6), drift,
        None, True, None,
    )  # fmt: skip


def test_what_slices_have_shown_goes_on_within_a_scene() -> None:
    scene, at = scene_of_a_turn(0, 0.1), 100 * NS_PER_MS
    anew = scene.expected(at, None)
    ahead = 2.0 * 0.06 * (1 - np.exp(-0.1 / 0.06))
    np.testing.assert_allclose(anew.mean, [ahead, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(np.diag(anew.covariance), [0.05] * 3 + [0.002, 0.002, 1.002])
    later = at + 20 * NS_PER_MS
    shown = replace(anew, mean=anew.mean + 0.3, covariance=1e-3 * np.eye(6))
    again = scene.expected(later, shown)
    more = 2.0 * 0.06 * (np.exp(-0.1 / 0.06) - np.exp(-0.12 / 0.06))
    np.testing.assert_allclose(again.mean - shown.mean, [more, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(again.covariance, 1e-3 * np.eye(6) + np.diag(0.02 * scene.drift))


def test_of_another_scene_w_is_held_against_what_slices_have_shown_before() -> None:
    """The mean of two, each by the inverse of its variance; v begins anew."""
    before, scene, at = scene_of_a_turn(0, 0.1), scene_of_a_turn(70 * NS_PER_MS, 0.2), 10**8
    shown = replace(
        before.expected(80 * NS_PER_MS, None), mean=np.full(6, 0.3), covariance=0.01 * np.eye(6)
    )
    found, anew = scene.expected(at, shown), scene.expected(at, None)
    of_slices = 0.01 + 2e-4 + 0.5 * 0.02  # its own, the two windows', the walk's
    of_window = 0.5 * 0.03
    weights = np.array([1 / of_slices, 1 / of_window])
    more = 2.0 * 0.06 * (np.exp(-0.08 / 0.06) - np.exp(-0.1 / 0.06))  # of its own window's change
    by_slices, by_window = 0.1 + 0.3 + more - 0.2, anew.mean[0]
    np.testing.assert_allclose(found.mean[0], weights @ [by_slices, by_window] / weights.sum())
    np.testing.assert_allclose(np.diag(found.covariance)[:3], 1 / weights.sum())
    np.testing.assert_array_equal(found.mean[3:], 0)
    np.testing.assert_array_equal(found.covariance[3:, 3:], anew.covariance[3:, 3:])


def test_direction_has_unit_length_and_no_variance_along_itself() -> None:
    its, estimate = last("calm")
    present = its.present()
    present.know(estimate)
    found = present.estimate(its.slice(estimate.t_end + LATE_NS))
    assert found is not None
    v = found.twist.linear
    assert np.linalg.norm(v) == pytest.approx(1.0)
    assert v @ estimate.linear > np.cos(np.radians(30))
    assert abs(v @ found.covariance[:3, :3] @ v) < 1e-9
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-9


def test_without_a_direction_of_travel_only_the_rotation_is_told() -> None:
    its, estimate = last("calm")
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[3:, 3:] = -1.0, estimate.covariance[3:, 3:]
    turning = replace(
        estimate, model=MotionModel.ROTATION, linear=np.zeros(3), covariance=covariance
    )
    present = its.present()
    present.know(turning)
    found = present.estimate(its.slice(estimate.t_end + LATE_NS))
    assert found is not None
    np.testing.assert_array_equal(found.twist.linear, np.zeros(3))
    assert found.covariance[0, 0] == -1.0
    np.testing.assert_array_equal(found.covariance[:3, 3:], np.zeros((3, 3)))


@pytest.mark.parametrize("status", [s for s in Status if not s.told])
def test_after_a_window_without_an_estimate_there_is_no_latest_twist(status: Status) -> None:
    its, estimate = last("calm")
    present = its.present()
    present.know(estimate)
    present.know(replace(estimate, status=status))
    assert present.estimate(its.slice(estimate.t_end + LATE_NS)) is None


def test_an_old_window_and_one_from_later_tell_nothing_of_now() -> None:
    its = run("agile")
    estimate = next(e for e in its.estimates if e.translation_observable)
    present = its.present()
    present.know(estimate)
    after_ms = [present.estimate(its.slice(estimate.t + ms * NS_PER_MS)) for ms in (0, 599, 601)]
    assert [found is not None for found in after_ms] == [False, True, False]


@pytest.mark.parametrize("walk", [0.05, None])
def test_where_few_events_come_the_motion_goes_on_as_a_random_walk(walk: float | None) -> None:
    """Eight times as fast as the windows have shown, or as the options say."""
    its, estimate = last("calm")
    assert estimate.angular_walk is not None
    present = its.present()
    present.know(replace(estimate, bound=None, angular_walk=walk))
    window = its.slice(estimate.t_end + LATE_NS)
    more, few = (replace(window, events=spread(window.events, n)) for n in (3_000, 250))
    fitted, carried = present.estimate(more), present.estimate(few)
    scene = present._scene
    assert fitted is not None and carried is not None and scene is not None
    expected = scene.motion[:3] + scene.predicted_change(window.t_end)
    np.testing.assert_allclose(carried.twist.angular, expected)
    per_s = 8 * walk if walk else np.radians(60.0) ** 2
    drift = per_s * (window.t_end - scene.t) / NS_PER_S
    grown = np.diag(carried.covariance - estimate.covariance)[3:]
    np.testing.assert_allclose(grown, drift, rtol=1e-9)
    assert np.trace(fitted.covariance[3:, 3:]) < np.trace(carried.covariance[3:, 3:])


def test_a_window_of_few_milliseconds_tells_of_its_middle_and_little_of_the_time_after_it() -> None:
    """Its motion is not asked for outside it, and its change does not go on for 60 ms."""
    its, estimate = last("calm")
    t_end, length = estimate.t_end, 4 * NS_PER_MS
    points = np.outer(np.arange(-1.0, 3.0), [0.08, 0.0, 0.0])  # w_x = 0.08 s
    motion = SplineMotion(t_end - length, t_end, points, np.tile(estimate.linear, (4, 1)))
    present = its.present()
    middle = t_end - length // 2
    present.know(replace(estimate, t_start=t_end - length, t=middle, motion=motion))
    scene = present._scene
    assert scene is not None and scene.t == middle
    np.testing.assert_allclose(scene.motion[:3], [0.04, 0, 0], atol=1e-9)
    np.testing.assert_allclose(scene.angular_acceleration, [20.0, 0, 0])
    after_1_ms, late = (scene.predicted_change(middle + ms * NS_PER_MS)[0] for ms in (1, 60))
    assert after_1_ms == pytest.approx(20 * 0.004 * (1 - np.exp(-1 / 4)))
    assert late == pytest.approx(20 * 0.004, rel=1e-6)
