"""Inner loops of thinning in numba; see `thinning`."""

import numpy as np
from numba import types
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit

_BLOCK_BITS = 5  # 32 sensor pixels along a side of a block
_SIDE_BITS = 6  # blocks along a side of the image; beyond 2048 px they are shared
_STRATA = 2 << 2 * _SIDE_BITS  # blocks, ON and OFF apart
_CANDIDATES = 2  # times as many as stay are looked at: no more, whatever comes


def _places() -> NDArray[np.uint16]:
    """Places of the image's blocks by row and column, one after another by quarters of quarters."""
    number = np.arange(1 << _SIDE_BITS)
    bits = [(number >> k & 1) << 2 * k for k in range(_SIDE_BITS)]
    apart = np.sum(bits, axis=0)
    return (2 * apart[:, None] + apart).astype(np.uint16)


_PLACES = _places()


@njit(types.int64(types.int64, types.int64, types.int64), inline="always")
def _candidate(k, step, phase):  # type: ignore[no-untyped-def]
    """Index of the k-th candidate: one of each `step` events (in 65536ths of an event).

    Where among these it lies changes: what repeats in the order of readout is not met in step.
    """
    first, following = k * step >> 16, (k + 1) * step >> 16
    return first + ((k * 0x9E37 + phase & 0xFFFF) * (following - first) >> 16)


@njit(types.int64(types.int64, types.int64, types.int64, types.int64))
def _hash(x, y, count, span):  # type: ignore[no-untyped-def]
    """32 bits that differ between pieces: by the first event's pixel, the number, the length."""
    mixed = (((x << 16) ^ y) * 0x9E3779B1) & 0xFFFFFFFF
    mixed = ((mixed ^ count) * 0x9E3779B1) & 0xFFFFFFFF
    return ((mixed ^ span) * 0x9E3779B1) & 0xFFFFFFFF


def _column(kind: types.Type) -> types.Array:
    return types.Array(kind, 1, "C", readonly=True)


@njit(types.intp(_column(types.uint32), types.int64), nogil=True)
def first_of_latest(stands_for, count):  # type: ignore[no-untyped-def]
    """Index of the first of the latest events that stand for no more than `count`."""
    first, number = len(stands_for), np.int64(0)
    while first > 0 and number + stands_for[first - 1] <= count:
        first -= 1
        number += stands_for[first]
    return first


@njit(types.intp(_column(types.uint32), types.intp[::1]), nogil=True)
def steps(stands_for, chosen):  # type: ignore[no-untyped-def]
    """Write the indices of the events at equal steps of the stream; return their number.

    With n = len(chosen) and N events in the stream, step k is event k * N // n of it. It lies
    before the end of an event's share where k * N is below n times that.
    """
    number, end, step, came = 0, 0, 0, 0
    for i in range(len(stands_for)):
        came += stands_for[i]
    for i in range(len(stands_for)):
        end += stands_for[i] * len(chosen)
        if step < end:
            chosen[number] = i
            number += 1
            while step < end:
                step += came
    return number


@njit()
def _choose(x, y, p, weights, one_each, count, phase, rest, blocks, chosen, number):  # type: ignore[no-untyped-def]
    """Write the indices of `count` evenly spread events from chosen[number] on; return the next.

    The candidates, block after block and OFF before ON, are a line, of which each takes as much as
    it stands for. Where the line is cut into `count` equal pieces, one is taken. Each block knows
    where on the line it begins, so that the candidates need not be sorted.
    """
    candidates = min(len(x), _CANDIDATES * count)
    step = (len(x) << 16) // candidates
    mask = (1 << _SIDE_BITS) - 1
    rest[:] = 0
    total = 0
    for k in range(candidates):
        i = _candidate(k, step, phase)
        place = _PLACES[(y[i] >> _BLOCK_BITS) & mask, (x[i] >> _BLOCK_BITS) & mask]
        blocks[k] = place + (_STRATA >> 1 if p[i] else 0)
        weight = 1 if one_each else weights[i]
        rest[blocks[k]] += weight
        total += weight
    begin = phase * total >> 32
    for block in range(_STRATA):
        length = rest[block]
        rest[block] = begin
        if length:
            begin = (begin + length * count) % total
    for k in range(candidates):
        i, block = _candidate(k, step, phase), blocks[k]
        reached = rest[block] + (count if one_each else weights[i] * count)
        cut = reached >= total
        if reached >= 2 * total:  # it stands for many
            reached %= total
        else:
            reached -= total if cut else 0
        rest[block] = reached
        chosen[number] = i  # stays if the line is cut here; without a branch that is hard to guess
        number += cut
    return number


@njit(
    types.intp(
        _column(types.uint16), _column(types.uint16), _column(types.int64), _column(types.boolean),
        _column(types.uint32), _column(types.intp), _column(types.int64), types.boolean,
        types.intp[::1], types.uint32[::1],
    ),
    nogil=True,
)  # fmt: skip
def thin(x, y, t, p, weights, bounds, limits, one_each, chosen, shares):  # type: ignore[no-untyped-def]
    """Write the indices of what stays of each piece into `chosen`, in order; return their number.

    `shares` gets how many events each of them stands for. `chosen` has room for one more.
    """
    rest = np.empty(_STRATA, np.int64)
    blocks = np.empty(_CANDIDATES * limits.max(), np.uint16)
    number = 0
    for piece in range(len(limits)):
        begin, end, count = bounds[piece], bounds[piece + 1], limits[piece]
        if end - begin <= count:
            for i in range(begin, end):
                chosen[number] = i
                shares[number] = 1 if one_each else weights[i]
                number += 1
            continue
        # The count begins at another event in each piece. Otherwise a block of few events would
        # lose them all, in every piece. No time of the clock enters: its origin changes nothing.
        phase = _hash(x[begin], y[begin], end - begin, t[end - 1] - t[begin])
        first = number
        number = _choose(
            x[begin:end], y[begin:end], p[begin:end], weights[begin:end], one_each, count, phase,
            rest, blocks, chosen, number,
        )  # fmt: skip
        came = end - begin
        if not one_each:
            came = 0
            for i in range(begin, end):
                came += weights[i]
        for k in range(first, number):
            chosen[k] += begin
            before = (k - first) * came // (number - first)
            shares[k] = (k - first + 1) * came // (number - first) - before
    return number
