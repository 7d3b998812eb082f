"""What goes to the worker and what comes back, as the rest of the node knows it."""

from dataclasses import dataclass, field

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.twist import Twist
from emoflow_ros.core.windows import Window
from emoflow_ros.node.channel import Arrays


@dataclass(frozen=True)
class Task:
    """A window on its way through the node.

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
        return self.to_ros((self.window.t_start + self.window.t_end) // 2)

    def to_ros(self, t: int) -> int:
        """Map an event time of the window to ROS time, ns."""
        return t + self.time_offset


@dataclass(frozen=True)
class Wishes:
    """What results hold besides the estimate.

    Attributes:
        pictures: those of `pictures.Picture` that somebody subscribes to.
        flow_color_max: flow in full colour, px/s; 0 takes the picture's 99th percentile.
        flow_stride: of the flow's picture every so many-th pixel and row.
        tracks: points that the tracks among the pictures follow.
        twist_rate: twists per second of event time; 0: one per window.
    """

    pictures: tuple[str, ...] = ()
    flow_color_max: float = 0.0
    flow_stride: int = 1
    tracks: int = 1
    twist_rate: float = 0.0


@dataclass(frozen=True)
class Job:
    """A task with all that the worker needs for it, as it was when the task was handed over."""

    task: Task
    camera: Camera
    config: Config
    wishes: Wishes = field(default_factory=Wishes)


@dataclass(frozen=True)
class Result:
    """A task's answer: the estimate without its samplers, and what was wished for.

    Attributes:
        task: what was asked.
        estimate: `flow` and `motion` are None.
        twists: those wished for, in order of time; none unless the status is OK.
        pictures: those wished for, by name; none unless the status is OK.
    """

    task: Task
    estimate: Estimate
    twists: tuple[Twist, ...] = ()
    pictures: Arrays = field(default_factory=dict)

    @property
    def stamp(self) -> int:
        """ROS time that the estimate's values hold at, ns."""
        return self.task.to_ros(self.estimate.t)


@dataclass(frozen=True)
class Loss:
    """A window that has no result, and maybe its worker with it.

    Attributes:
        reason: one line.
        worker: whether the worker was lost and is started again.
        task: the window; None when the worker was lost between two windows.
        trace: the traceback of an error in the node itself; empty for all others.
    """

    reason: str
    worker: bool
    task: Task | None = field(default=None, compare=False)
    trace: str = ""


@dataclass(frozen=True)
class Notice:
    """Something about the worker that lasts until the node is configured anew; one line."""

    reason: str


type Outcome = Result | Loss | Notice
