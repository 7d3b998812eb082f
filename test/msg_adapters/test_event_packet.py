import numpy as np
import pytest
from encoders import COUNT_FROM_TIME_BASE, ENCODERS, assert_equal, payload, synthetic
from messages import event_packet

from emoflow_ros.core.types.events import Events
from msg_adapters import DecodeError, make_decoder
from msg_adapters.message import Decoder

TYPE = "event_camera_msgs/msg/EventPacket"
MINUTE_US = 60_000_000

every_encoding = pytest.mark.parametrize("encoding", ENCODERS)


def packets(
    events: Events, encoding: str, length: int, serialization: str = "cdr", big_endian: bool = False
) -> list[bytes]:
    """The events as messages of `length` events."""
    messages = []
    for seq, first in enumerate(range(0, len(events), length)):
        part = events[first : first + length]
        time_base = int(part.t[0]) if encoding in COUNT_FROM_TIME_BASE else 0
        words = ENCODERS[encoding](part, time_base)
        messages.append(
            event_packet(
                payload(words, big_endian),
                encoding,
                serialization,
                seq=seq,
                time_base=time_base,
                big_endian=big_endian,
            )
        )
    return messages


def decode_all(messages: list[bytes], serialization: str = "cdr") -> tuple[Events, Decoder]:
    decoder = make_decoder(TYPE, serialization)
    return Events.concatenate([decoder.decode(data).events for data in messages]), decoder


@every_encoding
@pytest.mark.parametrize("big_endian", [False, True])
def test_same_stream_through_every_encoder(rng, serialization, encoding, big_endian):
    events = synthetic(rng, 3000)
    messages = packets(events, encoding, 700, serialization, big_endian)
    decoded, decoder = decode_all(messages, serialization)
    assert_equal(decoded, events)
    statistics = decoder.statistics
    assert (statistics.messages, statistics.events) == (5, 3000)
    assert statistics.encoding == encoding
    assert statistics.skipped == statistics.seq_gaps == statistics.dropped_outside == 0


@every_encoding
@pytest.mark.parametrize("big_endian", [False, True])
def test_first_part_of_a_packet_and_then_the_next_one(rng, serialization, encoding, big_endian):
    events = synthetic(rng, 900)
    first, second, third = packets(events, encoding, 300, serialization, big_endian)
    decoder = make_decoder(TYPE, serialization)
    assert_equal(decoder.decode(first).events, events[:300])
    for data, begin in ((second, 300), (third, 600)):
        part = decoder.decode(data, 4).events
        assert 40 <= len(part) <= 110  # a quarter of the bytes
        assert_equal(part, events[begin : begin + len(part)])
    assert decoder.statistics.seq_gaps == 0


@every_encoding
def test_part_of_a_packet_of_a_few_bytes_is_no_event_and_no_error(rng, encoding):
    [data] = packets(synthetic(rng, 1), encoding, 1)
    assert len(make_decoder(TYPE, "cdr").decode(data, 16).events) == 0


@every_encoding
def test_empty_packet(encoding):
    decoded, _ = decode_all([event_packet(b"", encoding)])
    assert_equal(decoded, Events.empty())


@every_encoding
def test_incomplete_word_at_the_end_is_skipped(rng, encoding):
    events = synthetic(rng, 20)
    time_base = int(events.t[0]) if encoding in COUNT_FROM_TIME_BASE else 0
    data = payload(ENCODERS[encoding](events, time_base)) + b"\x01"
    decoded, decoder = decode_all([event_packet(data, encoding, time_base=time_base)])
    assert_equal(decoded, events)
    assert decoder.statistics.skipped == 1


@every_encoding
def test_30_minutes_across_every_wrap(rng, encoding):
    """24 bits wrap over 100 times, 31 and 34 bits once, and no microsecond is lost."""
    near_wrap = {"libcaer": 1 << 31, "evt2": 1 << 34, "evt21": 1 << 34}.get(encoding, 1 << 24)
    start = max(near_wrap - 15 * MINUTE_US, 0)
    t = start + np.cumsum(rng.integers(0, 40_000, 90_000))
    assert t[-1] - t[0] > 29 * MINUTE_US
    zeros = np.zeros(len(t), np.uint16)
    events = Events(zeros + np.uint16(3), zeros, t * 1000, rng.random(len(t)) < 0.5)
    length = 150  # 3 s: 32 bits of nanoseconds must do for `mono`
    if encoding == "libcaer":  # one time_base, as where the driver never saw the wrap
        words = ENCODERS[encoding](events, 0).reshape(-1, 2)
        messages = [
            event_packet(words[i : i + length].tobytes(), encoding, seq=i // length)
            for i in range(0, len(words), length)
        ]
    else:
        messages = packets(events, encoding, length)
    decoded, decoder = decode_all(messages)
    shift = int(decoded.t[0] - events.t[0])  # whole wraps before the start are unknowable
    np.testing.assert_array_equal(decoded.t - shift, events.t)
    assert shift == 0
    expected = {"evt3": 107, "libcaer": 1, "evt2": 1, "evt21": 1}.get(encoding, 0)
    assert decoder.statistics.time_wraps == expected


@pytest.mark.parametrize("encoding", ["evt3", "evt2", "evt21"])
def test_lost_packets_are_counted_and_time_waited_for(rng, encoding):
    events = synthetic(rng, 400)
    first, _, _, fourth = packets(events, encoding, 100)
    words = ENCODERS[encoding](events[200:300], 0)
    kind = words >> (8 * words.itemsize - 4)
    without_time = words[~np.isin(kind, [6, 8])]
    third = event_packet(payload(without_time), encoding, seq=2)
    decoded, decoder = decode_all([first, third, fourth])
    assert_equal(decoded, Events.concatenate([events[:100], events[300:]]))
    assert decoder.statistics.seq_gaps == 1
    assert decoder.statistics.skipped == 100


@pytest.mark.parametrize("encoding", ["evt3", "evt2", "evt21"])
def test_packets_left_out_by_the_caller_are_not_counted_and_time_is_waited_for(rng, encoding):
    events = synthetic(rng, 400)
    first, _, _, fourth = packets(events, encoding, 100)
    words = ENCODERS[encoding](events[200:300], 0)
    kind = words >> (8 * words.itemsize - 4)
    third = event_packet(payload(words[~np.isin(kind, [6, 8])]), encoding, seq=2)
    decoder = make_decoder(TYPE, "cdr")
    assert_equal(decoder.decode(first).events, events[:100])
    decoder.resync(1)
    assert len(decoder.decode(third).events) == 0
    assert_equal(decoder.decode(fourth).events, events[300:])
    assert decoder.statistics.seq_gaps == 0
    assert decoder.statistics.skipped == 100


@pytest.mark.parametrize("encoding", ["evt3", "evt2", "evt21"])
def test_lost_packets_keep_counting_wraps(encoding):
    wrap = {"evt3": 1 << 24}.get(encoding, 1 << 34)
    zeros = np.zeros(3, np.uint16)
    t = np.array([wrap - 5_000_000, wrap + 1_000_000, wrap + 2_000_000]) * 1000
    events = Events(zeros, zeros, t, zeros > 0)
    before, _, after = packets(events, encoding, 1)
    decoded, _ = decode_all([before, after])
    assert (decoded.t[1] - decoded.t[0]) == 7_000_000_000


@every_encoding
def test_restarted_publisher_starts_anew(rng, encoding):
    events = synthetic(rng, 300)
    messages = packets(events, encoding, 100)
    decoded, decoder = decode_all(messages + messages)
    assert_equal(decoded, Events.concatenate([events, events]))
    assert decoder.statistics.seq_gaps == 0
    assert decoder.statistics.time_wraps == 0


@every_encoding
def test_reset_forgets_time(rng, encoding):
    events = synthetic(rng, 300)
    messages = packets(events, encoding, 100)
    decoder = make_decoder(TYPE, "cdr")
    decoder.decode(messages[2])
    decoder.reset()
    assert_equal(decoder.decode(messages[0]).events, events[:100])
    assert decoder.statistics.messages == 2


def test_publisher_without_numbers(rng):
    events = synthetic(rng, 200)
    messages = [
        event_packet(payload(ENCODERS["evt3"](e)), "evt3") for e in (events[:100], events[100:])
    ]
    decoded, decoder = decode_all(messages)
    assert_equal(decoded, events)
    assert decoder.statistics.seq_gaps == 0


def test_number_and_header_come_back():
    data = event_packet(b"", "mono", seq=1 << 40, size=(640, 480), frame_id="cam")
    message = make_decoder(TYPE, "cdr").decode(data)
    assert message.seq == 1 << 40
    assert (message.width, message.height, message.frame_id) == (640, 480, "cam")


@every_encoding
def test_events_outside_are_dropped_and_counted(rng, encoding):
    events = synthetic(rng, 300)
    time_base = int(events.t[0]) if encoding in COUNT_FROM_TIME_BASE else 0
    words = ENCODERS[encoding](events, time_base)
    data = event_packet(payload(words), encoding, time_base=time_base, size=(100, 100))
    message = make_decoder(TYPE, "cdr").decode(data)
    inside = (events.x < 100) & (events.y < 100)
    assert_equal(message.events, events[inside])
    assert message.dropped_outside == np.count_nonzero(~inside) > 0


def test_encoding_may_change_mid_stream(rng):
    events = synthetic(rng, 200)
    first, _ = packets(events, "evt3", 100)
    _, second = packets(events, "evt21", 100)
    decoded, _ = decode_all([first, second])
    assert_equal(decoded, events)


def test_unknown_encoding_lists_the_known_ones():
    with pytest.raises(DecodeError, match=r"'h264': known are evt2, evt21, evt3, libcaer, .*mono"):
        decode_all([event_packet(b"", "h264")])


def test_time_base_beyond_64_bits_is_refused():
    with pytest.raises(DecodeError, match="time_base 18446744073709551615"):
        decode_all([event_packet(bytes(8), "mono", time_base=(1 << 64) - 1)])


def test_every_truncation_is_refused(rng, serialization):
    (data,) = packets(synthetic(rng, 5), "evt3", 5, serialization)
    decoder = make_decoder(TYPE, serialization)
    for length in range(len(data)):
        with pytest.raises(DecodeError):
            decoder.decode(data[:length])


def test_layout_of_fast_cdr(rng):
    serialization = pytest.importorskip("rclpy.serialization", reason="rclpy is not installed")
    messages = pytest.importorskip("event_camera_msgs.msg", reason="event_camera_msgs is not built")
    events = synthetic(rng, 100)
    packet = messages.EventPacket(width=346, height=260, seq=9, time_base=7, encoding="evt3")
    packet.events = payload(ENCODERS["evt3"](events))
    message = make_decoder(TYPE, "cdr").decode(serialization.serialize_message(packet))
    assert_equal(message.events, events)
    assert message.seq == 9
