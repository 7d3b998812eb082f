"""Encoders for every encoding of EventPacket: events in, payload out.

They write from the formats' descriptions what the decoders should read. Times are whole
microseconds; the encodings that count from time_base count from the one given.
"""

from collections.abc import Iterator

import numpy as np

from emoflow_ros.core.types.events import Events

Run = list[int]  # indices of consecutive events


def synthetic(rng: np.random.Generator, count: int, start_us: int = 1_000_000) -> Events:
    """Events of a 346x260 sensor in order of time, some in lines that vectors can hold."""
    steps = rng.choice([0, 0, 0, 1, 7, 90, 5000], size=count)
    t = (start_us + np.cumsum(steps)) * 1000
    x, y = rng.integers(0, 346, count), rng.integers(0, 260, count)
    p = rng.random(count) < 0.4
    same = (steps == 0) & (np.arange(count) > 0)  # neighbours of the event before
    for i in np.flatnonzero(same):
        horizontal = i % 2 == 0
        x[i] = (x[i - 1] + horizontal * rng.integers(1, 4)) % 346
        y[i] = (y[i - 1] + (not horizontal) * rng.integers(1, 4)) % 260
        p[i] = p[i - 1]
    return Events(x.astype(np.uint16), y.astype(np.uint16), t.astype(np.int64), p)


def assert_equal(events: Events, expected: Events) -> None:
    for name in ("x", "y", "t", "p"):
        got, want = getattr(events, name), getattr(expected, name)
        assert got.dtype == want.dtype
        np.testing.assert_array_equal(got, want, err_msg=name)


def evt3(events: Events, time_base: int = 0) -> np.ndarray:
    """Every vector in the full form 12 + 12 + 8, cut behind its last event."""
    words: Run = []
    high = low = row = -1
    for run in _runs(events, events.x, [events.t, events.y, events.p]):
        t, y, p = int(events.t[run[0]]) // 1000, int(events.y[run[0]]), int(events.p[run[0]])
        if (now := t >> 12 & 0xFFF) != high:
            words.append(0x8000 | (high := now))
        if (now := t & 0xFFF) != low:
            words.append(0x6000 | (low := now))
        if y != row:
            words.append(row := y)
        if len(run) == 1:
            words.append(0x2000 | p << 11 | int(events.x[run[0]]))
            continue
        base = int(events.x[run[0]])
        words.append(0x3000 | p << 11 | base)
        mask = sum(1 << int(events.x[i]) - base for i in run)
        for kind, width in ((0x4000, 12), (0x4000, 12), (0x5000, 8)):
            if mask:
                words.append(kind | mask & ((1 << width) - 1))
                mask >>= width
    return np.array(words, "<u2")


def libcaer_cmp(events: Events, time_base: int = 0) -> np.ndarray:
    words: Run = []
    high, low, column = 0, 0, -1
    for run in _runs(events, events.y, [events.t, events.x, events.p]):
        t = (int(events.t[run[0]]) - time_base) // 1000
        x, p = int(events.x[run[0]]), int(events.p[run[0]])
        if (now := t >> 12 & 0xFFF) != high:
            words.append(0x0000 | (high := now))
        if (now := t & 0xFFF) != low:
            words.append(0x1000 | (low := now))
        if x != column:
            words.append(0x2000 | (column := x))
        rows = events.y[run]
        if len(run) == 1:
            words.append(0x3000 | p << 11 | int(rows[0]))
            continue
        words.append(0x4000 | p << 11 | int(rows[0]))
        mask = sum(1 << int(y - rows[0]) for y in rows)
        while mask:
            words.append(0x5000 | mask & 0xFF)
            mask >>= 8
    return np.array(words, "<u2")


def libcaer(events: Events, time_base: int = 0) -> np.ndarray:
    x, y, p = (column.astype(np.uint32) for column in (events.x, events.y, events.p))
    us = (events.t - time_base) // 1000 & 0x7FFFFFFF
    data = x << 17 | y << 2 | p << 1 | 1  # bit 0: valid
    return np.stack([data, us.astype(np.uint32)], axis=1).reshape(-1).astype("<u4")


def mono(events: Events, time_base: int = 0) -> np.ndarray:
    x, y, p = (column.astype(np.uint64) for column in (events.x, events.y, events.p))
    dt = (events.t - time_base).astype(np.uint64)
    return (p << 63 | y << 48 | x << 32 | dt).astype("<u8")


def evt2(events: Events, time_base: int = 0) -> np.ndarray:
    words: Run = []
    high = -1
    columns = (c.tolist() for c in (events.x, events.y, events.t // 1000, events.p))
    for x, y, t, p in zip(*columns, strict=True):
        if (now := t >> 6 & 0xFFFFFFF) != high:
            words.append(0x8 << 28 | (high := now))
        words.append(p << 28 | (t & 0x3F) << 22 | x << 11 | y)
    return np.array(words, "<u4")


def evt21(events: Events, time_base: int = 0) -> np.ndarray:
    words: Run = []
    high = -1
    block = events.x >> 5
    for run in _runs(events, events.x, [events.t, events.y, events.p, block]):
        t, y, p = int(events.t[run[0]]) // 1000, int(events.y[run[0]]), int(events.p[run[0]])
        if (now := t >> 6 & 0xFFFFFFF) != high:
            high = now
            words.append(0x8 << 60 | high << 32)
        base = int(block[run[0]]) << 5
        mask = sum(1 << int(events.x[i]) - base for i in run)
        words.append(p << 60 | (t & 0x3F) << 54 | base << 43 | y << 32 | mask)
    return np.array(words, "<u8")


ENCODERS = {
    "evt3": evt3,
    "libcaer_cmp": libcaer_cmp,
    "libcaer": libcaer,
    "mono": mono,
    "evt2": evt2,
    "evt21": evt21,
}
COUNT_FROM_TIME_BASE = ("libcaer_cmp", "libcaer", "mono")


def payload(words: np.ndarray, big_endian: bool = False) -> bytes:
    return words.byteswap().tobytes() if big_endian else words.tobytes()


def _runs(events: Events, along: np.ndarray, equal: list[np.ndarray]) -> Iterator[Run]:
    """Split into runs that agree in `equal` and advance by at most 31 pixels in `along`."""
    run: Run = []
    for i in range(len(events)):
        if run:
            joins = all(column[i] == column[run[0]] for column in equal)
            advance = int(along[i]) - int(along[run[0]])
            if not (joins and along[i] > along[run[-1]] and advance < 32):
                yield run
                run = []
        run.append(i)
    if run:
        yield run
