"""What comes in and goes out: why there are no events to use, and why no twist."""

from collections.abc import Callable

import pytest
from fake_clock import Clock
from statistics_bench import make_result, some_events

from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import Window
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.reports import Level
from emoflow_ros.node.tasks import Loss, Result, Task


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def result() -> Callable[..., Result]:
    return make_result


@pytest.mark.parametrize(
    ("count", "reason"),
    [
        ("wrong_size_messages", "messages of another sensor size: give this sensor's calibration"),
        ("unordered_messages", "messages in which event time jumps: check the driver"),
        ("events_unordered", "events out of order: check the driver"),
        ("events_outside", "events outside the calibration's image"),
    ],
)
def test_messages_that_are_all_left_out_are_no_silence(
    clock: Clock, count: str, reason: str
) -> None:
    statistics = Statistics(clock)
    statistics.add_events(5)
    for _ in range(250):  # at 100 Hz
        clock.now += 0.01
        statistics.counts[count] += 1
        statistics.add_events(0)
    report = statistics.report(2.0)
    assert report.level is Level.ERROR
    assert report.message.startswith(f"nothing to use for 2.5 s: 250 {reason}")


def test_messages_that_cannot_be_read_are_no_silence(clock: Clock) -> None:
    statistics = Statistics(clock)
    for _ in range(250):
        clock.now += 0.01
        statistics.add_malformed()
    report = statistics.report(2.0)
    assert report.level is Level.ERROR
    assert "250 malformed messages: check the driver's message version" in report.message


def test_empty_messages_are_not_the_driver_s_silence(clock: Clock) -> None:
    statistics = Statistics(clock)
    for _ in range(250):
        clock.now += 0.01
        statistics.add_events(0)
    report = statistics.report(2.0)
    assert (report.level, report.message) == (
        Level.WARN,
        "messages without events for 2.5 s: check the camera",
    )


def play(statistics: Statistics, clock: Clock, seconds: float, *windows: Result) -> None:
    """Let events come at 100 Hz for so long; the windows come with the last of them."""
    for _ in range(round(100 * seconds)):
        clock.now += 0.01
        statistics.add_events(5)
    for window in windows:
        statistics.add_result(window)


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (Status.NO_MOTION, "show no motion: the camera is at rest, or the image moves too little"),
        (Status.TOO_FEW_EVENTS, "hold too few events: the camera is at rest, or estimator.min_e"),
        (
            Status.LOST,
            "are lost, half a second after the last measurement (converged): show the ca",
        ),
        (Status.DIVERGED, "diverged: check the calibration, or give longer windows"),
    ],
)
def test_no_twist_while_events_come_warns_with_the_reason_of_most_windows(
    clock: Clock, result: Callable[..., Result], status: Status, words: str
) -> None:
    statistics = Statistics(clock)
    other = Status.DIVERGED if status is Status.NO_MOTION else Status.NO_MOTION
    for _ in range(2):  # reports every 0.6 s: the windows of both count
        windows = [result(clock.now, s) for s in (status, other, status)]
        play(statistics, clock, 0.6, *windows)
        report = statistics.report(2.0)
    assert report.level is Level.WARN
    assert report.message.startswith(f"no twist for 1.2 s: 4 of 6 windows {words}")


def test_twists_that_are_published_are_no_reason_to_warn(
    clock: Clock, result: Callable[..., Result]
) -> None:
    statistics = Statistics(clock)
    for _ in range(10):
        play(statistics, clock, 0.9, *[result(clock.now, Status.NO_MOTION)] * 3, result(clock.now))
        statistics.stream.give()
        report = statistics.report(2.0)
        assert (report.level, report.message) == (Level.OK, "running; 3 of 4 windows: no motion")
    play(statistics, clock, 1.1, result(clock.now, Status.NO_MOTION))
    assert statistics.report(2.0).message.startswith("no twist for 1.1 s: 1 of 1 windows show no")


def test_a_camera_that_was_never_seen_to_move_is_no_reason_to_warn_but_named(
    clock: Clock, result: Callable[..., Result]
) -> None:
    statistics = Statistics(clock)
    play(statistics, clock, 1.1, result(clock.now, Status.BOUNDED, "no_motion"))
    statistics.stream.give()
    report = statistics.report(2.0)
    expected = "running; 1 of 1 windows: bounded (no motion)"
    assert (report.level, report.message) == (Level.OK, expected)


def test_windows_that_are_dropped_or_fail_are_reasons_for_no_twist(clock: Clock) -> None:
    statistics = Statistics(clock)
    task = Task(Window(0, 1, some_events(4)), 0, 0, "", 0.0)
    statistics.add_dropped(task, "too slow")
    statistics.report(2.0)
    play(statistics, clock, 1.5)
    said = statistics.report(2.0).message
    assert said == "no twist for 1.5 s: 1 of 1 windows were dropped: too slow"
    for _ in range(2):
        statistics.add_loss(Loss("no luck", worker=False, task=task))
    statistics.report(2.0)
    play(statistics, clock, 0.5)
    said = statistics.report(2.0).message
    assert said == "no twist for 2.0 s: 2 of 3 windows failed: no luck"


def test_windows_that_never_end_are_said(clock: Clock) -> None:
    statistics = Statistics(clock)
    play(statistics, clock, 4.0)
    assert statistics.report(2.0, twist_s=5.0).level is Level.OK  # long ones are wanted
    report = statistics.report(2.0)
    assert (report.level, report.message) == (
        Level.WARN,
        "no twist for 4.0 s: no window is complete: window.count or window.duration_ms is too "
        "large for the events",
    )


def test_time_without_a_twist_counts_from_when_events_flow(clock: Clock) -> None:
    statistics = Statistics(clock)
    play(statistics, clock, 0.9)
    clock.now += 1.5  # a pause
    report = statistics.report(2.0)
    assert (report.level, report.message) == (Level.OK, "running; no events for 1.5 s")
    play(statistics, clock, 0.9)
    assert statistics.report(2.0).message == "running"
    play(statistics, clock, 0.2)
    assert statistics.report(2.0).message.startswith("no twist for 1.1 s: ")


def test_silence_counts_from_when_the_node_listens(clock: Clock) -> None:
    """Not from when it was configured, before there was any driver."""
    statistics = Statistics(clock)
    clock.now += 60.0
    statistics.stream.listen()
    clock.now += 2.5
    assert statistics.report(2.0).message.startswith("no events for 2.5 s: ")
    for _ in range(250):
        statistics.counts["wrong_size_messages"] += 1
        statistics.add_events(0)
        clock.now += 0.01
    assert statistics.report(2.0).message.startswith("nothing to use for 2.5 s: 250 messages of a")


def test_reason_of_messages_without_events_outlives_the_report_that_counted_them(
    clock: Clock,
) -> None:
    statistics = Statistics(clock)
    for _ in range(250):
        statistics.counts["wrong_size_messages"] += 1
        statistics.add_events(0)
        clock.now += 0.01
        statistics.report(2.0)
    clock.now += 1.5  # the replay has ended
    report = statistics.report(2.0)
    assert report.level is Level.ERROR
    assert report.message.startswith("nothing to use for 4.0 s: 250 messages of another sensor")
    clock.now += 1.0
    assert statistics.report(2.0).message.startswith("no events for 2.5 s: ")
