"""Why windows are dropped: settings that are too slow, other processes, or a worker that hangs."""

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from pipeline_bench import PipelineBench

from emoflow_ros.node.reports import Level
from emoflow_ros.node.settings import Settings
from emoflow_ros.published.implicit_config import ImplicitConfig


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> PipelineBench:
    return PipelineBench(monkeypatch)


def test_worker_that_hangs_is_not_taken_for_a_slow_one(bench: PipelineBench) -> None:
    bench.calibrate()
    bench.supervisor.busy_s = 3.2
    bench.play(1000, 1031)
    hangs = (
        "the worker has been busy with one window for 3 s; it is replaced after 10 s "
        "(output.timeout_s)"
    )
    assert bench.said == [f"dropped: {hangs}"]
    report = bench.pipeline.report()
    assert (report.level, report.message) == (Level.WARN, hangs)
    bench.supervisor.busy_s = 0.01
    assert bench.pipeline.report().level is Level.OK


@pytest.mark.parametrize(
    ("processor_s", "line"),
    [
        (0.03, "other processes leave the estimation 30% of a core; end them, lower their prior"),
        (0.09, "the estimation is slower than the events; give a larger window.stride_ms, or a"),
        (0.15, "the estimation is slower than the events; give a larger window.stride_ms, or a"),
    ],
)
def test_load_of_the_machine_is_told_from_settings_that_are_too_slow(
    bench: PipelineBench, processor_s: float, line: str
) -> None:
    bench.calibrate()
    bench.play(1000, 1011)
    [job] = bench.supervisor.jobs()
    answer = replace(bench.answer(job), wall_s=0.1, processor_s=processor_s)
    bench.supervisor.outcomes.put(answer)
    report = bench.pipeline.report()
    assert report.values["processor_share"] == f"{10 * processor_s:.2f}"
    bench.play(1015, 1046)
    assert bench.said[-1].startswith(f"dropped: {line}")
    if processor_s < 0.05:  # a GPU lets the processor wait
        published = ImplicitConfig(device="cuda")
        config = replace(bench.settings.config, method="implicit", estimator=published)
        bench.pipeline.set_settings(Settings(bench.settings.node, config))
        bench.play(1050, 1061)
        assert bench.said[-1].startswith("dropped: the estimation is slower than the events;")
