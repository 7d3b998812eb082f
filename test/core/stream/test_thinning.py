"""Which events stay where more come than a window may hold."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emoflow_ros.core.stream.cleaning import without_flicker, without_hot_pixels
from emoflow_ros.core.stream.thinning import EventBudget, first_of_latest, spread
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window, WindowPolicy

MS = NS_PER_MS
WIDTH, HEIGHT = 640, 480
START = 10**18
POLICY = WindowPolicy(duration_ms=135.0, stride_ms=45.0, max_displacement_px=20.0)
BUDGET = EventBudget(POLICY, 3000)
WHOLE = EventBudget(WindowPolicy(duration_ms=90.0), 3000)


def at(t_ns, x, y, p) -> Events:
    t = START + np.asarray(t_ns, np.int64)
    return Events(np.asarray(x, np.uint16), np.asarray(y, np.uint16), t, np.asarray(p, np.bool_))


def noise(count: int, duration_ms: float = 135.0, seed: int = 0) -> Events:
    """Events all over the image, three times as dense on its left half, 30 % of them ON."""
    rng = np.random.default_rng(seed)
    x = rng.integers(0, WIDTH, count)
    x = np.where(rng.random(count) < 0.5, x // 2, x)
    t = np.sort(rng.integers(0, round(duration_ms * MS), count))
    return at(t, x, rng.integers(0, HEIGHT, count), rng.random(count) < 0.3)


def window(events: Events, duration_ms: float = 135.0) -> Window:
    return Window(START, START + round(duration_ms * MS), events)


def numbers(events: Events, among: Events) -> np.ndarray:
    """Which of the others these are, by all that an event has."""
    names = {e: i for i, e in enumerate(zip(among.t, among.x, among.y, among.p, strict=True))}
    return np.array([names[e] for e in zip(events.t, events.x, events.y, events.p, strict=True)])


def test_what_is_within_the_budget_stays_as_it_is():
    few = window(noise(11_000))
    assert BUDGET.capacity > 11_000
    thinned = BUDGET.thin(few)
    assert thinned.events is few.events
    assert thinned.events.stands_for is None


@pytest.mark.parametrize("budget", [BUDGET, WHOLE], ids=["parts", "whole"])
@pytest.mark.parametrize("count", [20_000, 26_000, 34_000, 300_000])
def test_a_window_holds_no_more_than_the_capacity_and_says_how_many_came(budget, count):
    length = budget.policy.duration_ms
    events = noise(count, length)
    thinned = budget.thin(window(events, length)).events
    assert budget.capacity / 1.3 < len(thinned) <= budget.capacity
    assert thinned.came == count
    assert (np.diff(numbers(thinned, events)) > 0).all()  # some of them, in their order, each once


def test_the_capacity_is_a_few_times_what_an_estimator_takes():
    assert BUDGET.capacity <= 4.2 * 3000
    assert WHOLE.capacity <= 3.7 * 3000
    assert EventBudget(WindowPolicy(duration_ms=10.0), 3000).capacity == 3000
    assert EventBudget(POLICY, 30_000).capacity == pytest.approx(10 * BUDGET.capacity, rel=0.01)


@pytest.mark.parametrize("part_ms", [10, 15, 20, 25, 30, 45, 60, 90, 100, 135])
def test_every_latest_part_of_10_ms_and_more_holds_what_an_estimator_takes(part_ms):
    thinned = BUDGET.thin(window(noise(300_000)))
    part = thinned.since(thinned.t_end - part_ms * MS).events
    assert len(part) >= 0.99 * 3000
    assert part.came == pytest.approx(300_000 * part_ms / 135, rel=0.02)


def test_a_clip_of_what_an_estimator_takes_stays_as_it_is_however_short():
    """Not cut from a stream by time: all its events may lie in a millisecond."""
    burst = noise(3000, 1.0)
    for length_ms in (1.0, 5.0, 50.0, 200.0):
        assert BUDGET.thin(window(burst, length_ms)).events is burst
    assert len(BUDGET.thin(window(noise(4000, 1.0), 1.0)).events) == 3000


def test_thinning_twice_is_thinning_once():
    once = BUDGET.thin(window(noise(300_000)))
    assert BUDGET.thin(once).events is once.events


def test_bursts_lose_most_and_the_count_in_every_millisecond_stays_right():
    quiet, burst = noise(9000), noise(40_000, 3.0, seed=1)
    both = Events.concatenate([quiet, burst])
    both = both[np.argsort(both.t, kind="stable")]
    thinned = WHOLE.limit_rate(both, START)
    edges = START + np.arange(136) * MS
    came = np.histogram(both.t, edges)[0]
    stands = np.histogram(thinned.t, edges, weights=thinned.stands_for)[0]
    np.testing.assert_array_equal(stands, came)
    left = np.histogram(thinned.t, edges)[0]
    assert (left[:3] == 300).all()  # 3000 events in 10 ms
    np.testing.assert_array_equal(left[3:], np.minimum(came[3:], 300))


def deviation(kept: Events, events: Events, cell) -> np.ndarray:
    """Kept events in each cell less the share that each should keep."""
    share = len(kept) / len(events)
    cells = int(cell(events).max()) + 1
    count = np.bincount(cell(kept), minlength=cells)
    return count - share * np.bincount(cell(events), minlength=cells)


def blocks(events: Events) -> np.ndarray:
    return (events.y // 32).astype(int) * 20 + events.x // 32


def test_every_block_keeps_its_share_more_evenly_than_by_chance():
    budget = EventBudget(POLICY, 30_000)
    events = noise(2_000_000)
    kept = budget.thin(window(events)).since(START + 125 * MS).events
    events = window(events).since(START + 125 * MS).events
    assert len(kept) == 30_000
    left = np.count_nonzero(kept.x < WIDTH // 2) / len(kept)
    assert abs(left - np.count_nonzero(events.x < WIDTH // 2) / len(events)) < 0.01
    halves = [kept[kept.t < START + 130 * MS], events[events.t < START + 130 * MS]]
    for few, all_of_them in ([kept, events], halves):
        spread_px = (deviation(few, all_of_them, blocks) ** 2).mean()
        by_chance = len(few) / 300  # variance of a Poisson count, on average over 300 blocks
        assert spread_px < 0.6 * by_chance


def test_on_and_off_keep_their_shares():
    events = noise(800_000, 90.0)
    kept = EventBudget(WHOLE.policy, 30_000).limit_rate(events, START)
    assert len(kept) == 90 * 3000
    assert abs(kept.p.mean() - events.p.mean()) < 0.003


def test_a_block_keeps_its_share_all_the_time():
    events = noise(200_000, 90.0)
    kept = WHOLE.limit_rate(events, START)
    for x in (0, 320):
        mine, its = (e[(e.x // 160 == x // 160) & (e.y < 240)] for e in (kept, events))
        rank = np.sort((mine.t - START) / (90 * MS))
        of_all = np.sort((its.t - START) / (90 * MS))
        distance = np.abs(
            np.searchsorted(of_all, rank) / len(of_all) - np.linspace(0, 1, len(rank))
        )
        assert distance.max() < 1.4 / len(rank) ** 0.5  # Kolmogorov and Smirnov, 5 %


@pytest.mark.parametrize("period", [2, 4, 8, 12, 32])
def test_what_repeats_in_the_order_of_readout_is_thinned_alike(period):
    """Columns or polarities that alternate: a plain step would take always the same one."""
    count = 32 * 6000
    t = np.arange(count) * (90 * MS) // count
    turn = np.arange(count) % period
    events = at(t, 64 + turn, (np.arange(count) // period) % HEIGHT, turn % 2 == 0)
    kept = WHOLE.limit_rate(events, START)
    number = np.bincount(kept.x - 64, minlength=period)
    assert number.min() > 0.6 * len(kept) / period
    assert number.max() < 1.5 * len(kept) / period


def test_a_few_events_among_many_are_not_always_the_ones_that_are_lost():
    """A lone block with one event per millisecond, of which one in 13 can stay."""
    events = noise(400_000, 90.0)
    events = events[events.y < 400]
    lone = at(np.arange(90) * MS + 7, np.full(90, 300), np.full(90, 470), np.ones(90))
    both = Events.concatenate([events, lone])
    both = both[np.argsort(both.t, kind="stable")]
    kept = WHOLE.limit_rate(both, START)
    assert 0 < np.count_nonzero(kept.y == 470) <= 16


@pytest.mark.parametrize("shift", [100_000, 23_000_000_007, -(10**9), 10**18])
def test_what_stays_does_not_depend_on_the_origin_of_the_clock(shift):
    events = noise(300_000, 135.0)
    kept = BUDGET.thin(window(events)).events
    later = replace(events, t=events.t + shift)
    others = BUDGET.thin(Window(START + shift, START + shift + 135 * MS, later)).events
    assert len(kept) < len(events) / 10
    assert (numbers(kept, events) == numbers(others, later)).all()
    assert (kept.stands_for == others.stands_for).all()


def test_hot_pixels_are_still_recognised():
    """Edges that leave 100 events on each pixel of some, and ten pixels at 1000 Hz."""
    rng = np.random.default_rng(3)
    edges = noise(300_000)
    t = np.sort(rng.integers(0, 135 * MS, 1350))
    hot = np.repeat(np.arange(10), 135)
    rng.shuffle(hot)
    lonely = at(t, 37 + 60 * hot, np.full(1350, 200), rng.random(1350) < 0.5)
    both = Events.concatenate([edges, lonely])
    both = both[np.argsort(both.t, kind="stable")]
    budget = EventBudget(POLICY, 30_000)
    kept = budget.thin(window(both)).events
    assert len(kept) < len(both) / 2.5
    is_hot = (kept.y == 200) & ((kept.x.astype(int) - 37) % 60 == 0)
    assert is_hot.sum() > 300
    cleaned = without_hot_pixels(kept, WIDTH, HEIGHT)
    assert not ((cleaned.y == 200) & ((cleaned.x.astype(int) - 37) % 60 == 0)).any()
    assert len(cleaned) > 0.99 * np.count_nonzero(~is_hot)


def lit(events: Events) -> int:
    return int(np.count_nonzero((events.x < 320) & (events.y < 240)))


@pytest.mark.parametrize("hz", [100, 120])
def test_flicker_is_still_recognised(hz):
    """A lamp on a quarter of the image: its bursts at each half-wave are thinned more."""
    rest = noise(400_000)
    rest = rest[(rest.x >= 320) | (rest.y >= 240)]
    rng = np.random.default_rng(4)
    t = rng.uniform(0, 0.135, 1_200_000)
    t = np.sort(t + 0.0004 * np.sin(4 * np.pi * hz * t)).clip(0, 0.1349)
    lamp = at(
        t * 1e9, rng.integers(0, 320, len(t)), rng.integers(0, 240, len(t)), (t * hz) % 1 < 0.5
    )
    both = Events.concatenate([rest, lamp])
    both = both[np.argsort(both.t, kind="stable")]
    kept = EventBudget(POLICY, 30_000).thin(window(both)).events
    assert len(kept) < len(both) / 11
    missed = [lit(without_flicker(e, WIDTH, HEIGHT)) / lit(e) for e in (both, kept)]
    assert missed[1] < missed[0]
    cleaned = without_flicker(kept, WIDTH, HEIGHT)
    assert len(cleaned) - lit(cleaned) == len(kept) - lit(kept)


def test_spread_gives_the_share_of_time_that_the_stream_has():
    thinned = BUDGET.thin(window(noise(300_000))).events
    late = np.count_nonzero(thinned.t >= START + 125 * MS) / len(thinned)
    assert late > 0.2  # of 10 ms of 135
    few = spread(thinned, 3000)
    assert 2500 < len(few) <= 3000
    assert (np.diff(numbers(few, thinned)) > 0).all()
    share = np.histogram(few.t, START + np.arange(0, 136, 15) * MS)[0] / len(few)
    np.testing.assert_allclose(share, 1 / 9, atol=0.015)


def test_spread_of_events_that_were_not_thinned_is_in_equal_steps():
    events = noise(100)
    assert spread(events, 100) is events
    np.testing.assert_array_equal(numbers(spread(events, 40), events), np.arange(40) * 100 // 40)


@settings(max_examples=100)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=30), st.integers(1, 300))
def test_spread_of_thinned_events_takes_those_of_the_streams_equal_steps(weights, count):
    zero = np.zeros(len(weights), np.uint16)
    events = Events(zero, zero, np.arange(len(weights)), zero > 0, np.array(weights, np.uint32))
    stream = np.repeat(events.t, weights)
    steps = stream[np.arange(count) * len(stream) // count]
    np.testing.assert_array_equal(spread(events, count).t, np.unique(steps))


@settings(max_examples=100)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=30), st.integers(1, 300), st.booleans())
def test_counts_of_parts_add_up_and_the_latest_are_found(weights, count, plain):
    stands_for = None if plain else np.array(weights, np.uint32)
    zero = np.zeros(len(weights), np.uint16)
    events = Events(zero, zero, np.arange(len(weights)), zero > 0, stands_for)
    one_each = np.ones(len(weights), int) if plain else np.array(weights)
    first = first_of_latest(events, count)
    assert events.came == one_each.sum() == events[:first].came + events[first:].came
    assert events[first:].came <= count
    assert first == 0 or events[first - 1 :].came > count
    joined = Events.concatenate([events, Events.empty(), events])
    assert joined.came == 2 * events.came


def test_bins_end_where_windows_do():
    budget = EventBudget(WindowPolicy(duration_ms=10.7, stride_ms=4.0), 100)
    edges = [0]
    while edges[-1] < 12 * MS:
        start, end = budget.bin_at(START, START + edges[-1])
        assert start == START + edges[-1]
        edges.append(end - START)
    assert {4 * MS, 8 * MS, 12 * MS, 2_700_000, 6_700_000, 10_700_000} <= set(edges)
    assert all(0 < b - a <= MS for a, b in pairwise(edges))
