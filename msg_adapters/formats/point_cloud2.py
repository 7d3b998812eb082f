"""sensor_msgs/PointCloud2 whose points are events.

Fields are found by name, in any order and numeric type: x, y, one of t, ts, time, timestamp,
t_s, t_us, t_ns, and one of p, polarity, pol (ON where positive). Others are ignored. The cloud's
width and height describe the cloud, not the sensor: the sensor's size stays unknown.
PointCloud2 declares neither the unit nor the origin of the times, so both are inferred.

Unit: the field's suffix (`t_s`, `t_us`, `t_ns`) if it has one. Otherwise the magnitude of epoch
times decides (from 1e17: ns, from 1e14: us); else floats are seconds, unless a message of at least
100 events would last more than one, and is one of 1e4 to 1e8 events per second in us or ms.
Integers have 32 bits at most: they are us or ns, whichever agrees with the header's stamp; else us
if they count from far before the message (ns would wrap every 4.3 s); else the span of the message
decides.

Origin: absolute if nearer to the header's stamp than to zero, or more than 1 s from zero (a
sensor's own clock); else relative to the header's stamp.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_MS, Events
from msg_adapters.message import (
    NS_PER_S,
    Bytes,
    Cursor,
    DecodeError,
    EventMessage,
    Serialization,
    Statistics,
    build_message,
    first_part,
)

type PointType = np.dtype[np.void]

TYPES = ("sensor_msgs/msg/PointCloud2",)

_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_TIME_NAMES = ("t", "ts", "time", "timestamp", "t_s", "t_us", "t_ns")
_POLARITY_NAMES = ("p", "polarity", "pol")
_COORDINATE_LIMIT = 1 << 16
_MAX_POINT_STEP = 1 << 16
_MIN_FIELD_SIZE = 13  # bytes of an unnamed PointField, at least
_UNITS_NS = {"_s": NS_PER_S, "_us": 1_000, "_ns": 1}
_EPOCH_NS, _EPOCH_US = 1e17, 1e14
_NEAR_NS = 2 * NS_PER_S
_LONGEST_RELATIVE_NS = NS_PER_S
# Messages of event cameras last 0.25 ms to 250 ms: a span above this is ns, below it us.
_SPAN_BETWEEN_US_AND_NS = 250_000
_ENOUGH = 100  # events of a message to tell a rate by
_USUAL_RATE = (1e4, 1e8)  # events per second, as in readers/time_units.py
_MAX_NS = 2.0**62  # leaves room for the stamp to be added


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    offset: int
    datatype: int


class _CloudTime:
    """Converts one topic's time field to ns; keeps unit and origin once they are certain."""

    def __init__(self) -> None:
        self._meaning: tuple[int, bool] | None = None

    def to_ns(self, name: str, t: NDArray[Any], stamp: int) -> NDArray[np.int64]:
        """Return the times (N,) in ns; `stamp` is the header's, in ns.

        Raises:
            DecodeError: times that do not fit 64 bits in ns.
        """
        if t.size == 0:
            return np.empty(0, np.int64)
        low, high = float(t.min()), float(t.max())
        seen = _Seen(name, t.dtype.kind, t.size, low, high, stamp)
        unit, relative = self._meaning or _infer_time(seen)
        if self._meaning is None and stamp > _NEAR_NS:  # near zero all origins look alike
            self._meaning = unit, relative
        if max(abs(low), abs(high)) * unit >= _MAX_NS:
            raise DecodeError(f"field '{name}' holds times beyond 64-bit nanoseconds")
        if t.dtype.kind == "f":
            t_ns = np.rint(t.astype(np.float64) * unit).astype(np.int64)
        else:
            t_ns = t.astype(np.int64) * unit
        if relative:
            t_ns += stamp
        return t_ns


class PointCloud2Decoder:
    """Decode event clouds; remembers what the time field means once that is certain."""

    def __init__(self, serialization: Serialization) -> None:
        self.statistics = Statistics()
        self._serialization = serialization
        self.reset()

    def resync(self, left_out: int) -> None:
        """Do nothing: what the time field means holds for all messages."""

    def reset(self) -> None:
        """Forget what the time field was found to mean."""
        self._time = _CloudTime()

    def decode(self, data: Bytes, part: int = 1) -> EventMessage:
        """Decode one message; see Decoder."""
        cursor = Cursor(data, self._serialization)
        header = cursor.header()
        height, width = cursor.integers("II")
        fields = _read_fields(cursor)
        (big_endian,) = cursor.integers("B")
        point_step, row_step = cursor.integers("II")
        cloud = cursor.blob()
        cursor.integers("B")  # is_dense
        cursor.finish()
        dtype, time_name = _point_dtype(fields, ">" if big_endian else "<", point_step)
        points = _view_points(cloud, dtype, height, width, row_step, point_step)
        events, dropped = self._events(points, time_name, stamp=header[0])
        events = first_part(events, part)
        return build_message(header, 0, 0, events, self.statistics, dropped=dropped)

    def _events(self, points: NDArray[np.void], time_name: str, stamp: int) -> tuple[Events, int]:
        total = points.size
        unusable = _no_pixel(points["x"]) | _no_pixel(points["y"]) | ~np.isfinite(points["t"])
        if unusable.any():
            points = points[~unusable]
        t = self._time.to_ns(time_name, points["t"], stamp)
        x, y = points["x"].astype(np.uint16), points["y"].astype(np.uint16)
        return Events(x, y, t, points["p"] > 0), total - len(t)


DECODER = PointCloud2Decoder


def _read_fields(cursor: Cursor) -> list[_Field]:
    (count,) = cursor.integers("I")
    if count * _MIN_FIELD_SIZE > cursor.remaining:
        raise DecodeError(f"{count} fields announced in {cursor.remaining} bytes")
    fields = []
    for _ in range(count):
        name = cursor.string()
        (offset,) = cursor.integers("I")
        (datatype,) = cursor.integers("B")
        cursor.integers("I")  # elements per field: only the first one counts
        fields.append(_Field(name, offset, datatype))
    return fields


def _point_dtype(fields: list[_Field], order: str, point_step: int) -> tuple[PointType, str]:
    """Build the dtype (x, y, t, p) of a point, and return the time field's own name."""
    if point_step > _MAX_POINT_STEP:
        raise DecodeError(f"points of {point_step} bytes are no events")
    by_name: dict[str, _Field] = {}
    for field in fields:
        by_name.setdefault(field.name.lower(), field)
    chosen = {
        "x": _find(by_name, ("x",)),
        "y": _find(by_name, ("y",)),
        "t": _find(by_name, _TIME_NAMES),
        "p": _find(by_name, _POLARITY_NAMES),
    }
    formats, offsets = [], []
    for field in chosen.values():
        if field.datatype not in _DATATYPES:
            raise DecodeError(f"field '{field.name}' has unknown datatype {field.datatype}")
        dtype = np.dtype(order + _DATATYPES[field.datatype])
        if field.offset + dtype.itemsize > point_step:
            raise DecodeError(f"field '{field.name}' lies outside the point of {point_step} bytes")
        formats.append(dtype)
        offsets.append(field.offset)
    point = np.dtype({"names": list(chosen), "formats": formats, "offsets": offsets})
    return point, chosen["t"].name.lower()


def _find(by_name: dict[str, _Field], names: tuple[str, ...]) -> _Field:
    for name in names:
        if name in by_name:
            return by_name[name]
    raise DecodeError(
        f"the cloud has no field {' or '.join(names)}, only {', '.join(by_name) or 'none'}"
    )


def _view_points(
    cloud: memoryview, dtype: PointType, height: int, width: int, row_step: int, point_step: int
) -> NDArray[np.void]:
    """View the points (height * width,) in row order; only padded rows are copied."""
    if height == 0 or width == 0:
        return np.empty(0, dtype)
    row_step = row_step if height > 1 else width * point_step
    if row_step < width * point_step or (height - 1) * row_step + width * point_step > len(cloud):
        raise DecodeError(f"{width}x{height} points do not fit the cloud of {len(cloud)} bytes")
    strides = (row_step, point_step)
    return np.ndarray((height, width), dtype, cloud, strides=strides).reshape(-1)


def _no_pixel(values: NDArray[Any]) -> NDArray[np.bool_] | np.bool_:
    """Mask of the values that are no pixel coordinate; not one can be if the type is small."""
    if values.dtype.kind == "u" and values.dtype.itemsize <= 2:
        return np.False_
    outside: NDArray[np.bool_] = ~((values >= 0) & (values < _COORDINATE_LIMIT))
    return outside


@dataclass(frozen=True, slots=True)
class _Seen:
    """What a message says of its time field: name, kind of type, values, and the header's stamp."""

    name: str
    kind: str
    count: int
    low: float
    high: float
    stamp: int


def _infer_time(seen: _Seen) -> tuple[int, bool]:
    unit = _unit_ns(seen)
    start = seen.low * unit
    absolute = abs(start - seen.stamp) < abs(start) or abs(start) > _LONGEST_RELATIVE_NS
    return unit, not absolute


def _unit_ns(seen: _Seen) -> int:
    for suffix, unit in _UNITS_NS.items():
        if seen.name.endswith(suffix):
            return unit
    if abs(seen.high) >= _EPOCH_NS:
        return 1
    if abs(seen.high) >= _EPOCH_US:
        return 1_000
    span = seen.high - seen.low
    if seen.kind == "f":
        return _unit_of_floats(seen.count, span)
    for unit in (1_000, 1):
        if seen.stamp > _NEAR_NS and abs(seen.low * unit - seen.stamp) < _NEAR_NS:
            return unit
    if seen.low > span or span < _SPAN_BETWEEN_US_AND_NS:
        return 1_000
    return 1


def _unit_of_floats(count: int, span: float) -> int:
    """Seconds, unless a message would last too long, and would not in another unit."""
    if count >= _ENOUGH and span * NS_PER_S > _LONGEST_RELATIVE_NS:
        for unit in (1_000, NS_PER_MS):
            if _USUAL_RATE[0] <= count / span * NS_PER_S / unit < _USUAL_RATE[1]:
                return unit
    return NS_PER_S
