"""What is said while functions are compiled."""

from multiprocessing import get_context
from types import SimpleNamespace
from typing import Any

import pytest
from fake_clock import Clock

from emoflow_ros.node.channel import Channel
from emoflow_ros.node.compilation import Compilation
from emoflow_ros.node.worker_process import WorkerProcess


def test_progress_is_said_at_once_and_every_five_seconds() -> None:
    lines: list[str] = []
    clock = Clock()
    begun: list[int] = []
    compilation = Compilation(lines.append, lambda: begun.append(len(lines)), clock)
    event: Any = SimpleNamespace()
    for _ in range(6):
        compilation.on_start(event)
        assert len(lines) == 1 + int(clock.now - 100.0) // 6
        clock.now += 3.0
        compilation.on_end(event)
    assert begun == [1]
    assert lines[0].startswith("the estimator is compiled, as at the first start on a machine")
    assert lines[1:] == [
        f"the estimator is compiled: {n} functions in {3 * n} s" for n in (2, 4, 6)
    ]


def test_nothing_is_said_where_nothing_is_compiled() -> None:
    lines: list[str] = []
    Compilation(lines.append).end()
    assert lines == []


def test_worker_that_goes_on_compiling_has_the_whole_time_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A slow machine compiles for longer than a worker may be silent."""
    limits: list[float | None] = []
    answers = iter([{"progress": "7 functions"}, {"progress": "9 functions"}, {"compiled": True}])

    def receive(channel: Channel, timeout_s: float | None = None) -> Any:
        limits.append(timeout_s)
        return next(answers), {}

    monkeypatch.setattr(Channel, "send", lambda *_: None)
    monkeypatch.setattr(Channel, "receive", receive)
    worker = WorkerProcess(get_context("forkserver"), "fake_estimators:Recorder", 1.0)
    lines: list[str] = []
    try:
        assert worker.request({}, {}, 120.0, lines.append) == ({"compiled": True}, {})
    finally:
        worker.end()
    assert lines == ["7 functions", "9 functions"]
    assert limits == [120.0] * 3
