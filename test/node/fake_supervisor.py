"""A supervisor without a worker, which keeps the jobs that it is given."""

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

import pytest

from emoflow_ros.node import pipeline
from emoflow_ros.node.tasks import DropOldestQueue, Job, Outcome, Task


class FakeSupervisor:
    """It does what a test says.

    Attributes:
        running: whether it has been started, and not been stopped.
    """

    def __init__(self, *, capacity: int, wake: Callable[[], None], **kwargs: Any) -> None:
        self.queue: DropOldestQueue[Job] = DropOldestQueue(capacity)
        self.slices: DropOldestQueue[Task] = DropOldestQueue(1)
        self.outcomes: SimpleQueue[Outcome] = SimpleQueue()
        self.ready = threading.Event()
        self.obstacle = ""
        self.has_ended = False
        self.busy_s = 0.0
        self.pid = None
        self.running = False

    def check(self, config: Any) -> None:
        self.running = True

    def start(self) -> None:
        self.running = True

    def stop(self) -> None:
        self.running = False

    def jobs(self) -> list[Job]:
        found = []
        while job := self.queue.get(0.0):
            found.append(job)
        return found


def install_fake_supervisor(monkeypatch: pytest.MonkeyPatch) -> list[FakeSupervisor]:
    """Let pipelines use it; return the list that those that are made come into."""
    made: list[FakeSupervisor] = []

    def make(**kwargs: Any) -> FakeSupervisor:
        made.append(FakeSupervisor(**kwargs))
        return made[-1]

    monkeypatch.setattr(pipeline, "Supervisor", make)
    return made
