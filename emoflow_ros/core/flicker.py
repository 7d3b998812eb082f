"""Events of lamps that flicker on alternating current: they move with nothing.

A lamp on mains of 50 or 60 Hz brightens and dims 100 or 120 times a second. Where its light falls,
all pixels fire ON together and OFF half a period later. An edge that moves does so once, or at
times that have nothing to do with the mains.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import Events

MAINS_HZ = (100.0, 120.0)

_BLOCK = 16  # sensor pixels along a side of a block
_PARTS = 3  # of the time, each of which must show the flicker by itself
_SHORTEST_S = 0.02  # two periods
_COHERENT = 0.35  # share of the polarity that goes with the mains from which a block flickers
_CERTAIN = 5.0  # n times the square of that: exp(-5) is its chance without flicker, per part
_SAMPLE = 20_000  # events that suffice


def without_flicker(events: Events, width: int, height: int) -> Events:
    """Leave out the events of the blocks of 16 x 16 pixels that flicker.

    The measure is |sum p exp(-2 pi i f t)| / n over the n events of a block, with p = +-1: near 1
    where the light flickers, about 1 / sqrt(n) where edges move.

    Args:
        events: on the sensor, of at least 20 ms; shorter ones are returned as they are.
        width, height: of the sensor in pixels.
    """
    seconds = (events.t - events.t[0]) * 1e-9 if len(events) else np.zeros(0)
    if not len(events) or seconds[-1] < _SHORTEST_S:
        return events
    step = max(1, len(events) // _SAMPLE)
    flickers = _flickering_blocks(events[::step], seconds[::step], width, height)
    if not flickers.any():
        return events
    return events[~flickers[_blocks(events, width)]]


def _flickering_blocks(
    events: Events, seconds: NDArray[np.float64], width: int, height: int
) -> NDArray[np.bool_]:
    count = -(-width // _BLOCK) * -(-height // _BLOCK)
    part = np.minimum((seconds * (_PARTS / seconds[-1])).astype(np.intp), _PARTS - 1)
    cell = part * count + _blocks(events, width)
    n = np.bincount(cell, minlength=_PARTS * count).reshape(_PARTS, count)
    often = n.min(axis=0) >= _CERTAIN
    flickers = np.zeros(count, np.bool_)
    if not often.any():
        return flickers
    sign = np.where(events.p, 1.0, -1.0)
    for frequency in MAINS_HZ:
        angle = (2 * np.pi * frequency) * seconds
        waves = [
            np.bincount(cell, sign * wave(angle), _PARTS * count).reshape(_PARTS, count)
            for wave in (np.cos, np.sin)
        ]
        coherence = np.hypot(*waves) / np.maximum(n, 1)
        certain = (n * coherence**2).min(axis=0) > _CERTAIN
        flickers |= certain & (coherence.min(axis=0) > _COHERENT)
    return flickers


def _blocks(events: Events, width: int) -> NDArray[np.intp]:
    """Index of the block (N,) that each event lies in."""
    columns = -(-width // _BLOCK)
    return (events.y // _BLOCK).astype(np.intp) * columns + events.x // _BLOCK
