"""From serialised event messages to windows and slices; unusable messages are left out here."""

import time
from collections.abc import Callable
from copy import copy, deepcopy
from dataclasses import replace

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.stream.bounded_windows import RateLimitedSlicer
from emoflow_ros.core.stream.clock import ClockMap, Timestamps
from emoflow_ros.core.stream.event_order import EventOrder, sifted
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.node.backlog import LeftOut, is_jump
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.jump_doubt import Believed, JumpDoubt
from emoflow_ros.node.tasks import Task
from msg_adapters import DecodeError, EventMessage, make_decoder

# A million events as EventArray; a larger message is taken for a malformed one.
_MAX_BYTES = 16 * 2**20
# Messages between two ends of windows are cut together, up to so many events: each cut takes as
# long as decoding some messages.
_MOST_TAKEN = 50_000
_NEAR_NS = NS_PER_S  # events behind a wrong stamp that are further on are of another time, too


class EventInput:
    """Decodes the messages of one topic and cuts their events into tasks for the worker.

    Give `take` each message, and call `cut` before other work: nothing waits here meanwhile.

    Args:
        ros_type: as in `dvs_msgs/msg/EventArray`.
        budget: how windows are cut, and how many events the stream may have per time.
        slices: the same of slices of the newest events; None cuts none.
        timestamps: which time the output is stamped with.
        frame_id: the camera's frame; empty takes that of the messages.
        statistics: counts what comes and what is lost.
        warn: says what is wrong with the messages; called for each of them.
        epoch: number of the first run of event time.

    Attributes:
        epoch: number of the run of event time; a jump, as in a bag that loops, starts the next.
        jump: what started the epoch, in words.

    Raises:
        DecodeError: there is no decoder for the type.
    """

    def __init__(
        self,
        ros_type: str,
        budget: EventBudget,
        slices: EventBudget | None = None,
        *,
        timestamps: Timestamps,
        frame_id: str,
        statistics: Statistics,
        warn: Callable[[str], None],
        epoch: int = 0,
    ) -> None:
        self._camera: Camera | None = None
        self._size: tuple[int, int] | None = None  # of the messages, while there is no camera
        self.epoch = epoch
        self.jump = ""
        self._stamp: int | None = None
        self._order = EventOrder()
        self._decoder = make_decoder(ros_type, "cdr")
        self._slicer = RateLimitedSlicer(budget)
        self._slices = RateLimitedSlicer(slices) if slices else None
        self._own_frame_id, self._frame_id = frame_id, ""
        self._statistics = statistics
        self._warn = warn
        self._clock = ClockMap(timestamps)
        self._doubt = JumpDoubt()
        self._taken: list[Events] = []  # not cut yet
        self._tasks: list[list[Task]] = []  # since the last call of `cut`

    @property
    def camera(self) -> Camera | None:
        """The camera of the events; None while it is unknown."""
        return self._camera

    @camera.setter
    def camera(self, camera: Camera | None) -> None:
        if camera and self.size not in (None, camera.size):
            self._reset_slicers()  # no window holds the events of two sensors
        self._camera = camera

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height in px, of the camera or of the first message; None before both."""
        return self._camera.size if self._camera else self._size

    @property
    def encoding(self) -> str:
        """Encoding of the last message, as EventPacket names it; empty for types with only one."""
        return self._decoder.statistics.encoding

    def set_budget(self, budget: EventBudget) -> None:
        """Cut and thin later events by this one; another policy leaves an unfinished window out."""
        if budget.policy == self._slicer.policy:
            self._slicer.budget = budget
        else:
            self._slicer = RateLimitedSlicer(budget)

    def take(self, data: bytes, part: int = 1) -> None:
        """Take one serialised message.

        Args:
            data: the message.
            part: n takes the first n-th of its events; each stands for n.
        """
        for believed in self._doubt.judge(data, part, self._stamp, self._is_readable):
            if believed.jump:
                self._start_epoch(believed.jump)
            self._take(believed)

    def _take(self, believed: Believed) -> None:
        data, part = believed.data, believed.part
        before = None if believed.is_stamp_right else deepcopy(self._decoder)
        message = self._decode(data, part)
        step = 0
        if message is not None and self._stamp is not None:
            step = self._order.step_to(message.events)
        if before is not None and not 0 <= step < _NEAR_NS:
            self._decoder = before  # its time is counted on from messages before it
            self._leave_out("it is of another time than those around it")
            return
        # A step back that the stamps do not show is a wrap of the sensor's time.
        if step > 0 and is_jump(step):
            self._start_epoch(step)
            message = self._decode(data, part)  # again: it was counted on from before the jump
        if message is None:
            return
        if believed.is_stamp_right:
            self._stamp = message.stamp
        else:
            self._statistics.counts["wrong_stamps"] += 1
            self._warn("the stamp of a message is not used: it is far from those around it")
        self._statistics.counts["seq_gaps"] = self._decoder.statistics.seq_gaps
        events = self._in_order(self._inside(message))
        self._statistics.add_events(len(events))
        if not len(events):
            return
        if part > 1:
            events = replace(events, stands_for=np.full(len(events), part, np.uint32))
        if believed.is_stamp_right:
            self._clock.observe(int(events.t[0]), message.stamp)
        self._statistics.clock_drift_ppm = self._clock.drift_ppm
        self._statistics.event_delay_s = self._clock.delay_ns / NS_PER_S
        self._frame_id = message.frame_id
        self._taken.append(events)
        end = self._slicer.next_end
        is_complete = end is None or int(events.t[-1]) >= end
        if is_complete or sum(map(len, self._taken)) >= _MOST_TAKEN:
            self._cut()

    def cut(self) -> list[list[Task]]:
        """Return the windows and slices that the messages taken since the last call complete.

        All are of the present epoch. Tasks that one message completes stand together.
        """
        self._cut()
        tasks, self._tasks = self._tasks, []
        return tasks

    def skip(self, left_out: LeftOut) -> None:
        """Go on behind messages that are left out: no window and no slice reaches over them.

        The epoch and the clock map stay unless time jumped meanwhile.
        """
        if self._doubt.forget():
            left_out = replace(left_out, count=left_out.count + 1)
            self._statistics.counts["messages_skipped"] += 1
        if left_out.jump:
            self._start_epoch(left_out.jump)
        else:
            self._decoder.resync(left_out.count)
            self._reset_slicers()

    def _is_readable(self, data: bytes) -> bool:
        try:
            return len(data) <= _MAX_BYTES and bool(deepcopy(self._decoder).decode(data, 1))
        except DecodeError:
            return False

    def _decode(self, data: bytes, part: int) -> EventMessage | None:
        try:
            if len(data) > _MAX_BYTES:
                raise DecodeError(f"{len(data)} bytes, more than {_MAX_BYTES}")
            return self._decoder.decode(data, part)
        except DecodeError as error:
            self._statistics.add_malformed()
            self._warn(f"a malformed message is left out: {error}")
            return None

    def _start_epoch(self, step: int) -> None:
        """Start the next epoch after a step of time (ns): forget what was before it."""
        self._cut()
        forgotten = sum(not task.is_slice for tasks in self._tasks for task in tasks)
        self._statistics.counts["windows_forgotten"] += forgotten
        self._tasks.clear()
        self.epoch += 1
        way = "back" if step < 0 else "forward"
        self.jump = f"event time went {way} by {abs(step) / NS_PER_S:.3f} s"
        self._statistics.counts["time_jumps"] += 1
        self._stamp = None
        self._order.reset()
        self._size = None  # another recording may be that of another sensor
        self._clock.reset()
        self._decoder.reset()
        self._reset_slicers()

    def _reset_slicers(self) -> None:
        self._taken.clear()
        self._slicer.reset()
        if self._slices:
            self._slices.reset()

    def _inside(self, message: EventMessage) -> Events:
        """Return the message's events that lie on the sensor."""
        self._statistics.counts["events_outside"] += message.dropped_outside
        size = (message.width, message.height)
        if message.width and self._camera is None and self._size is None:
            self._size = size
        if message.width and size != self.size:
            self._statistics.counts["wrong_size_messages"] += 1
            self._warn(self._misfit(message))
            return Events.empty()
        if message.width or self._camera is None:
            return message.events
        inside = message.events.inside(*self._camera.size)
        self._statistics.counts["events_outside"] += len(inside) - int(inside.sum())
        return message.events[inside]

    def _misfit(self, message: EventMessage) -> str:
        assert self.size is not None
        events = f"events of a {message.width}x{message.height} sensor"
        size = f"{self.size[0]}x{self.size[1]}"
        if self._camera is None:
            return (
                f"{events} are left out: those before were of a {size} one; "
                "publish one sensor's events on a topic"
            )
        return (
            f"{events} do not fit the calibration of a {size} one; give this sensor's calibration"
        )

    def _in_order(self, events: Events) -> Events:
        """Return the events that are in order; where time goes back for good, they start an epoch.

        So does a whole message that is too early by a jump: windows cannot wait for the next one. A
        message in which time jumps forward is left out whole.
        """
        before, order = self._order.left_out, copy(self._order)
        kept, step = sifted(order, events)
        if is_jump(step):
            self._start_epoch(step)
            order = copy(self._order)
            kept, step = sifted(order, events)
        if is_jump(step) or (len(kept) and is_jump(int(kept.t[-1] - kept.t[0]))):
            self._leave_out("event times jump within it")
            return Events.empty()
        self._order = order
        if left_out := order.left_out - before:
            self._statistics.counts["events_unordered"] += left_out
            self._warn(f"{left_out} events out of order are left out")
        return kept

    def _cut(self) -> None:
        """Make tasks of what the last one of the taken messages completes: windows and a slice."""
        if not self._taken:
            return
        events = Events.concatenate(self._taken)
        self._taken.clear()
        received = time.monotonic()
        before = self._slicer.left_out
        windows = self._slicer.push(events)
        slices = self._slices.push(events) if self._slices else []
        self._statistics.counts["events_thinned"] += self._slicer.left_out - before
        self._statistics.counts["windows"] += len(windows)
        frame_id = self._own_frame_id or self._frame_id
        middles = [((w.t_start + w.t_end) // 2, w, False) for w in windows]
        ends = [(w.t_end, w, True) for w in slices[-1:]]
        tasks = [
            Task(w, self.epoch, self._clock.offset(t), frame_id, received, is_slice)
            for t, w, is_slice in middles + ends
        ]
        if tasks:
            self._tasks.append(tasks)

    def _leave_out(self, reason: str) -> None:
        self._statistics.counts["unordered_messages"] += 1
        self._warn(f"a message is left out: {reason}")
