"""The unit of a column of times, as its values and their rate tell it."""

from pathlib import Path

import numpy as np
import pytest
from column_files import ARRAY_WRITERS, steady_events, write_text

from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.time_units import MS, NS, US, Clues, S, tell_unit

RATE = 100_000  # events/s
TIMES = np.arange(3000) / RATE + 0.25  # s


@pytest.mark.parametrize(
    ("unit", "t", "more"),
    [
        (S, TIMES, {}),
        (S, TIMES + 1.7e9, {}),
        (US, TIMES * 1e6, {}),
        (US, np.rint(TIMES * 1e6 + 1).astype(np.uint32), {}),
        (US, np.rint(TIMES * 1e6).astype(np.int64) + 1_700_000_000_000_000, {}),
        (US, TIMES * 1e6 + 1.7e15, {}),
        (NS, np.rint(TIMES * 1e9).astype(np.int64) + 1_700_000_000_000_000_000, {}),
        (NS, TIMES * 1e9 + 1.7e18, {}),
        (NS, np.rint(TIMES * 1e6).astype(np.int64) * 1000, {}),
        (NS, np.rint(np.linspace(0, 5e9 + 7, 3000)).astype(np.int64), {}),
        # Decided by the index of milliseconds, from the first event on and from zero on.
        (NS, np.rint(TIMES * 1e9).astype(np.int64) + 7, {"milliseconds": 30}),
        (US, np.rint(TIMES * 1e6).astype(np.int64) // 1000 * 1000, {"milliseconds": 280}),
        (US, np.rint(TIMES[:30] * 1e6).astype(np.int64) + 10**15, {"milliseconds": 2}),
        (S, TIMES / 100, {"milliseconds": 1}),
        # A simulator's milliseconds, in microseconds: 4e7 events per second as nanoseconds.
        (US, np.repeat(np.arange(30) * 1000, 40), {}),
        # Those of 1000 events per second, and more than an hour: 32 bits hold no nanoseconds.
        (US, (np.arange(3000) * 1000).astype(np.uint32), {}),
        (US, np.linspace(0, 4e9, 5_000_000)[::1000].astype(np.uint32), {"count": 5_000_000}),
        # Declared, against what else would count.
        (MS, TIMES * 1e3, {"declared": "ms"}),
        (NS, TIMES, {"declared": "Nanoseconds"}),
    ],
)
def test_unit_of_time(unit, t, more):
    count, index = more.get("count", len(t)), more.get("milliseconds", 0)
    assert tell_unit(Clues(Path("a"), t, count, more.get("declared", ""), index)) == unit


@pytest.mark.parametrize("kind", [*ARRAY_WRITERS, "text"])
@pytest.mark.parametrize(
    ("at", "shift_s", "fits"), [(0, -1, True), (0, 1, False), (-1, -1, False), (-1, 1, True)]
)
def test_an_end_of_another_time_does_not_decide(tmp_path, kind, at, shift_s, fits):
    """3000 events within 9 ms, in milliseconds: with that second they would be seconds."""
    events = steady_events(3000)
    events.t[at] += shift_s * 1_000_000_000
    if kind == "text":
        path = write_text(tmp_path / "a.txt", events, unit="ms")
    else:
        path = ARRAY_WRITERS[kind](tmp_path, events, events.t / 1e6)
    with open_recording(path) as recording:
        read = np.concatenate([chunk.t for chunk in recording.event_chunks()])
    np.testing.assert_array_equal(read, events.t if fits else np.delete(events.t, at))


def test_a_unit_that_nothing_decides():
    """3000 events in 2e10 ticks, no thousands: five and a half hours, or 20 s."""
    t = np.sort(np.random.default_rng(0).integers(0, 2 * 10**9, 3000))
    with pytest.raises(InputError) as error:
        tell_unit(Clues(Path("a"), t.astype(np.int32), 3000))
    assert str(error.value) == (
        "a: the unit of t cannot be told: 3000 events are 1.5 events per second in microseconds, "
        "0.0015 events per second in milliseconds; say which unit t has with --time-unit s, ms, us "
        "or ns"
    )
    with pytest.raises(InputError, match="a: t has the unknown unit 'ticks'"):
        tell_unit(Clues(Path("a"), t, 3000, "ticks"))


@pytest.mark.parametrize("rate", [2e4, 1.3e5, 9e5, 7e6])
@pytest.mark.parametrize(
    ("unit", "tick_ns", "dtype"),
    [
        (S, 1000, float),
        (US, 1000, np.int64),
        (US, 1000, np.uint32),
        (US, 1000, float),
        (US, 1, float),
        (NS, 1000, np.int64),
    ],
)
def test_units_at_the_rates_of_event_cameras(rate, unit, tick_ns, dtype):
    assert tell_unit(Clues(Path("a"), column(rate, unit, tick_ns, dtype), 200_000)) == unit


def test_whole_nanoseconds_are_no_slow_microseconds():
    assert tell_unit(Clues(Path("a"), column(9e5, NS, 1, np.int64), 200_000)) == NS
    assert tell_unit(Clues(Path("a"), column(3e3, US, 1000, np.int64), 200_000)) == US


@pytest.mark.parametrize("rate", [1.1e5, 3e5, 9e5])
@pytest.mark.parametrize(("tick_ns", "dtype"), [(1000, float), (1, float), (10**6, np.int64)])
def test_milliseconds(rate, tick_ns, dtype):
    assert tell_unit(Clues(Path("a"), column(rate, MS, tick_ns, dtype), 200_000)) == MS


@pytest.mark.parametrize(
    ("rate", "unit", "rival"), [(3e6, MS, "milliseconds"), (3e3, S, "milliseconds")]
)
def test_decimals_that_are_slow_seconds_or_fast_milliseconds_are_refused(rate, unit, rival):
    with pytest.raises(InputError) as error:
        tell_unit(Clues(Path("a"), column(rate, unit, 1, float), 200_000))
    line = str(error.value)
    assert "200000 events are 3000 events per second in seconds, " in line
    assert f"3 million events per second in {rival}; say which" in line


def test_the_formats_unit_counts_where_it_is_plausible():
    slow = column(3e3, S, 1000, float)
    assert tell_unit(Clues(Path("a"), slow, 200_000, of_format=S)) == S
    fast = column(3e5, US, 1, float)
    assert tell_unit(Clues(Path("a"), fast, 200_000, of_format=S)) == US


def test_few_events_have_the_customary_unit():
    for t, unit in (
        ([0.0, 0.001], S), ([0.1, 0.2, 0.3], S), ([0, 1_000_000], US), ([5e10, 5e10 + 12], US),
        ([0.1, 3600.2], US),
    ):  # fmt: skip
        assert tell_unit(Clues(Path("a"), np.array(t), len(t))) == unit
    for same in ([7, 7], [7.5]):
        assert tell_unit(Clues(Path("a"), np.array(same), len(same))) == (US if 7 in same else S)


def test_what_is_told_is_said_unless_it_is_customary(capsys):
    for unit, dtype in ((S, float), (US, np.int64)):
        tell_unit(Clues(Path("a"), column(3e5, unit, 1000, dtype), 200_000))
    assert capsys.readouterr().err == ""
    tell_unit(Clues(Path("a"), column(2e5, MS, 1000, float)[:-1], 200_000))
    assert capsys.readouterr().err == (
        "a: t is taken as milliseconds, 200000 events per second; --time-unit says otherwise\n"
    )


def column(rate, unit, tick_ns, dtype):
    """Times of 200 000 events at a steady rate, in ticks of the sensor's clock."""
    ns = 7_000_000 + np.arange(200_000) * (10**9 / rate)
    return (np.floor(ns / tick_ns) * tick_ns / unit).astype(dtype)
