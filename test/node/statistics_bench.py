"""Statistics in tests: events, and results of windows by their status."""

import numpy as np

from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.node.tasks import Result, Task


def some_events(count: int) -> Events:
    zeros = np.zeros(count, np.uint16)
    return Events(zeros, zeros, np.arange(count, dtype=np.int64), zeros.astype(bool))


def make_result(
    received: float, status: Status = Status.OK, stop_reason: str = "converged"
) -> Result:
    task = Task(Window(0, 1, Events.empty()), 0, 0, "", received)
    quality = Quality(events=1, iterations=17, stop_reason=stop_reason)
    return Result(task, Estimate(0, 1, 0, status, quality))
