"""Single events out of order are left out, few as they are; time that goes back for good is not."""

import numpy as np
import pytest

from emoflow_ros.core.stream.event_order import EventOrder
from emoflow_ros.core.types.events import Events, TimeJumpError

MS = 1_000_000


def stream(times_ms: list[float] | np.ndarray) -> Events:
    t = np.rint(np.asarray(times_ms, float) * MS).astype(np.int64)
    k = np.arange(len(t))
    return Events(k.astype(np.uint16), k.astype(np.uint16), t, k % 2 == 0)


def sifted(times_ms: list[float] | np.ndarray, chunk: int) -> tuple[list[int], int]:
    """Numbers of the events that were passed on, and how many were left out."""
    order, events = EventOrder(), stream(times_ms)
    parts = [order(events[k : k + chunk]) for k in range(0, len(events), chunk)]
    kept = Events.concatenate(parts)
    assert (np.diff(kept.t) >= 0).all()
    assert order.left_out == len(events) - len(kept)
    assert order.last == kept.t[-1]
    return kept.x.tolist(), order.left_out


CHUNKS = [1, 7, 64, 1000]
REGULAR = np.arange(1000.0)


@pytest.mark.parametrize("chunk", CHUNKS)
def test_events_in_order_are_passed_on_as_they_are(chunk):
    assert sifted(REGULAR, chunk) == (list(range(1000)), 0)
    assert sifted(np.repeat(REGULAR[:100], 10), chunk) == (list(range(1000)), 0)


def test_without_disorder_there_is_no_copy():
    events = stream(REGULAR)
    order = EventOrder()
    assert order(events) is events
    assert len(order(Events.empty())) == 0
    assert (order.last, order.left_out, order.first_disorder) == (999 * MS, 0, None)


@pytest.mark.parametrize("chunk", CHUNKS)
@pytest.mark.parametrize("early_ms", [0.02, 1.5, 99, 1000, 1e6])
def test_single_events_too_early_are_left_out(chunk, early_ms):
    times = REGULAR.copy()
    early = [5, 300, 600, 999]
    times[early] -= early_ms + 1  # the regular distance is 1 ms
    kept, left_out = sifted(times, chunk)
    assert kept == [k for k in range(1000) if k not in early]
    assert left_out == 4


@pytest.mark.parametrize("late_ms", [1.5, 30, 1000, 1e9])
@pytest.mark.parametrize("late", [[0], [400], [400, 401, 402], [0, 1, 500]])
def test_single_events_too_late_are_left_out_and_not_what_follows(late, late_ms):
    times = REGULAR.copy()
    times[late] += late_ms
    kept, left_out = sifted(times, 1000)
    assert left_out <= len(late)
    if late_ms > 10:
        assert kept == [k for k in range(1000) if k not in late]


@pytest.mark.parametrize("chunk", CHUNKS)
def test_clock_that_lags_for_some_milliseconds_loses_these_alone(chunk):
    """A lost word: 200 events of 20 us distance keep the upper half of the time before."""
    times = np.arange(5000) * 0.02
    times[2000:2200] -= 4.096
    kept, left_out = sifted(times, chunk)
    assert 200 <= left_out <= 210  # those that lag, or in small chunks those that seem to be ahead
    if chunk == 1000:
        assert kept == [k for k in range(5000) if not 2000 <= k < 2200]


@pytest.mark.parametrize("ahead_ms", [20, 1000, 16_777])
def test_clock_that_is_ahead_for_some_milliseconds_loses_these_alone(ahead_ms):
    """A wrong word: 200 events of 4 ms have the upper half of another time."""
    times = np.arange(10_000) * 0.02
    times[2000:2200] += ahead_ms
    kept, left_out = sifted(times, 10_000)
    assert left_out == 200
    assert kept == [k for k in range(10_000) if not 2000 <= k < 2200]


def test_every_other_event_too_early_takes_no_longer_than_others():
    times = np.arange(60_000) * 1e-3
    times[1::2] -= 20
    kept, left_out = sifted(times, 60_000)
    assert left_out == 30_000
    assert kept == list(range(0, 60_000, 2))


@pytest.mark.parametrize("chunk", CHUNKS)
@pytest.mark.parametrize("back_ms", [150, 500, 5e6])
def test_time_that_goes_back_for_good_is_a_jump(chunk, back_ms):
    times = np.concatenate([REGULAR, REGULAR + 1000 - back_ms])
    with pytest.raises(TimeJumpError, match=f"went back by {(back_ms - 1) / 1000:.6f} s") as caught:
        sifted(times, chunk)
    assert (caught.value.last, caught.value.now) == (999 * MS, round((1000 - back_ms) * MS))


def test_after_a_jump_nothing_of_it_was_taken():
    order = EventOrder()
    order(stream(REGULAR))
    again = stream(REGULAR)
    with pytest.raises(TimeJumpError):
        order(again)
    assert (order.last, order.left_out) == (999 * MS, 0)
    order.reset()
    assert order(again) is again


@pytest.mark.parametrize("seed", range(20))
def test_random_hiccups_lose_no_more_than_they_are(seed):
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, 1000, 20_000))
    wrong = rng.choice(20_000, 15, replace=False)
    hiccups = times.copy()
    hiccups[wrong] -= 10.0 ** rng.uniform(-2, 4, 15)
    kept, left_out = sifted(hiccups, int(rng.integers(100, 20_000)))
    assert left_out <= 15
    assert set(range(20_000)) - set(kept) <= set(wrong.tolist())


def test_events_settle_once_later_ones_cannot_show_that_they_are_too_late():
    order = EventOrder()
    assert order.settled(stream(REGULAR).t) == 950
    times = REGULAR.copy()
    times[-20:] += 2000  # too late, or behind a pause: what follows will show
    assert order.settled(stream(times).t) == 980
    order(stream(REGULAR[:500]))
    assert order.settled(stream(REGULAR[:100]).t[:90]) == 0


def test_gaps_say_when_events_were_left_out():
    order = EventOrder()
    times = REGULAR.copy()
    times[[100, 700]] = 5
    order(stream(times))
    assert order.gaps.tolist() == [99 * MS, 699 * MS]
    order(stream(REGULAR + 1000))
    assert (len(order.gaps), order.left_out) == (0, 2)
