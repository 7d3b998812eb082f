"""sensor_msgs/PointCloud2 whose points are events.

Fields are found by name, in any order and numeric type: x, y, one of t, ts, time, timestamp,
t_s, t_us, t_ns, and one of p, polarity, pol (ON where positive). Others are ignored. The cloud's
width and height are its own organisation, not the sensor's: the geometry stays unknown.
What the times mean is in `msg_adapters/cloud_time.py`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import Events
from msg_adapters.cloud_time import CloudTime
from msg_adapters.message import Bytes, EventMessage, Statistics, build_message
from msg_adapters.wire import Cursor, DecodeError, Serialization

TYPES = ("sensor_msgs/msg/PointCloud2",)

_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_TIME_NAMES = ("t", "ts", "time", "timestamp", "t_s", "t_us", "t_ns")
_POLARITY_NAMES = ("p", "polarity", "pol")
_COORDINATE_LIMIT = 1 << 16
_MAX_POINT_STEP = 1 << 16
_MIN_FIELD_SIZE = 13  # bytes of an unnamed PointField, at least


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    offset: int
    datatype: int


class PointCloud2Decoder:
    """Decode event clouds; remembers what the time field means once that is certain."""

    def __init__(self, serialization: Serialization) -> None:
        self.statistics = Statistics()
        self._serialization = serialization
        self.reset()

    def reset(self) -> None:
        """Forget what the time field was found to mean."""
        self._time = CloudTime()

    def decode(self, data: Bytes) -> EventMessage:
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


def _point_dtype(fields: list[_Field], order: str, point_step: int) -> tuple[np.dtype, str]:
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
    cloud: memoryview, dtype: np.dtype, height: int, width: int, row_step: int, point_step: int
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
