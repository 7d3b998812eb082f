from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.node.outputs import judge_dropped, judge_failed, judge_result
from emoflow_ros.node.reports import Level
from emoflow_ros.node.tasks import Result, Task

NS = 1_000_000_000


@pytest.fixture
def task() -> Task:
    events = Events(np.zeros(4, np.uint16), np.zeros(4, np.uint16), np.arange(4), np.ones(4, bool))
    return Task(Window(2 * NS, 3 * NS, events), 0, 100 * NS, "camera", 0.0)


def answer(task: Task, status: Status, model: MotionModel = MotionModel.FULL) -> Result:
    quality = Quality(
        events=3,
        iterations=17,
        stop_reason="converged",
        contrast_gain=1.25,
        residual_px=0.5,
        inlier_fraction=0.875,
        runtime_s=0.0304,
    )
    return Result(task, Estimate(2 * NS, 3 * NS, 2_750_000_000, status, quality, model))


def test_status_of_an_estimate_holds_its_quality_and_age(task: Task) -> None:
    report = judge_result(answer(task, Status.OK), now=103 * NS)
    assert (report.level, report.message) == (Level.OK, "ok")
    assert report.values == {
        "stamp": "102.750000000",
        "status": "ok",
        "events": "3",
        "lag_ms": "250.0",
        "model": "full",
        "translation_observable": "true",
        "flow": "true",
        "scale": "none",
        "gyro": "none",
        "contrast_gain": "1.250",
        "residual_px": "0.500",
        "inlier_fraction": "0.875",
        "iterations": "17",
        "stop_reason": "converged",
        "warm": "false",
        "runtime_ms": "30.4",
    }


def test_pure_rotation_is_named(task: Task) -> None:
    report = judge_result(answer(task, Status.OK, MotionModel.ROTATION), now=0)
    assert (report.level, report.message) == (Level.OK, "ok, translation not observable")
    assert report.values["translation_observable"] == "false"


@pytest.mark.parametrize(("reason", "level"), [
    (Status.NO_MOTION, Level.WARN), (Status.DIVERGED, Level.ERROR),
])  # fmt: skip
def test_a_twist_by_the_gyro_alone_says_what_the_events_gave(
    task: Task, reason: Status, level: Level
) -> None:
    result = answer(task, Status.OK, MotionModel.ROTATION)
    quality = replace(result.estimate.quality, stop_reason=str(reason))
    result = replace(result, estimate=replace(result.estimate, quality=quality), has_flow=False)
    report = judge_result(result, now=0)
    words = f"ok, translation not observable, by the gyro alone: {reason}"
    assert (report.level, report.message) == (level, words)
    assert report.values["status"] == "ok"
    lost = replace(result, estimate=replace(result.estimate, status=Status.DIVERGED))
    report = judge_result(lost, now=0)
    assert (report.level, report.message) == (Level.ERROR, "diverged")


def test_twist_that_is_not_what_was_asked_for_warns(task: Task) -> None:
    problems = ["nobody publishes /odom; linear is a unit direction", "no transform"]
    report = judge_result(answer(task, Status.OK), 0, "none", problems)
    assert (report.level, report.message) == (Level.WARN, "; ".join(["ok", *problems]))
    assert judge_result(answer(task, Status.DIVERGED), 0, "none", problems).level is Level.ERROR
    assert judge_result(answer(task, Status.OK), 0, "topic").values["scale"] == "topic"


@pytest.mark.parametrize(("status", "model", "words"), [
    (Status.STILL, MotionModel.STATIC, "still"),
    (Status.CARRIED, MotionModel.FULL, "carried, wide: no_motion"),
    (Status.CARRIED, MotionModel.ROTATION,
     "carried, translation not observable, wide: no_motion"),
    (Status.BOUNDED, MotionModel.STATIC, "bounded, translation not observable, wide: no_motion"),
    (Status.LOST, MotionModel.STATIC, "lost, wide: no_motion"),
])  # fmt: skip
def test_one_word_says_why_a_motion_is_wide_that_was_not_measured(
    task: Task, status: Status, model: MotionModel, words: str
) -> None:
    result = answer(task, status, model)
    quality = replace(result.estimate.quality, stop_reason="no_motion")
    result = replace(result, estimate=replace(result.estimate, quality=quality))
    assert judge_result(result, now=0).message == words


def test_a_fit_that_diverged_is_an_error_while_its_motion_is_carried_on(task: Task) -> None:
    result = answer(task, Status.CARRIED)
    quality = replace(result.estimate.quality, stop_reason="diverged")
    result = replace(result, estimate=replace(result.estimate, quality=quality))
    assert judge_result(result, now=0).level is Level.ERROR


@pytest.mark.parametrize(
    ("status", "level"),
    [
        (Status.OK, Level.OK),
        (Status.STILL, Level.OK),
        (Status.CARRIED, Level.WARN),
        (Status.BOUNDED, Level.WARN),
        (Status.LOST, Level.WARN),
        (Status.NO_MOTION, Level.WARN),
        (Status.TOO_FEW_EVENTS, Level.WARN),
        (Status.DIVERGED, Level.ERROR),
    ],
)
def test_level_follows_the_status(task: Task, status: Status, level: Level) -> None:
    report = judge_result(answer(task, status), now=0)
    assert report.level is level
    assert report.values["status"] == str(status)


def test_window_without_an_answer_has_the_stamp_of_its_middle(task: Task) -> None:
    failed = judge_failed(task, "the worker died (signal 9)", now=103 * NS)
    assert (failed.level, failed.message) == (Level.ERROR, "the worker died (signal 9)")
    assert failed.values == {
        "stamp": "102.500000000",
        "status": "failed",
        "events": "4",
        "lag_ms": "500.0",
    }
    dropped = judge_dropped(task, "no calibration yet", now=103 * NS)
    assert (dropped.level, dropped.values["status"]) == (Level.WARN, "dropped")
    assert dropped.message == "dropped: no calibration yet"
