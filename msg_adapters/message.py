"""What every decoder takes, returns, counts and raises."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from emoflow_ros.core.events import Events

type Bytes = bytes | bytearray | memoryview | NDArray[np.uint8]

_COORDINATES = types.Array(types.uint16, 1, "C", readonly=True)


class EventMessage(NamedTuple):
    """The events of one message, in the order of the message.

    Attributes:
        events: the events inside the sensor; their times are the message's own (sensor time
            where the driver sends that), in ns.
        width, height: the sensor's size in pixels as the message gives it; 0 where it gives
            none, and then no event counts as outside.
        stamp: the header's stamp, ns.
        frame_id: the header's frame.
        seq: the packet's running number, where the type has one.
        dropped_outside: events outside the sensor's geometry, which are not in `events`.
    """

    events: Events
    width: int
    height: int
    stamp: int
    frame_id: str
    seq: int | None
    dropped_outside: int


@dataclass(slots=True)
class Statistics:
    """What a decoder has seen since it was made; `reset()` keeps it.

    Attributes:
        messages, events: decoded so far.
        dropped_outside: events outside the sensor's geometry.
        seq_gaps: messages missing by their running numbers.
        time_wraps: roll-overs of the sensor's clock.
        triggers: external trigger events, which are skipped.
        skipped: events before time or row was known, and words that mean nothing.
        encoding: of the last message, where the type has several; empty otherwise.
    """

    messages: int = 0
    events: int = 0
    dropped_outside: int = 0
    seq_gaps: int = 0
    time_wraps: int = 0
    triggers: int = 0
    skipped: int = 0
    encoding: str = ""


class Decoder(Protocol):
    """Decodes the messages of one topic in order; several topics need several decoders."""

    statistics: Statistics

    def decode(self, data: Bytes) -> EventMessage:
        """Decode one serialised message. `data` may be reused by the caller afterwards.

        Raises:
            DecodeError: the bytes are not a message of this type. The decoder stays usable.
        """
        ...

    def reset(self) -> None:
        """Forget the state carried between messages, for example on a jump in time."""
        ...


def build_message(
    header: tuple[int, str],
    width: int,
    height: int,
    events: Events,
    statistics: Statistics,
    *,
    seq: int | None = None,
    dropped: int = 0,
) -> EventMessage:
    """Drop and count the events outside width x height (0: unknown), and add up statistics.

    `dropped` events of the message have been left out as outside before.
    """
    count = len(events)
    # Two maxima cost less than a mask; the mask is for the rare stream that needs it.
    if width and height and _any_outside(events.x, events.y, width, height):
        events = events[events.inside(width, height)]
        dropped += count - len(events)
        count = len(events)
    statistics.messages += 1
    statistics.events += count
    statistics.dropped_outside += dropped
    return EventMessage(events, width, height, *header, seq, dropped)


@njit(types.boolean(_COORDINATES, _COORDINATES, types.int64, types.int64), cache=True, nogil=True)
def _any_outside(x, y, width, height):  # type: ignore[no-untyped-def]
    """Whether any of the coordinates x, y (N,) uint16 lies outside width x height pixels."""
    x_max = y_max = np.uint16(0)
    for i in range(len(x)):
        x_max = max(x_max, x[i])
        y_max = max(y_max, y[i])
    return x_max >= width or y_max >= height
