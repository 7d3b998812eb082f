"""event_camera_msgs/EventPacket: a packet in one of the encodings of `encodings/`.

Fields: Header header, uint32 height, uint32 width, uint64 seq, uint64 time_base, string
encoding, bool is_bigendian, uint8[] events. The drivers of 2021 to 2023 published the same layout
as event_array_msgs/EventArray.
"""

from msg_adapters.message import (
    Bytes,
    Cursor,
    DecodeError,
    EventMessage,
    Serialization,
    Statistics,
    build_message,
)
from msg_adapters.packet_decoder import PacketDecoder
from msg_adapters.registry import make_packet_decoder, packet_decoders

TYPES = ("event_camera_msgs/msg/EventPacket", "event_array_msgs/msg/EventArray")

_TIME_LIMIT = 1 << 62
_WORD = 8  # bytes of the longest word of an encoding


class EventPacketDecoder:
    """Decode EventPacket messages; all encodings are compiled when one is made."""

    def __init__(self, serialization: Serialization) -> None:
        self.statistics = Statistics()
        self._serialization = serialization
        packet_decoders()  # compiled now, not in the first message
        self._packets: PacketDecoder | None = None
        self._seq: int | None = None
        self._left_out = 0  # messages before the next one

    def decode(self, data: Bytes, part: int = 1) -> EventMessage:
        """Decode one message; see Decoder."""
        cursor = Cursor(data, self._serialization)
        header = cursor.header()
        height, width = cursor.integers("II")
        seq, time_base = cursor.integers("QQ")
        encoding = cursor.string()
        (big_endian,) = cursor.integers("B")
        payload = cursor.blob()
        cursor.finish()
        if time_base >= _TIME_LIMIT:
            raise DecodeError(f"time_base {time_base} is beyond 64-bit nanoseconds")
        packets = self._packets_of(encoding)
        self._follow(seq, packets)
        if part > 1:
            payload = payload[: len(payload) // part // _WORD * _WORD]
        events = packets.decode(payload, bool(big_endian), time_base)
        if part > 1:  # what follows in the packet is lost
            packets.resync()
        return build_message(header, width, height, events, self.statistics, seq=seq)

    def resync(self, left_out: int) -> None:
        """Expect that so many numbers are missing; keep counting time wraps."""
        self._left_out += left_out
        if self._packets is not None:
            self._packets.resync()

    def reset(self) -> None:
        """Forget time, row and running number."""
        self._seq = None
        self._left_out = 0
        if self._packets is not None:
            self._packets.reset()

    def _packets_of(self, encoding: str) -> PacketDecoder:
        """Return the decoder of the encoding: the one at work unless the encoding changed."""
        if self._packets is None or encoding != self.statistics.encoding:
            self._packets = make_packet_decoder(encoding, self.statistics)
            self.statistics.encoding = encoding
        return self._packets

    def _follow(self, seq: int, packets: PacketDecoder) -> None:
        """Compare the running number with the last one; publishers without numbers repeat it."""
        expected = seq if self._seq is None else self._seq + 1 + self._left_out
        if seq > expected:
            self.statistics.seq_gaps += seq - expected
            packets.resync()
        elif self._seq is not None and seq < self._seq:
            packets.reset()
        self._seq, self._left_out = seq, 0


DECODER = EventPacketDecoder
