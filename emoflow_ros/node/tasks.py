"""What goes to the worker and what comes back, as the rest of the node knows it."""

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.windows import Window


@dataclass(frozen=True)
class Task:
    """A window on its way through the worker.

    Attributes:
        window: what to estimate.
        epoch: which run of event time it belongs to; a jump back starts the next one.
        time_offset: ROS time minus event time, ns.
        frame_id: the camera's optical frame.
        received: monotonic time in s at which the window was complete.
    """

    window: Window
    epoch: int
    time_offset: int
    frame_id: str
    received: float

    @property
    def stamp(self) -> int:
        """ROS time of the window's middle, ns."""
        return (self.window.t_start + self.window.t_end) // 2 + self.time_offset


@dataclass(frozen=True)
class Result:
    """A task's answer: the estimate without its samplers, and the flow if it was asked for.

    Attributes:
        task: what was asked.
        estimate: `flow` and `motion` are None.
        flow: (height, width, 2) px/s at the estimate's time `t`, NaN = none.
    """

    task: Task
    estimate: Estimate
    flow: NDArray[Any] | None

    @property
    def stamp(self) -> int:
        """ROS time that the estimate's values hold at, ns."""
        return self.estimate.t + self.task.time_offset


@dataclass(frozen=True)
class Loss:
    """A window that has no result, and maybe its worker with it.

    Attributes:
        reason: one line.
        worker: whether the worker was lost and is started again.
        task: the window; None when the worker was lost between two windows.
    """

    reason: str
    worker: bool
    task: Task | None = field(default=None, compare=False)


type Outcome = Result | Loss
