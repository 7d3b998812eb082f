"""What becomes of windows between the event topic and the worker; the worker is a fake."""

import time
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from graph import DVS
from pipeline_bench import CAMERA, LEFT, MS, PipelineBench
from sensor_msgs.msg import CameraInfo

from emoflow_ros.core.geometry.calibration import camera_from_info
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.errors import InputError
from emoflow_ros.node.reports import Level
from emoflow_ros.node.tasks import Job, Loss, Progress
from emoflow_ros.node.topic_search import EventTopic

FINER = replace(CAMERA, fx=60.0)
SMALL = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)
RIGHT = EventTopic("/right/events", DVS)
MISSING = "no calibration yet: publish /left/camera_info or give camera.calibration_file"


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> PipelineBench:
    return PipelineBench(monkeypatch)


def stamps(jobs: list[Job]) -> list[int]:
    return [job.task.stamp // MS for job in jobs]


def test_windows_that_wait_in_vain_are_dropped_for_want_of_a_calibration(
    bench: PipelineBench,
) -> None:
    bench.play(1000, 1041)
    assert bench.said == [f"dropped: {MISSING}"] * 2
    report = bench.pipeline.report()
    assert (report.level, report.message) == (Level.ERROR, MISSING)
    assert report.values["windows_dropped"] == "2"
    bench.calibrate()
    assert stamps(bench.supervisor.jobs()) == [1025, 1035]


def test_bad_calibration_is_the_reason_that_windows_are_dropped(bench: PipelineBench) -> None:
    bench.pipeline.take_camera_info(CameraInfo(width=64, height=48))
    bench.play(1000, 1031)
    [said] = bench.said
    assert said.startswith("dropped: /left/camera_info: K is zero")


def test_windows_that_the_worker_has_no_time_for_are_dropped_for_that(bench: PipelineBench) -> None:
    bench.calibrate()
    bench.play(1000, 1031)
    assert len(bench.said) == 1
    assert bench.said[0].startswith("dropped: the estimation is slower than the events; give")
    bench.supervisor.obstacle = "the worker died (signal 9); it is started again"
    bench.play(1035, 1041)
    assert bench.said[1:] == ["dropped: the worker died (signal 9); it is started again"]
    report = bench.pipeline.report()
    assert report.message == "2 windows dropped: the worker died (signal 9); it is started again"


def test_start_of_the_worker_is_said_at_once_and_its_progress_as_it_comes(
    bench: PipelineBench,
) -> None:
    bench.pipeline.start()
    assert bench.node.log[-1] == ("info", "the worker is starting")
    bench.supervisor.outcomes.put(Progress("the estimator is compiled: 7 functions in 5 s"))
    bench.pipeline.take_outcomes()
    assert bench.node.log[-1] == ("info", "the estimator is compiled: 7 functions in 5 s")


def test_windows_carry_what_holds_when_they_are_handed_over(bench: PipelineBench) -> None:
    bench.calibrate()
    bench.play(1000, 1011)
    bench.calibrate(FINER)
    settings = bench.settings.changed({"estimator.min_events": 100})
    bench.pipeline.set_settings(settings)
    bench.node.publishers["flow/image"].subscribers = 1
    bench.play(1015, 1021)
    first, second = bench.supervisor.jobs()
    assert (first.camera, first.config) == (CAMERA, bench.settings.config)
    assert (second.camera, second.config) == (FINER, settings.config)
    assert (first.wishes.pictures, second.wishes.pictures) == ((), ("flow/image",))


def test_no_window_of_another_topic_is_estimated_with_the_camera_before(
    bench: PipelineBench,
) -> None:
    bench.calibrate()
    bench.play(1000, 1016)
    bench.pipeline.take_topic(RIGHT)
    bench.play(1000, 1016)
    assert bench.supervisor.jobs() == []  # neither the left one's nor, without a camera, its own
    bench.calibrate(FINER)
    [job] = bench.supervisor.jobs()
    assert job.camera == FINER


def test_results_of_a_topic_before_are_not_published(bench: PipelineBench) -> None:
    bench.calibrate()
    bench.play(1000, 1011)
    [job] = bench.supervisor.jobs()
    bench.pipeline.take_topic(RIGHT)
    bench.supervisor.outcomes.put(bench.answer(job))
    bench.supervisor.outcomes.put(Loss("gone", worker=True, task=job.task))
    bench.pipeline.take_outcomes()
    assert bench.said == []


def test_windows_of_another_sensor_are_forgotten_with_its_calibration(bench: PipelineBench) -> None:
    bench.play(1000, 1021, camera=SMALL)
    bench.calibrate()
    assert bench.supervisor.jobs() == []
    bench.play(1025, 1041)
    assert stamps(bench.supervisor.jobs()) == [1030]


def test_topic_counts_as_used_once_a_window_has_gone_to_the_worker(bench: PipelineBench) -> None:
    bench.play(1000, 1041)
    assert not bench.pipeline.is_topic_used
    bench.calibrate()
    assert bench.pipeline.is_topic_used
    bench.pipeline.take_topic(RIGHT)
    assert not bench.pipeline.is_topic_used


def test_error_in_the_node_is_logged_with_its_traceback(bench: PipelineBench) -> None:
    trace = "Traceback (most recent call last):\n  in _serve"
    bench.supervisor.outcomes.put(Loss("an error in the node", worker=True, trace=trace))
    bench.pipeline.take_outcomes()
    assert ("error", f"an error in the node\n{trace}") in bench.node.log
    assert bench.pipeline.report().level is Level.ERROR


def test_thread_that_has_ended_is_an_error_for_as_long_as_it_holds(bench: PipelineBench) -> None:
    bench.supervisor.has_ended = True
    for _ in range(2):
        report = bench.pipeline.report()
        assert report.level is Level.ERROR
        assert report.message.startswith("the thread that feeds the worker has ended")
    assert bench.node.log[-1][0] == "error"


def test_result_that_nobody_was_woken_for_is_published_with_the_next_report(
    bench: PipelineBench,
) -> None:
    bench.calibrate()
    bench.play(1000, 1011)
    [job] = bench.supervisor.jobs()
    bench.supervisor.outcomes.put(bench.answer(job))
    bench.pipeline.report()
    assert len(bench.node.messages("egomotion/twist")) == 1


def test_twists_may_be_as_far_apart_as_windows_are(
    bench: PipelineBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits: list[float] = []
    monkeypatch.setattr(
        bench.pipeline.statistics, "report", lambda *_, twist_s: limits.append(twist_s)
    )
    bench.pipeline.report()
    longer = {"window.duration_ms": 2000.0, "window.stride_ms": 1000.0}
    bench.pipeline.set_settings(bench.settings.changed(longer))
    bench.pipeline.report()
    assert limits == [1.0, 3.0]


def test_no_more_events_are_dropped_than_came(bench: PipelineBench) -> None:
    bench.pipeline.set_settings(bench.settings.changed({"window.stride_ms": 2.0}))
    bench.calibrate()
    bench.play(1000, 1101)
    values = bench.pipeline.report().values
    assert int(values["windows_dropped"]) > 40
    assert 15 < int(values["events_dropped"]) <= int(values["events"]) == 21


def test_node_that_nobody_activated_is_inactive_and_not_silent(bench: PipelineBench) -> None:
    bench.pipeline.set_settings(bench.settings.changed({"input.silence_s": 0.1}))
    bench.play(1000, 1021)
    bench.pipeline.statistics.clear_problem("input")  # as who listens does
    bench.pipeline.pause()
    bench.pipeline.statistics.clear_problem("camera")
    time.sleep(0.11)
    said = bench.pipeline.report()
    inactive = "inactive: nothing is listened to until the node is activated"
    assert (said.level, said.message) == (Level.OK, inactive)


def test_pause_forgets_what_waits_for_either(bench: PipelineBench) -> None:
    bench.play(1000, 1021)
    bench.pipeline.pause()
    bench.pipeline.take_topic(LEFT)
    bench.calibrate()
    assert bench.supervisor.jobs() == []
    bench.play(1025, 1046)
    bench.pipeline.pause()
    assert bench.supervisor.jobs() == []
    bench.made.close()
    assert bench.node.publishers == {}


def test_every_window_is_accounted_for_once(bench: PipelineBench) -> None:
    """Waiting, queued, in work or lost when an epoch ends, answered, lost, and dropped."""
    bench.play(1000, 1021)  # two windows wait for a calibration
    bench.play(500, 506)  # a jump
    bench.calibrate()
    bench.play(510, 521)  # two windows, of which one is answered after the next jump
    late, lost = bench.supervisor.jobs()
    bench.play(525, 541)  # two windows that are in the queue at the next jump
    bench.play(100, 151)  # a jump, and five windows, of which two may wait
    bench.supervisor.outcomes.put(bench.answer(late))
    bench.supervisor.outcomes.put(Loss("gone", worker=True, task=lost.task))
    answered, failed = bench.supervisor.jobs()
    bench.supervisor.outcomes.put(bench.answer(answered))
    bench.supervisor.outcomes.put(Loss("no luck", worker=False, task=failed.task))
    counts = bench.pipeline.report().values
    expected = {
        "windows": 11,
        "windows_forgotten": 6,
        "windows_dropped": 3,
        "windows_ok": 1,
        "windows_failed": 1,
    }
    assert {name: int(counts[name]) for name in expected} == expected
    assert len(bench.said) == 5  # all but those that were forgotten


def test_jump_in_the_middle_of_a_turn(bench: PipelineBench) -> None:
    """Windows from before it are forgotten, and of those behind it the newest ones wait."""
    bench.calibrate()
    bench.play(1000, 1021, pause=False)  # two windows
    bench.play(500, 541, pause=False)  # a jump, and four windows, of which two may wait
    bench.pipeline.cut_windows()
    assert [job.task.window.t_start // MS for job in bench.supervisor.jobs()] == [520, 530]
    counts = bench.pipeline.report().values
    expected = {"windows": 6, "windows_forgotten": 2, "windows_dropped": 2}
    assert {name: int(counts[name]) for name in expected} == expected
    assert len(bench.said) == 2


def test_window_in_work_at_the_pause_is_forgotten(bench: PipelineBench) -> None:
    bench.calibrate()
    bench.play(1000, 1011)
    [job] = bench.supervisor.jobs()
    bench.pipeline.pause()
    bench.supervisor.outcomes.put(bench.answer(job))
    counts = bench.pipeline.report().values
    assert (counts["windows"], counts["windows_forgotten"], counts["windows_ok"]) == ("1", "1", "0")


def test_camera_info_becomes_the_camera() -> None:
    info = CameraInfo(width=64, height=48, distortion_model="plumb_bob")
    info.k = [50.0, 0.0, 32.0, 0.0, 51.0, 24.0, 0.0, 0.0, 1.0]
    info.d = [0.1, 0.2, 0.0, 0.0, 0.0]
    camera = camera_from_info(info, "/left/camera_info", "camera.calibration_file")
    assert camera == Camera(64, 48, 50.0, 51.0, 32.0, 24.0, "plumb_bob", (0.1, 0.2, 0.0, 0.0, 0.0))


def test_a_lens_without_a_name_counts_and_is_said(bench: PipelineBench) -> None:
    info = CameraInfo(width=64, height=48, d=[0.1, 0.2, 0.0, 0.0, 0.3])
    info.k = [50.0, 0.0, 32.0, 0.0, 50.0, 24.0, 0.0, 0.0, 1.0]
    for _ in range(2):
        bench.pipeline.take_camera_info(info)
    bench.play(1000, 1011)
    [job] = bench.supervisor.jobs()
    assert (job.camera.model, job.camera.distortion) == ("plumb_bob", (0.1, 0.2, 0.0, 0.0, 0.3))
    said = [line for _, line in bench.node.log if "coefficients" in line]
    assert said == [
        "calibration: 64x48, plumb_bob (distortion_model is empty; its 5 coefficients are taken as "
        "plumb_bob)"
    ]


def test_uncalibrated_camera_info_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        camera_from_info(
            CameraInfo(width=64, height=48), "/left/camera_info", "camera.calibration_file"
        )
    assert str(caught.value) == (
        "/left/camera_info: K is zero: it is not calibrated; calibrate the camera, or give "
        "camera.calibration_file"
    )
