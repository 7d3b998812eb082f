"""Windows on their way to the worker: unchanged, and in few bytes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emoflow_ros.config import load_config
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import (
    NS_PER_MS,
    SLICE_BIN_NS,
    SLICE_EVENTS,
    SLICE_MS,
    Events,
    Window,
    WindowPolicy,
)
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.node.channel import pack_window, unpack_window

MS = NS_PER_MS
START = 1_700_000_000_000_000_123


def window(offsets, stands_for=None, gyro=None) -> Window:
    t = START + np.asarray(offsets, np.int64)
    x = np.arange(len(t)).astype(np.uint16)
    return Window(START, START + 100 * MS, Events(x, 7 * x, t, x % 2 == 0, stands_for), gyro)


def assert_same(one: Events, other: Events) -> None:
    for name in ("x", "y", "t", "p"):
        got, want = getattr(one, name), getattr(other, name)
        assert got.dtype == want.dtype
        np.testing.assert_array_equal(got, want)
    assert (one.stands_for is None) == (other.stands_for is None)
    if one.stands_for is not None and other.stands_for is not None:
        assert one.stands_for.dtype == other.stands_for.dtype == np.uint32
        np.testing.assert_array_equal(one.stands_for, other.stands_for)


@settings(max_examples=100)
@given(
    st.lists(st.integers(0, 10_000 * MS), max_size=20).map(sorted),
    st.sampled_from([None, 1, 300, 70_000]),
)
def test_a_window_arrives_as_it_was(offsets, most):
    stands_for = None if most is None else np.full(len(offsets), most, np.uint32)
    sent = window(offsets, stands_for)
    interval, arrays = pack_window(sent)
    got = unpack_window(interval, arrays)
    assert (got.t_start, got.t_end, got.gyro) == (sent.t_start, sent.t_end, None)
    assert_same(got.events, sent.events)


def test_the_gyro_goes_with_it():
    readings = GyroReadings(START + np.arange(3) * MS, np.arange(9.0).reshape(3, 3))
    interval, arrays = pack_window(window([1, 2], gyro=readings))
    got = unpack_window(interval, arrays)
    assert got.gyro is not None
    np.testing.assert_array_equal(got.gyro.t, readings.t)
    np.testing.assert_array_equal(got.gyro.w, readings.w)


@pytest.mark.parametrize("rate", [10e6, 25e6, 50e6])
def test_what_crosses_is_bounded_whatever_comes(rate):
    """Windows of the default profile from 1280x720 pixels at so many events per second."""
    config = load_config()
    budget = EventBudget(config.window, config.estimator.max_events)
    count = round(rate * config.window.duration_ms / 1e3)
    rng = np.random.default_rng(0)
    t = START + np.arange(count) * config.window.duration_ns // count
    x, y = rng.integers(0, (1280, 720), (count, 2)).astype(np.uint16).T
    cut = Window(START, START + config.window.duration_ns, Events(x, y, t, x % 2 == 0))
    _, arrays = pack_window(budget.thin(cut))
    assert arrays["x"].size <= budget.capacity < 4.2 * config.estimator.max_events
    size = sum(array.nbytes for array in arrays.values())
    assert size <= 11 * budget.capacity < 1.38e6
    policy = WindowPolicy(duration_ms=SLICE_MS, stride_ms=15.0)
    begin = cut.t_end - policy.duration_ns
    newest = cut.events[cut.events.t >= begin]
    stay = EventBudget(policy, SLICE_EVENTS, SLICE_BIN_NS).limit_rate(newest, begin)
    _, arrays = pack_window(Window(begin, cut.t_end, stay))
    assert arrays["x"].size <= SLICE_MS / 10 * SLICE_EVENTS
    assert sum(array.nbytes for array in arrays.values()) <= 0.265e6
