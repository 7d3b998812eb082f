"""What any bytes may cost a decoder: events and memory that follow from the bytes' number."""

import tracemalloc

from msg_adapters import DecodeError, EventMessage
from msg_adapters.message import Decoder

# Most events that one byte can stand for. EVT 3.0: 12 in a word of 2 bytes; EVT 2.1: 32 in 8;
# libcaer_cmp: 8 in 2. Fields of a cloud may overlap, down to points of a single byte.
EVENTS_PER_BYTE = {
    "event_array": 1 / 13,
    "point_cloud": 1,
    "evt3": 6,
    "libcaer_cmp": 4,
    "libcaer": 1 / 8,
    "mono": 1 / 8,
    "evt2": 1 / 4,
    "evt21": 4,
}
# Of a decoded event: x, y, t and p; the same again for those that lie inside; three masks.
BYTES_PER_EVENT = 2 * 13 + 3
# Copies of the input in another byte order or type, and what is found out about it.
COPIES = 8
# Fields of a cloud as Python objects, for 13 bytes each.
FIELD_COPIES = {"point_cloud": 40}
# Whatever the length: headers, views, NumPy's buffers of 8192 elements, the exception.
FIXED = 200_000


def decode_within_limits(decoder: Decoder, kind: str, data: bytes) -> EventMessage | None:
    """Decode and check what may be allocated; None where the bytes are no message.

    Args:
        decoder: of the message's type.
        kind: key of EVENTS_PER_BYTE; the encoding that the message names comes before it.
        data: any bytes.

    Raises:
        AssertionError: more events, or more bytes at once, than the number of bytes allows.
    """
    tracemalloc.start()
    try:
        try:
            message = decoder.decode(data)
        except DecodeError:
            message = None
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    kind = decoder.statistics.encoding or kind
    most = EVENTS_PER_BYTE[kind] * len(data)
    count = 0 if message is None else len(message.events) + message.dropped_outside
    assert count <= most, f"{count} events out of {len(data)} bytes"
    limit = FIXED + most * BYTES_PER_EVENT + (COPIES + FIELD_COPIES.get(kind, 0)) * len(data)
    assert peak <= limit, f"{peak} bytes allocated for {len(data)} bytes, more than {limit:.0f}"
    return message
