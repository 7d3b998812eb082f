"""What the time field of an event cloud means: PointCloud2 declares neither unit nor origin.

Unit: the field's suffix (`t_s`, `t_us`, `t_ns`) if it has one. Otherwise the magnitude of epoch
times tells (from 1e17: ns, from 1e14: us); else floats are seconds. Integers have 32 bits at
most: they are us or ns, whichever meets the header's stamp; else us if they count from far
before the message (ns would wrap every 4.3 s); else the span of the message decides.

Origin: absolute if nearer to the header's stamp than to zero, or more than 1 s from zero (a
sensor's own clock); else relative to the header's stamp.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.wire import NS_PER_S, DecodeError

_UNITS_NS = {"_s": NS_PER_S, "_us": 1_000, "_ns": 1}
_EPOCH_NS, _EPOCH_US = 1e17, 1e14
_NEAR_NS = 2 * NS_PER_S
_LONGEST_RELATIVE_NS = NS_PER_S
# Messages of event cameras last 0.25 ms to 250 ms: a span above this is ns, below it us.
_SPAN_BETWEEN_US_AND_NS = 250_000
_MAX_NS = 2.0**62  # leaves room for the stamp to be added


class CloudTime:
    """Convert one topic's time field to ns; its meaning is kept once it is certain."""

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
        unit, relative = self._meaning or _infer(name, t.dtype.kind, low, high, stamp)
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


def _infer(name: str, kind: str, low: float, high: float, stamp: int) -> tuple[int, bool]:
    unit = _unit_ns(name, kind, low, high, stamp)
    start = low * unit
    absolute = abs(start - stamp) < abs(start) or abs(start) > _LONGEST_RELATIVE_NS
    return unit, not absolute


def _unit_ns(name: str, kind: str, low: float, high: float, stamp: int) -> int:
    for suffix, unit in _UNITS_NS.items():
        if name.endswith(suffix):
            return unit
    if abs(high) >= _EPOCH_NS:
        return 1
    if abs(high) >= _EPOCH_US:
        return 1_000
    if kind == "f":
        return NS_PER_S
    for unit in (1_000, 1):
        if stamp > _NEAR_NS and abs(low * unit - stamp) < _NEAR_NS:
            return unit
    if low > high - low or high - low < _SPAN_BETWEEN_US_AND_NS:
        return 1_000
    return 1
