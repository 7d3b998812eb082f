"""EventArray messages of ROS 1 whose definition is another than today's.

The first drivers had other fields, in another order. A bag carries the definition of its messages:
what it says is decoded, as long as all members of an event are of a fixed size.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import Events
from msg_adapters.message import (
    NS_PER_S,
    Bytes,
    Cursor,
    DecodeError,
    EventMessage,
    Statistics,
    build_message,
    first_part,
)

HEADER, EVENTS, TEXT = "header", "events", "text"  # members of a message that are no numbers
SECONDS, NANOSECONDS = "seconds", "nanoseconds"  # a time of ROS among an event's members

_TIMES = ("ts", "time", "t", "timestamp", "stamp")
_POLARITIES = ("polarity", "pol", "p")
_LEAST_NS = 10**17  # integers below are microseconds


@dataclass(frozen=True)
class ArrayLayout:
    """The members of a message in their order, and those of an event.

    Attributes:
        members: (name, kind); a kind is the code of a number (`<u4`), HEADER, EVENTS or TEXT.
        event: (name, code) of an event's members, packed; the polarity is ON where positive. The
            time is SECONDS and NANOSECONDS, or a number: seconds if floating-point, else
            microseconds, or nanoseconds from 1e17 on.

    Raises:
        DecodeError: an event lacks column, row, time or polarity, or a message its events.
    """

    members: tuple[tuple[str, str], ...]
    event: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        names = {name for name, _ in self.event}
        lacking = [name for name in ("x", "y") if name not in names]
        lacking += [] if self.time or SECONDS in names else ["time"]
        lacking += [] if self.polarity else ["polarity"]
        lacking += [] if EVENTS in [kind for _, kind in self.members] else ["events"]
        if lacking:
            raise DecodeError(f"its definition has no {' and no '.join(lacking)}")

    @property
    def time(self) -> str:
        """Name of the member that is a time in one number; empty where there is none."""
        return next((name for name, _ in self.event if name in _TIMES), "")

    @property
    def polarity(self) -> str:
        """Name of the member that is the polarity; empty where there is none."""
        return next((name for name, _ in self.event if name in _POLARITIES), "")


class DefinedArrayDecoder:
    """Decode messages of one layout; carries no state between messages."""

    def __init__(self, layout: ArrayLayout) -> None:
        self.statistics = Statistics()
        self._layout = layout
        self._event = np.dtype(list(layout.event))

    def decode(self, data: Bytes, part: int = 1) -> EventMessage:
        """Decode one message; see Decoder."""
        cursor = Cursor(data, "ros1")
        found: dict[str, Any] = {}
        header, events = (0, ""), Events.empty()
        for name, kind in self._layout.members:
            if kind == HEADER:
                header = cursor.header()
            elif kind == EVENTS:
                events = self._events(cursor)
            elif kind == TEXT:
                cursor.string()
            else:
                number = np.dtype(kind)
                found[name] = np.frombuffer(cursor.take(number.itemsize), number)[0]
        cursor.finish()
        if header == (0, "") and len(events):  # the first messages had none
            header = int(events.t[0]), ""
        width, height = (max(0, int(found.get(name, 0))) for name in ("width", "height"))
        return build_message(header, width, height, first_part(events, part), self.statistics)

    def resync(self, left_out: int) -> None:
        """Do nothing: there is no state."""

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def _events(self, cursor: Cursor) -> Events:
        (count,) = cursor.integers("I")
        if count * self._event.itemsize > cursor.remaining:
            raise DecodeError(f"{count} events announced in {cursor.remaining} bytes")
        rows = np.frombuffer(cursor.take(count * self._event.itemsize), self._event)
        x, y = (_coordinates(rows[name]) for name in ("x", "y"))
        return Events(x, y, self._times(rows), rows[self._layout.polarity] > 0)

    def _times(self, rows: NDArray[np.void]) -> NDArray[np.int64]:
        if not self._layout.time:
            return rows[SECONDS].astype(np.int64) * NS_PER_S + rows[NANOSECONDS]
        t = rows[self._layout.time]
        if t.dtype.kind == "f":
            with np.errstate(all="ignore"):
                ns = np.rint(t.astype(np.float64) * NS_PER_S)
            if not (np.abs(ns) < 1 << 62).all():
                raise DecodeError("event times that are not finite")
            return ns.astype(np.int64)
        unit = 1 if len(t) and t.max() >= _LEAST_NS else 1000
        return t.astype(np.int64) * unit


def _coordinates(values: NDArray[Any]) -> NDArray[np.uint16]:
    """Convert to the type of `Events`; what does not fit becomes its largest value."""
    largest = np.iinfo(np.uint16).max
    fits = (values >= 0) & (values < largest)
    return np.where(fits, values, largest).astype(np.uint16)
