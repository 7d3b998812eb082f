"""Any bytes give events or a DecodeError, in bounded memory, and the decoder works on."""

from functools import cache

import numpy as np
import pytest
from encoders import COUNT_FROM_TIME_BASE, ENCODERS, assert_equal, payload, synthetic
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from limits import EVENTS_PER_BYTE, decode_within_limits
from messages import event_array, event_packet, point_cloud

from emoflow_ros.core.types.events import Events
from msg_adapters import EventMessage, make_decoder
from msg_adapters.message import Decoder

PACKET = "event_camera_msgs/msg/EventPacket"
BYTES_PER_EVENT = 13
EVENTS = 100_000

# The number of examples is the profile's: 100 unless conftest.py's `fuzz` is chosen.
any_input = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


@cache
def valid(kind: str, serialization: str) -> tuple[str, bytes, Events]:
    """A ROS type, a valid message of it, and its events."""
    events = synthetic(np.random.default_rng(3), 60)
    if kind == "event_array":
        return "dvs_msgs/msg/EventArray", event_array(events, serialization), events
    if kind == "point_cloud":
        points = np.zeros(60, [("x", "<f4"), ("y", "<u2"), ("t", "<f8"), ("p", "i1")])
        points["x"], points["y"], points["t"], points["p"] = (
            events.x,
            events.y,
            events.t / 1e9,
            events.p,
        )
        return "sensor_msgs/msg/PointCloud2", point_cloud(points, serialization), events
    time_base = int(events.t[0]) if kind in COUNT_FROM_TIME_BASE else 0
    data = payload(ENCODERS[kind](events, time_base))
    message = event_packet(data, kind, serialization, time_base=time_base)
    return PACKET, message, events


def check(decoder: Decoder, kind: str, data: bytes) -> EventMessage | None:
    """Decode, and check what must hold for any bytes."""
    message = decode_within_limits(decoder, kind, data)
    if message is None:
        return None
    events = message.events
    assert len(events.x) == len(events.y) == len(events.t) == len(events.p)
    if message.width and message.height:
        assert events.inside(message.width, message.height).all()
    return message


every_kind = pytest.mark.parametrize("kind", ["event_array", "point_cloud", *ENCODERS])


@every_kind
@any_input
@given(data=st.binary(max_size=300))
@example(data=b"")
@example(data=b"\0\1\0\0")
def test_arbitrary_bytes(kind, serialization, data):
    ros_type, message, events = valid(kind, serialization)
    decoder = make_decoder(ros_type, serialization)
    check(decoder, kind, data)
    check(decoder, kind, b"\0\1\0\0" + data)
    decoder.reset()
    assert_equal(decoder.decode(message).events, events)


@every_kind
@any_input
@given(data=st.data())
def test_mutated_messages(kind, serialization, data):
    ros_type, message, events = valid(kind, serialization)
    mutated = bytearray(message)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(mutated) - 1))
        mutated[at] = data.draw(st.integers(0, 255))
    length = data.draw(st.integers(len(mutated) - 20, len(mutated)))
    decoder = make_decoder(ros_type, serialization)
    check(decoder, kind, bytes(mutated[:length]))
    decoder.reset()
    assert_equal(decoder.decode(message).events, events)


@pytest.mark.parametrize("encoding", ENCODERS)
@any_input
@given(payloads=st.lists(st.binary(max_size=400), max_size=4), big_endian=st.booleans())
def test_arbitrary_payloads(encoding, payloads, big_endian):
    decoder = make_decoder(PACKET, "cdr")
    for seq, data in enumerate(payloads):
        message = event_packet(
            data, encoding, seq=seq, size=(0, 0), time_base=1 << 60, big_endian=big_endian
        )
        assert check(decoder, encoding, message) is not None


@pytest.mark.parametrize("kind", ["evt3", "evt21"])
def test_vectors_allocate_no_more_than_their_events(kind):
    words = {"evt3": [0x8000, 0x6000, 0, 0x3000], "evt21": [0x8 << 60]}[kind]
    words += [{"evt3": 0x4000, "evt21": 0x0}[kind]] * 100_000  # vectors without events
    words += [{"evt3": 0x2000, "evt21": 0x1}[kind]]
    data = event_packet(np.array(words, {"evt3": "<u2", "evt21": "<u8"}[kind]).tobytes(), kind)
    events = make_decoder(PACKET, "cdr").decode(data).events
    assert len(events) == 1
    columns = (events.x, events.y, events.t, events.p)
    assert sum((c if c.base is None else c.base).nbytes for c in columns) == BYTES_PER_EVENT


# As many events as the bytes can hold, after what an encoding needs before the first one, and a
# sensor that leaves some of them outside.
DENSEST = {
    "evt3": ("<u2", [0x8000, 0x6000, 0, 0x3000], [0x4FFF] * (EVENTS // 12), (2059, 9)),
    "evt21": ("<u8", [0x8 << 60], [0xFFFFFFFF] * (EVENTS // 32), (31, 9)),
    "evt2": ("<u4", [0x8 << 28, 9 << 11], [0] * EVENTS, (9, 9)),
    "libcaer_cmp": ("<u2", [0x2000, 0x4000], [0x50FF] * (EVENTS // 8), (9, 2055)),
    "libcaer": ("<u4", [9 << 17, 0], [0, 0] * EVENTS, (9, 9)),
    "mono": ("<u8", [9 << 32], [0] * EVENTS, (9, 9)),
}


def densest(kind: str, all_inside: bool) -> tuple[str, bytes]:
    """A ROS type and a message of the most events that its length allows."""
    if kind in DENSEST:
        word, start, words, size = DENSEST[kind]
        payload = np.array(start + words, word).byteswap().tobytes()
        size = (0, 0) if all_inside else size
        return PACKET, event_packet(payload, kind, "ros1", size=size, big_endian=True)
    if kind == "event_array":
        events = synthetic(np.random.default_rng(3), EVENTS // 10)
        size = (0, 0) if all_inside else (340, 260)
        return "dvs_msgs/msg/EventArray", event_array(events, "ros1", size=size)
    point = {"names": ["x", "y", "t", "p"], "formats": ["i1"] * 4, "offsets": [0] * 4}
    points = np.zeros(EVENTS, np.dtype(point))
    points["x"][:9] = 0 if all_inside else -1
    return "sensor_msgs/msg/PointCloud2", point_cloud(points, "ros1")


@pytest.mark.parametrize("all_inside", [True, False], ids=["all inside", "some outside"])
@pytest.mark.parametrize("kind", EVENTS_PER_BYTE)
def test_densest_message_stays_within_limits(kind, all_inside):
    ros_type, data = densest(kind, all_inside)
    message = check(make_decoder(ros_type, "ros1"), kind, data)
    count = len(message.events) + message.dropped_outside
    assert 0.99 * EVENTS_PER_BYTE[kind] * (len(data) - 200) < count
    assert (message.dropped_outside == 0) == all_inside
    assert message.dropped_outside < count / 2


@every_kind
@pytest.mark.parametrize("byte", [b"\xff", b"\x01"])
def test_message_cut_by_announced_lengths_allocates_nothing_for_them(kind, serialization, byte):
    ros_type, message, _ = valid(kind, serialization)
    decoder = make_decoder(ros_type, serialization)
    refused = 0
    for at in range(len(message) - 3):
        data = message[:at] + byte * 4 + message[at + 4 :]
        refused += check(decoder, kind, data) is None
    assert refused > 4


def test_many_fields_of_a_cloud_stay_within_limits():
    points = np.zeros(1, [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "i1")])
    message = point_cloud(points, "ros1")
    count, fields = (4).to_bytes(4, "little"), 100_000
    field = (1).to_bytes(4, "little") + b"?" + bytes(4) + b"\2" + (1).to_bytes(4, "little")
    start = message.index(count + (1).to_bytes(4, "little") + b"x")
    data = message[:start] + (4 + fields).to_bytes(4, "little") + field * fields
    data += message[start + 4 :]
    decoded = check(make_decoder("sensor_msgs/msg/PointCloud2", "ros1"), "point_cloud", data)
    assert len(decoded.events) == 1
