import numpy as np
import pytest
from encoders import assert_equal, synthetic
from messages import PACKAGES, event_array

from emoflow_ros.core.types.events import Events
from msg_adapters import DecodeError, make_decoder, supported_types


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("frame_id", ["", "c", "ca", "cam", "came", "camer"])
def test_events_and_header_come_back(rng, serialization, package, frame_id):
    events = synthetic(rng, 50, start_us=1_700_000_000_000_000)
    data = event_array(
        events, serialization, package=package, stamp=5_000_000_006, frame_id=frame_id
    )
    message = make_decoder(f"{package}/msg/EventArray", serialization).decode(data)
    assert_equal(message.events, events)
    assert (message.width, message.height) == (346, 260)
    assert message.stamp == 5_000_000_006
    assert message.frame_id == frame_id
    assert message.seq is None
    assert message.dropped_outside == 0


def test_big_endian_cdr(rng):
    events = synthetic(rng, 50)
    data = event_array(events, "cdr", little_endian=False)
    assert_equal(make_decoder("dvs_msgs/msg/EventArray", "cdr").decode(data).events, events)


def test_layout_of_fast_cdr(rng):
    serialization = pytest.importorskip("rclpy.serialization", reason="rclpy is not installed")
    messages = pytest.importorskip("dvs_msgs.msg", reason="dvs_msgs is not built")
    events = synthetic(rng, 50)
    array = messages.EventArray(width=346, height=260)
    array.header.frame_id = "davis"
    for i in range(len(events)):
        event = messages.Event(x=int(events.x[i]), y=int(events.y[i]), polarity=bool(events.p[i]))
        event.ts.sec, event.ts.nanosec = divmod(int(events.t[i]), 1_000_000_000)
        array.events.append(event)
    data = serialization.serialize_message(array)
    message = make_decoder("dvs_msgs/msg/EventArray", "cdr").decode(data)
    assert_equal(message.events, events)
    assert message.frame_id == "davis"


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_events(rng, serialization, count):
    events = synthetic(rng, count)
    data = event_array(events, serialization)
    assert_equal(make_decoder("dvs_msgs/EventArray", serialization).decode(data).events, events)


def test_any_buffer_and_any_offset(rng, serialization):
    events = synthetic(rng, 20)
    data = event_array(events, serialization)
    decoder = make_decoder("dvs_msgs/EventArray", serialization)
    for offset in range(8):
        shifted = memoryview(bytes(offset) + data)[offset:]
        assert_equal(decoder.decode(shifted).events, events)
        assert_equal(decoder.decode(np.frombuffer(shifted, np.uint8)).events, events)


@pytest.mark.parametrize(("count", "part", "expected"), [(20, 4, 5), (21, 4, 6), (1, 16, 1)])
def test_first_part_of_a_message(rng, serialization, count, part, expected):
    events = synthetic(rng, count)
    decoder = make_decoder("dvs_msgs/EventArray", serialization)
    found = decoder.decode(event_array(events, serialization), part)
    assert_equal(found.events, events[:expected])
    assert decoder.statistics.events == expected


def test_decoded_arrays_do_not_view_the_message(rng, serialization):
    data = bytearray(event_array(synthetic(rng, 20), serialization))
    message = make_decoder("dvs_msgs/EventArray", serialization).decode(data)
    before = message.events.x.copy(), message.events.p.copy()
    data[:] = bytes(len(data))
    np.testing.assert_array_equal(message.events.x, before[0])
    np.testing.assert_array_equal(message.events.p, before[1])


def test_events_outside_are_dropped_and_counted(rng, serialization):
    events = synthetic(rng, 100)
    decoder = make_decoder("dvs_msgs/EventArray", serialization)
    message = decoder.decode(event_array(events, serialization, size=(200, 100)))
    inside = (events.x < 200) & (events.y < 100)
    assert_equal(message.events, events[inside])
    assert message.dropped_outside == np.count_nonzero(~inside) > 0
    assert decoder.statistics.dropped_outside == message.dropped_outside


def test_unknown_size_accepts_all_events(rng, serialization):
    events = synthetic(rng, 100)
    decoder = make_decoder("dvs_msgs/EventArray", serialization)
    message = decoder.decode(event_array(events, serialization, size=(0, 0)))
    assert len(message.events) == 100
    assert message.dropped_outside == 0


def test_every_truncation_is_refused(rng, serialization):
    data = event_array(synthetic(rng, 5), serialization)
    decoder = make_decoder("dvs_msgs/EventArray", serialization)
    for length in range(len(data)):
        with pytest.raises(DecodeError):
            decoder.decode(data[:length])


def test_left_over_bytes_are_refused(rng, serialization):
    data = event_array(synthetic(rng, 5), serialization)
    with pytest.raises(DecodeError, match="16 bytes left over"):
        make_decoder("dvs_msgs/EventArray", serialization).decode(data + bytes(16))


def test_announced_events_need_their_bytes():
    data = event_array(Events.empty(), "cdr")
    huge = data[:-4] + b"\xff\xff\xff\xff"
    with pytest.raises(DecodeError, match="4294967295 events announced in 0 bytes"):
        make_decoder("dvs_msgs/EventArray", "cdr").decode(huge)


def test_unknown_encapsulation_is_named():
    with pytest.raises(DecodeError, match="encapsulation 0x0006"):
        make_decoder("dvs_msgs/EventArray", "cdr").decode(b"\0\6\0\0" + bytes(40))


def test_unknown_type_lists_the_known_ones():
    with pytest.raises(DecodeError, match=r"'std_msgs/msg/String'.*dvs_msgs/msg/EventArray"):
        make_decoder("std_msgs/msg/String", "cdr")
    assert len(supported_types()) == 7


def test_unknown_serialisation_is_named():
    with pytest.raises(DecodeError, match="'xml'"):
        make_decoder("dvs_msgs/EventArray", "xml")
