"""What goes to the worker and what comes back: tasks, their outcomes, the queue of tasks."""

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from numpy.typing import NDArray

from emoflow_ros.config import Config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S, Window
from emoflow_ros.core.types.twist import PresentTwist
from emoflow_ros.node.event_share import share_of

type Arrays = dict[str, NDArray[Any]]


class Picture(StrEnum):
    """A picture of a window, by its topic."""

    FLOW = "flow/image"
    COLOR = "flow/color"
    EVENTS = "flow/iwe"
    TRACKS = "flow/tracks"


@dataclass(frozen=True)
class Task:
    """A window on its way through the node, or a slice of the newest events.

    Attributes:
        window: what to estimate.
        epoch: which run of event time it belongs to; a jump back starts the next one.
        time_offset: ROS time minus event time, ns.
        frame_id: the camera's optical frame.
        received: monotonic time in s at which the window was complete.
        is_slice: whether only the motion at its end is wanted (core.products.present_motion).
    """

    window: Window
    epoch: int
    time_offset: int
    frame_id: str
    received: float
    is_slice: bool = False

    @property
    def stamp(self) -> int:
        """ROS time of the window's middle, ns."""
        return self.to_ros((self.window.t_start + self.window.t_end) // 2)

    def to_ros(self, t: int) -> int:
        """Map an event time of the window to ROS time, ns."""
        return t + self.time_offset


@dataclass(frozen=True)
class Wishes:
    """What a result is to hold besides the estimate.

    Attributes:
        pictures: those of `Picture` that somebody subscribes to.
        flow_color_max: flow in full colour, px/s; 0 takes the picture's 99th percentile.
        flow_stride: 2 keeps every second pixel and row of the flow's picture, 1 all.
        tracks: number of points that the picture of tracks follows.
    """

    pictures: tuple[str, ...] = ()
    flow_color_max: float = 0.0
    flow_stride: int = 1
    tracks: int = 1


@dataclass(frozen=True)
class Job:
    """A task with all that the worker needs for it, as it was when the task was handed over.

    `part` is that of `EventShare`.
    """

    task: Task
    camera: Camera
    config: Config
    wishes: Wishes = field(default_factory=Wishes)
    part: int = 1

    @property
    def interval_s(self) -> float:
        """Event time from this window to the next one, s."""
        policy, window = self.config.window, self.task.window
        length = window.t_end - window.t_start if policy.count else policy.stride_ns
        return length / NS_PER_S

    def thinned(self) -> "Job":
        """Return it with no more events in its window than the estimator may use."""
        budget = share_of(self.config.event_budget, self.part)
        return replace(self, task=replace(self.task, window=budget.bound(self.task.window)))


@dataclass(frozen=True)
class Result:
    """The answer to a task: the estimate without its samplers, and what was wished for.

    Attributes:
        task: what was asked.
        estimate: `flow` and `motion` are None.
        pictures: those wished for, by name; none unless the status is OK and there is a flow.
        has_flow: whether there is one.
        camera: whose window it was; None if that is not known.
        left_out: how many pictures that were wished for are not drawn, for want of time.
        wall_s, processor_s: what the estimate took, and what of that all threads of the worker ran.
    """

    task: Task
    estimate: Estimate
    pictures: Arrays = field(default_factory=dict)
    has_flow: bool = True
    camera: Camera | None = None
    left_out: int = 0
    wall_s: float = 0.0
    processor_s: float = 0.0

    @property
    def stamp(self) -> int:
        """ROS time that the estimate's values hold at, ns."""
        return self.task.to_ros(self.estimate.t)


@dataclass(frozen=True)
class Present:
    """The answer to a slice.

    Attributes:
        task: what was asked.
        found: the motion at the slice's end.
    """

    task: Task
    found: PresentTwist


@dataclass(frozen=True)
class Loss:
    """A window without a result, or a worker that was lost, or both.

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


@dataclass(frozen=True)
class Progress:
    """How far the worker is with its start; one line."""

    line: str


type Outcome = Result | Present | Loss | Notice | Progress


class DropOldestQueue[T]:
    """Hand items from one thread to another without ever blocking the one that puts.

    Args:
        capacity: items kept; one more drops the oldest. Items that come together are all kept.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, items: Sequence[T]) -> list[T]:
        """Append items; return, and count as `dropped`, those that had to make room."""
        with self._changed:
            self._items.extend(items)
            excess = len(self._items) - max(self._capacity, len(items))
            oldest = [self._items.popleft() for _ in range(excess)]
            self.dropped += len(oldest)
            self._changed.notify()
        return oldest

    def get(self, timeout: float) -> T | None:
        """Remove the oldest item, or return None when none came within `timeout` seconds."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._items, timeout):
                return None
            return self._items.popleft()

    def clear(self) -> int:
        """Forget all items, which do not count as dropped, and return how many they were."""
        with self._changed:
            count = len(self._items)
            self._items.clear()
        return count
