"""Slices of the newest events on their way through the pipeline."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from pipeline_bench import MS, PipelineBench

from emoflow_ros.core.types.twist import PresentTwist, Twist
from emoflow_ros.node.tasks import Present


def test_slices_go_beside_windows_and_their_twists_are_of_this_epoch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = PipelineBench(monkeypatch, twist_rate=100.0)
    bench.play(1000, 1100)
    assert bench.supervisor.slices.get(0.0) is None  # there is no calibration
    bench.calibrate()
    bench.play(1100, 1151)
    [_, *jobs] = bench.supervisor.jobs()
    assert not any(job.task.is_slice for job in jobs)
    task = bench.supervisor.slices.get(0.0)
    assert task is not None and task.is_slice
    assert (task.window.t_start, task.window.t_end) == (1090 * MS, 1150 * MS)
    assert len(task.window.events) == 12
    twist = Twist(task.window.t_end, np.zeros(3), np.ones(3))
    for epoch in (task.epoch, task.epoch - 1):
        present = Present(replace(task, epoch=epoch), PresentTwist(twist, np.eye(6)))
        bench.supervisor.outcomes.put(present)
    bench.pipeline.take_outcomes()
    [message] = bench.node.messages("egomotion/twist")
    assert message.header.stamp.nanosec == 150 * MS
    assert bench.pipeline.statistics.counts["windows_forgotten"] == 0
    assert bench.pipeline.statistics.counts["twists_now"] == 1
