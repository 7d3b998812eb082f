import os
from collections.abc import Callable

import numpy as np
import pytest
from fake_clock import Clock
from statistics_bench import make_result, some_events

from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import Window
from emoflow_ros.node.diagnostics import Statistics, resident_mb
from emoflow_ros.node.reports import Level
from emoflow_ros.node.tasks import Loss, Result, Task


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def result() -> Callable[..., Result]:
    return make_result


def test_rates_hold_since_the_last_report(clock: Clock, result: Callable[..., Result]) -> None:
    statistics = Statistics(clock)
    statistics.report(2.0)
    for _ in range(4):
        clock.now += 0.5
        statistics.add_events(1000)
        statistics.add_result(result(clock.now - 0.1))
        statistics.stream.give()
    report = statistics.report(2.0)
    assert report.values["events_per_s"] == "2000"
    assert report.values["windows_per_s"] == "2.00"
    assert report.values["events"] == "4000"
    assert (report.level, report.message) == (Level.OK, "running")
    clock.now += 1.0
    assert statistics.report(2.0).values["events_per_s"] == "0"


def test_latency_percentiles(clock: Clock, result: Callable[..., Result]) -> None:
    statistics = Statistics(clock)
    for milliseconds in range(1, 101):
        statistics.add_result(result(clock.now - milliseconds / 1e3))
    values = statistics.report(2.0).values
    expected = np.percentile(np.arange(1, 101), [50, 95])
    assert float(values["latency_p50_ms"]) == pytest.approx(expected[0], abs=0.06)
    assert float(values["latency_p95_ms"]) == pytest.approx(expected[1], abs=0.06)
    assert (values["iterations"], values["stop_reason"]) == ("17", "converged")


def test_windows_are_counted_by_status(clock: Clock, result: Callable[..., Result]) -> None:
    statistics = Statistics(clock)
    for status in (Status.OK, Status.OK, Status.NO_MOTION):
        statistics.add_result(result(clock.now, status))
    values = statistics.report(2.0).values
    assert (values["windows_ok"], values["windows_no_motion"]) == ("2", "1")
    # A twist by the gyro alone counts as what the events gave.
    statistics.add_result(result(clock.now, Status.OK, "no_motion"))
    values = statistics.report(2.0).values
    assert (values["windows_ok"], values["windows_no_motion"]) == ("2", "2")


def test_silence_warns_until_events_come(clock: Clock) -> None:
    statistics = Statistics(clock)
    clock.now += 2.5
    report = statistics.report(2.0)
    assert report.level is Level.WARN
    assert report.message == "no events for 2.5 s: check the driver or the bag"
    statistics.add_events(1)
    assert statistics.report(2.0).level is Level.OK


def test_loss_warns_once(clock: Clock) -> None:
    statistics = Statistics(clock)
    events = some_events(12)
    for first, reason in ((0, "the worker is starting"), (4, "too slow"), (8, "too slow")):
        window = Window(first, first + 4, events[first : first + 4])
        statistics.add_dropped(Task(window, 0, 0, "", 0.0), reason)
    report = statistics.report(2.0)
    assert report.level is Level.WARN
    assert report.message == "3 windows dropped: too slow"
    assert (report.values["windows_dropped"], report.values["events_dropped"]) == ("3", "12")
    assert statistics.report(2.0).level is Level.OK


def test_error_in_the_node_is_an_error_and_counted(clock: Clock) -> None:
    statistics = Statistics(clock)
    statistics.add_loss(Loss("an error in the node (MemoryError)", worker=True, trace="Traceback"))
    report = statistics.report(2.0)
    assert report.level is Level.ERROR
    assert report.message == (
        "1 errors in the node, their tracebacks are in the log: an error in the node (MemoryError)"
    )
    assert (report.values["internal_errors"], report.values["worker_restarts"]) == ("1", "1")


def test_what_costs_estimates_is_said_before_what_costs_none(clock: Clock) -> None:
    statistics = Statistics(clock)
    statistics.set_problem("device", Level.WARN, "estimating on the CPU")
    statistics.add_dropped(Task(Window(0, 1, some_events(4)), 0, 0, "", 0.0), "too slow")
    assert statistics.report(2.0).message == "1 windows dropped: too slow"
    assert statistics.report(2.0).message == "estimating on the CPU"
    statistics.counts["malformed_messages"] += 1
    statistics.set_problem("frame", Level.WARN, "no transform")
    assert statistics.report(2.0).message == "no transform"
    statistics.set_problem("camera", Level.ERROR, "no calibration")
    assert statistics.report(2.0).message == "no calibration"


def test_messages_that_were_left_out_are_said_before_the_windows_that_were(clock: Clock) -> None:
    statistics = Statistics(clock)
    statistics.add_dropped(Task(Window(0, 1, some_events(4)), 0, 0, "", 0.0), "too slow")
    statistics.counts["messages_skipped"] += 44
    report = statistics.report(2.0)
    assert (report.level, report.values["messages_skipped"]) == (Level.WARN, "44")
    assert report.message == (
        "44 messages left out: events come faster than the node decodes them; lower their rate, "
        "or give the node more of the processor"
    )
    assert statistics.report(2.0).message == "running"


def test_events_of_dropped_windows_count_once(clock: Clock) -> None:
    """Windows that overlap, a gap, and the same times again after a jump back."""
    statistics = Statistics(clock)
    events = some_events(100)
    for first, last, epoch in ((0, 40, 0), (20, 60, 0), (80, 100, 0), (0, 40, 1)):
        window = Window(first, last, events[first:last])
        statistics.add_dropped(Task(window, epoch, 0, "", 0.0), "too slow")
    values = statistics.report(2.0).values
    assert (values["windows_dropped"], values["events_dropped"]) == ("4", "120")


def test_lost_worker_warns_with_the_reason(clock: Clock) -> None:
    statistics = Statistics(clock)
    task = Task(Window(0, 1, some_events(4)), 0, 0, "", 0.0)
    statistics.add_loss(Loss("the worker died (signal 9)", worker=True))
    statistics.add_loss(Loss("the worker hung", worker=True, task=task))
    report = statistics.report(2.0)
    assert report.level is Level.WARN
    assert report.message == "2 worker restarts: the worker hung"
    assert (report.values["worker_restarts"], report.values["windows_failed"]) == ("2", "1")


def test_everything_that_is_promised_is_reported_from_the_start(
    clock: Clock, result: Callable[..., Result]
) -> None:
    statistics = Statistics(clock)
    statistics.add_result(result(clock.now))
    values = statistics.report(2.0, worker=os.getpid()).values
    promised = {
        "events_per_s", "windows_per_s", "latency_p50_ms", "latency_p95_ms", "windows_dropped",
        "events_dropped", "seq_gaps", "clock_drift_ppm", "iterations", "stop_reason",
        "messages_skipped", "worker_restarts", "memory_mb", "worker_memory_mb",
        "malformed_messages", "time_jumps",
    }  # fmt: skip
    assert promised <= set(values)
    assert float(values["memory_mb"]) == pytest.approx(float(values["worker_memory_mb"]), abs=2)
    assert float(values["memory_mb"]) > 10


def test_memory_of_a_process_that_is_gone_is_zero() -> None:
    assert resident_mb(2**22 + 1) == 0.0


def test_worst_problem_is_reported_until_cleared(clock: Clock) -> None:
    statistics = Statistics(clock)
    statistics.set_problem("input", Level.WARN, "waiting")
    statistics.set_problem("camera", Level.ERROR, "no calibration")
    assert statistics.report(2.0).message == "no calibration"
    statistics.clear_problem("camera")
    assert statistics.report(2.0).message == "waiting"
    statistics.clear_problem("input")
    assert statistics.report(2.0).level is Level.OK


def test_slices_that_fail_are_a_warning(clock: Clock) -> None:
    statistics = Statistics(clock)
    statistics.add_events(1)
    statistics.add_loss(Loss("a slice failed: ValueError: no tracks", worker=False))
    report = statistics.report(2.0)
    assert report.level is Level.WARN
    assert report.message == (
        "1 slices failed, so latest twists are missing: a slice failed: ValueError: no tracks"
    )
    assert report.values["windows_failed"] == "0"
