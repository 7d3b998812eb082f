"""Any bytes give events or a DecodeError, in bounded memory, and the decoder works on."""

from functools import cache

import numpy as np
import pytest
from encoders import COUNT_FROM_TIME_BASE, ENCODERS, assert_equal, payload, synthetic
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from messages import event_array, event_packet, point_cloud

from emoflow_ros.core.events import Events
from msg_adapters import DecodeError, EventMessage, make_decoder
from msg_adapters.message import Decoder

MAX_EVENTS_PER_BYTE = 8  # a 4-byte half of an EVT 2.1 word holds 32
BYTES_PER_EVENT = 13

fast = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
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
    return "event_camera_msgs/msg/EventPacket", message, events


def check(decoder: Decoder, data: bytes) -> EventMessage | None:
    """Decode, and check what must hold for any bytes."""
    try:
        message = decoder.decode(data)
    except DecodeError:
        return None
    events = message.events
    assert len(events.x) == len(events.y) == len(events.t) == len(events.p)
    assert len(events) + message.dropped_outside <= MAX_EVENTS_PER_BYTE * len(data)
    if message.width and message.height:
        assert events.inside(message.width, message.height).all()
    return message


every_kind = pytest.mark.parametrize("kind", ["event_array", "point_cloud", *ENCODERS])


@every_kind
@fast
@given(data=st.binary(max_size=300))
@example(data=b"")
@example(data=b"\0\1\0\0")
def test_arbitrary_bytes(kind, serialization, data):
    ros_type, message, events = valid(kind, serialization)
    decoder = make_decoder(ros_type, serialization)
    check(decoder, data)
    check(decoder, b"\0\1\0\0" + data)
    decoder.reset()
    assert_equal(decoder.decode(message).events, events)


@every_kind
@fast
@given(data=st.data())
def test_mutated_messages(kind, serialization, data):
    ros_type, message, events = valid(kind, serialization)
    mutated = bytearray(message)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(mutated) - 1))
        mutated[at] = data.draw(st.integers(0, 255))
    length = data.draw(st.integers(len(mutated) - 20, len(mutated)))
    decoder = make_decoder(ros_type, serialization)
    check(decoder, bytes(mutated[:length]))
    decoder.reset()
    assert_equal(decoder.decode(message).events, events)


@pytest.mark.parametrize("encoding", ENCODERS)
@fast
@given(payloads=st.lists(st.binary(max_size=400), max_size=4), big_endian=st.booleans())
def test_arbitrary_payloads(encoding, payloads, big_endian):
    decoder = make_decoder("event_camera_msgs/msg/EventPacket", "cdr")
    for seq, data in enumerate(payloads):
        message = event_packet(
            data, encoding, seq=seq, size=(0, 0), time_base=1 << 60, big_endian=big_endian
        )
        assert check(decoder, message) is not None


@pytest.mark.parametrize("kind", ["evt3", "evt21"])
def test_vectors_allocate_no_more_than_their_events(kind):
    words = {"evt3": [0x8000, 0x6000, 0, 0x3000], "evt21": [0x8 << 60]}[kind]
    words += [{"evt3": 0x4000, "evt21": 0x0}[kind]] * 100_000  # vectors without events
    words += [{"evt3": 0x2000, "evt21": 0x1}[kind]]
    data = event_packet(np.array(words, {"evt3": "<u2", "evt21": "<u8"}[kind]).tobytes(), kind)
    events = make_decoder("event_camera_msgs/msg/EventPacket", "cdr").decode(data).events
    assert len(events) == 1
    columns = (events.x, events.y, events.t, events.p)
    assert sum((c if c.base is None else c.base).nbytes for c in columns) == BYTES_PER_EVENT
