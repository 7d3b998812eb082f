"""Words written by hand from the formats' descriptions, and what they mean."""

import numpy as np
import pytest

from emoflow_ros.core.types.events import Events
from msg_adapters.encodings import evt2, evt3, evt21, libcaer, libcaer_cmp, mono
from msg_adapters.message import Statistics


class Stream:
    """One stream of packets of words."""

    def __init__(self, module, word: str) -> None:
        self.statistics = Statistics()
        self.decoder = module.PacketDecoder(self.statistics)
        self.word = word

    def __call__(self, *words: int, time_base: int = 0) -> list[tuple[int, int, int, int]]:
        """Decode one packet to (x, y, t in us, p)."""
        payload = memoryview(np.array(words, self.word).tobytes())
        events: Events = self.decoder.decode(payload, False, time_base)
        t, rest = np.divmod(events.t, 1000)
        assert not rest.any()
        columns = (events.x, events.y, t, events.p.astype(int))
        return list(zip(*(column.tolist() for column in columns), strict=True))


TIME = (0x8001, 0x6234)  # 0x1234 us


@pytest.fixture
def evt3_stream() -> Stream:
    return Stream(evt3, "<u2")


def test_evt3_single_events(evt3_stream):
    assert evt3_stream(*TIME, 0x0010, 0x2005, 0x2806, 0x6235, 0x2007) == [
        (5, 16, 0x1234, 0),
        (6, 16, 0x1234, 1),
        (7, 16, 0x1235, 0),
    ]


def test_evt3_row_of_the_second_camera_is_the_same_row(evt3_stream):
    assert evt3_stream(*TIME, 0x0810, 0x2005) == [(5, 16, 0x1234, 0)]


def test_evt3_vectors_advance_the_base(evt3_stream):
    decoded = evt3_stream(*TIME, 0x0001, 0x3864, 0x4801, 0x4002, 0x5081, 0x5F01)
    assert [x for x, *_ in decoded] == [100, 111, 113, 124, 131, 132]
    assert {(y, t, p) for _, y, t, p in decoded} == {(1, 0x1234, 1)}


def test_evt3_state_holds_across_packets(evt3_stream):
    assert evt3_stream(*TIME, 0x0010, 0x3064, 0x4001) == [(100, 16, 0x1234, 0)]
    assert evt3_stream(0x4001) == [(112, 16, 0x1234, 0)]  # the vector's second word
    assert evt3_stream(0x6240, 0x2005) == [(5, 16, 0x1240, 0)]


@pytest.mark.parametrize(
    "words",
    [
        pytest.param((0x0010, 0x2005), id="no time"),
        pytest.param((0x8001, 0x0010, 0x2005), id="no low time"),
        pytest.param((0x6234, 0x0010, 0x2005), id="no high time"),
        pytest.param((0x6234, 0x8001, 0x0010, 0x2005), id="low time of an older high time"),
        pytest.param((*TIME, 0x2005), id="no row"),
        pytest.param((*TIME, 0x0010, 0x5001), id="no base of the vector"),
    ],
)
def test_evt3_starts_mid_stream(evt3_stream, words):
    assert evt3_stream(*words) == []
    assert evt3_stream.statistics.skipped == 1
    assert evt3_stream(*TIME, 0x0010, 0x2005) == [(5, 16, 0x1234, 0)]


def test_evt3_padding_and_monitoring_words_mean_nothing(evt3_stream):
    others = (0x9999, 0x7777, 0xE019, 0x7001, 0xF123)
    assert evt3_stream(*others, *TIME, *others, 0x0010, *others, 0x2005) == [(5, 16, 0x1234, 0)]
    assert evt3_stream.statistics.skipped == 0


def test_evt3_unknown_words_are_counted(evt3_stream):
    evt3_stream(0x1000, 0xB000, 0xC000, 0xD000)
    assert evt3_stream.statistics.skipped == 4


def test_evt3_triggers_are_counted(evt3_stream):
    assert evt3_stream(*TIME, 0xA001, 0xA100) == []
    assert evt3_stream.statistics.triggers == 2


def test_evt3_time_wraps(evt3_stream):
    assert evt3_stream(0x8FFF, 0x6FFF, 0x0000, 0x2000) == [(0, 0, (1 << 24) - 1, 0)]
    assert evt3_stream(0x8000, 0x6002, 0x2000) == [(0, 0, (1 << 24) + 2, 0)]
    assert evt3_stream.statistics.time_wraps == 1


def test_evt3_high_time_that_steps_back_a_little_has_not_wrapped(evt3_stream):
    evt3_stream(0x8010, 0x6000, 0x0000)
    assert evt3_stream(0x800F, 0x6FFF, 0x2000) == [(0, 0, 0xFFFF, 0)]
    assert evt3_stream.statistics.time_wraps == 0


@pytest.mark.parametrize("counts", [1, 9, 11, 250, 2000])
def test_evt3_high_time_of_an_earlier_moment_shifts_nothing_behind_it(evt3_stream, counts):
    """A time of up to 8 s before is no wrap: later events would be 16.8 s too late."""
    later = 0x8000 | 0xA00
    assert evt3_stream(later, 0x6000, 0x0000, 0x2000) == [(0, 0, 0xA00 << 12, 0)]
    assert evt3_stream(later - counts, 0x2000) == [(0, 0, (0xA00 - counts) << 12, 0)]
    assert evt3_stream(later, 0x6001, 0x2000) == [(0, 0, (0xA00 << 12) + 1, 0)]
    assert evt3_stream.statistics.time_wraps == 0


def test_evt3_high_time_that_steps_back_over_the_wrap_counts_it_once(evt3_stream):
    evt3_stream(0x8FFF, 0x6000, 0x0000, 0x8000)
    assert evt3_stream(0x8FFE, 0x2000) == [(0, 0, 0xFFE << 12, 0)]
    assert evt3_stream(0x8001, 0x2000) == [(0, 0, (1 << 24) + 0x1000, 0)]
    assert evt3_stream.statistics.time_wraps == 1


def test_evt3_after_a_gap_any_earlier_time_is_a_wrap(evt3_stream):
    evt3_stream(0x8A00, 0x6000, 0x0000)
    evt3_stream.decoder.resync()
    assert evt3_stream(0x8900, 0x6000, 0x0000, 0x2000) == [(0, 0, (1 << 24) + (0x900 << 12), 0)]
    assert evt3_stream.statistics.time_wraps == 1


def test_evt3_vectors_beyond_the_row_stay_outside(evt3_stream):
    decoded = evt3_stream(*TIME, 0x0000, 0x37FF, *([0x4FFF] * 6000))
    assert len(decoded) == 72_000
    assert min(x for x, *_ in decoded) == 2047


def test_libcaer_cmp_words():
    stream = Stream(libcaer_cmp, "<u2")
    words = (0x2007, 0x3805, 0x1234, 0x3006, 0x0001, 0x3007, 0x2008, 0x4810, 0x5003, 0x5001)
    assert stream(*words, time_base=5_000_000) == [
        (7, 5, 5000, 1),
        (7, 6, 5000 + 0x234, 0),
        (7, 7, 5000 + 0x1234, 0),
        (8, 16, 5000 + 0x1234, 1),
        (8, 17, 5000 + 0x1234, 1),
        (8, 24, 5000 + 0x1234, 1),
    ]


def test_libcaer_cmp_packets_stand_alone():
    stream = Stream(libcaer_cmp, "<u2")
    stream(0x2007, 0x4010)
    assert stream(0x3805, 0x5001, 0x9999) == []
    assert stream.statistics.skipped == 3


def test_libcaer_words():
    stream = Stream(libcaer, "<u4")
    on = 300 << 17 | 200 << 2 | 1 << 1 | 1
    assert stream(on, 10, on - 2, 11, time_base=7000) == [(300, 200, 17, 1), (300, 200, 18, 0)]


def test_libcaer_rolls_over_inside_a_packet():
    stream = Stream(libcaer, "<u4")
    decoded = stream(1, 0x7FFFFFFF, 1, 0, 1, 5, time_base=1000)
    assert [t for _, _, t, _ in decoded] == [1 << 31, (1 << 31) + 1, (1 << 31) + 6]
    # The driver's next time_base holds the roll-over already.
    decoded = stream(1, 9, time_base=1000 + (1 << 31) * 1000)
    assert [t for _, _, t, _ in decoded] == [(1 << 31) + 10]
    assert stream.statistics.time_wraps == 1


def test_libcaer_may_roll_over_many_times_inside_a_packet():
    stream = Stream(libcaer, "<u4")
    pairs = 10_000
    decoded = stream(*[1, 0x7FFFFFFF, 1, 0] * pairs)
    expected = [(k << 31) + us for k in range(pairs) for us in (0x7FFFFFFF, 1 << 31)]
    assert [t for _, _, t, _ in decoded] == expected
    assert stream.statistics.time_wraps == pairs


def test_mono_words():
    stream = Stream(mono, "<u8")
    assert stream(1 << 63 | 200 << 48 | 300 << 32 | 4_000_000_000, time_base=1000) == [
        (300, 200, 4_000_001, 1)
    ]


def test_evt2_words():
    stream = Stream(evt2, "<u4")
    event = 0x21 << 22 | 300 << 11 | 200
    assert stream(event, 0x80000002, event, 1 << 28 | event, 0xA0000001, 0xE0000019) == [
        (300, 200, 2 << 6 | 0x21, 0),
        (300, 200, 2 << 6 | 0x21, 1),
    ]
    assert (stream.statistics.skipped, stream.statistics.triggers) == (1, 1)
    assert stream(event) == [(300, 200, 2 << 6 | 0x21, 0)]


EVT21_TIME = 0x8 << 60 | 2 << 32
EVT21_VECTOR = 1 << 60 | 0x21 << 54 | 64 << 43 | 200 << 32 | 0x80000005
EVT21_EVENTS = [(x, 200, 2 << 6 | 0x21, 1) for x in (64, 66, 95)]


def test_evt21_words():
    stream = Stream(evt21, "<u8")
    assert stream(EVT21_VECTOR, EVT21_TIME, EVT21_VECTOR, 0xA << 60) == EVT21_EVENTS
    assert (stream.statistics.skipped, stream.statistics.triggers) == (3, 1)


def test_evt21_with_the_upper_half_first():
    stream = Stream(evt21, "<u8")
    words = [word >> 32 | (word & 0xFFFFFFFF) << 32 for word in (EVT21_TIME, EVT21_VECTOR)]
    assert stream(*words) == EVT21_EVENTS
    assert stream(words[1]) == EVT21_EVENTS
    stream.decoder.reset()
    assert stream(EVT21_TIME, EVT21_VECTOR) == EVT21_EVENTS
