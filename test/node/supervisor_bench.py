"""A supervisor in tests, with what came out of it."""

import time
from typing import Any

import numpy as np

from emoflow_ros.config import Config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.node.supervisor import Supervisor
from emoflow_ros.node.tasks import Job, Loss, Notice, Outcome, Progress, Result, Task, Wishes

CAMERA = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)
WAIT_S = 600.0  # only what hangs takes so long, also on a busy machine


def next_outcome(supervisor: Supervisor) -> Outcome:
    """Wait for the next one; what a worker says of its start is none."""
    while isinstance(outcome := supervisor.outcomes.get(timeout=WAIT_S), Progress):
        pass
    return outcome


class Bench:
    """A supervisor with its outcomes.

    Args:
        estimator: one of the fake estimators, or `module:function` that makes another.

    Attributes:
        camera, config, wishes: of the jobs that are put.
        wake: called by the supervisor.
    """

    def __init__(
        self, estimator: str, *, timeout_s: float = 10.0, may_use_cpu: bool = False
    ) -> None:
        self.camera = CAMERA
        self.config = Config()
        self.wishes = Wishes()
        self.wake = lambda: None
        self.supervisor = Supervisor(
            capacity=8,
            timeout_s=timeout_s,
            may_use_cpu=may_use_cpu,
            wake=lambda: self.wake(),
            factory=estimator if ":" in estimator else f"fake_estimators:{estimator}",
        )
        self.outcomes = self.supervisor.outcomes

    def progress(self) -> list[str]:
        """What has been said of the worker's start, if nothing else has come out yet."""
        lines = []
        while not self.outcomes.empty():
            outcome = self.outcomes.get()
            assert isinstance(outcome, Progress), outcome
            lines.append(outcome.line)
        return lines

    def put(self, *, x: int = 0, count: int = 5, t: int = 1000, epoch: int = 0) -> None:
        events = Events(
            np.full(count, x, np.uint16),
            np.zeros(count, np.uint16),
            np.arange(t, t + count, dtype=np.int64),
            np.ones(count, bool),
        )
        task = Task(Window(t, t + 100, events), epoch, 0, "camera", time.monotonic())
        self.supervisor.queue.put([Job(task, self.camera, self.config, self.wishes)])

    def put_slice(self, *, t_end: int) -> None:
        window = Window(0, t_end, Events.empty())
        self.supervisor.slices.put([Task(window, 0, 0, "camera", 0.0, is_slice=True)])

    def result(self) -> Result:
        outcome = next_outcome(self.supervisor)
        assert isinstance(outcome, Result), outcome
        return outcome

    def loss(self) -> Loss:
        outcome = next_outcome(self.supervisor)
        assert isinstance(outcome, Loss), outcome
        return outcome

    def notice(self) -> Notice:
        outcome = next_outcome(self.supervisor)
        assert isinstance(outcome, Notice), outcome
        return outcome


class Clumsy:
    """Fails a few times, as a full thread table or too little memory would let anything fail."""

    def __init__(self, error: Exception, times: int) -> None:
        self.error = error
        self.left = times

    def __call__(self, *args: Any) -> None:
        self.left -= 1
        if self.left >= 0:
            raise self.error
