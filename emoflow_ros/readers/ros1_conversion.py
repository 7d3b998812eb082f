"""Messages of ROS 1 as the CDR bytes that ROS 2 publishes."""

import struct

import numpy as np
from rosbags.interfaces import Connection
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.event_definition import other_layout
from msg_adapters import DecodeError, EventMessage
from msg_adapters.defined_arrays import DefinedArrayDecoder
from msg_adapters.formats import event_array

# Header header, uint32 height, uint32 width, Event[] events
_FRAME_ID_AT = 12  # after sequence number and stamp
_ROS1_EVENT = 13
_CDR_EVENT = 16
_RECORD = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])
_TODAY = f"""std_msgs/Header header
uint32 height
uint32 width
{{package}}/Event[] events
{"=" * 80}
MSG: {{package}}/Event
uint16 x
uint16 y
builtin_interfaces/Time ts
bool polarity
"""


class Ros1Converter:
    """Converts the serialised messages of a ROS 1 bag.

    Args:
        connections: of the bag; they define the types that are not standard.
    """

    def __init__(self, connections: list[Connection]) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._older: dict[str, DefinedArrayDecoder] = {}
        for connection in connections:
            try:
                definition = self._definition(connection)
                types = get_types_from_msg(definition, connection.msgtype)
            except (TypesysError, DecodeError):
                continue  # `to_cdr` says so, if the topic is wanted
            self._store.register({k: v for k, v in types.items() if k not in self._store.fielddefs})

    def to_cdr(self, data: bytes, msgtype: str) -> bytes:
        """Convert one message.

        Raises:
            InputError: the message is damaged or of a type that is not defined.
        """
        try:
            if msgtype in self._older:
                data = _packed(self._older[msgtype].decode(data))
            if msgtype in event_array.TYPES:
                return self._event_array(data, msgtype)
            return bytes(self._store.ros1_to_cdr(data, msgtype))
        except (SerdeError, TypesysError, KeyError, ValueError, struct.error) as error:
            reason = " ".join(str(error).split()).rstrip(".")
            raise InputError(
                msgtype, f"message cannot be converted ({reason})", "leave it out with --topics"
            ) from None

    def _definition(self, connection: Connection) -> str:
        """Return the definition of a type: today's of event arrays, which older ones become.

        Raises:
            DecodeError: an older one that is not understood.
        """
        if connection.msgtype not in event_array.TYPES:
            return connection.msgdef.data
        if layout := other_layout(connection):
            self._older[connection.msgtype] = DefinedArrayDecoder(layout)
        return _TODAY.format(package=connection.msgtype.partition("/")[0])

    def _event_array(self, data: bytes, msgtype: str) -> bytes:
        (frame_id_size,) = struct.unpack_from("<I", data, _FRAME_ID_AT)
        count_at = _FRAME_ID_AT + 4 + frame_id_size + 8
        (count,) = struct.unpack_from("<I", data, count_at)
        records = np.frombuffer(data, np.uint8, offset=count_at + 4).reshape(count, _ROS1_EVENT)
        # A message without events ends in their count.
        empty = self._store.ros1_to_cdr(data[:count_at] + bytes(4), msgtype)
        return b"".join([empty[:-4], struct.pack("<I", count), _cdr_events(records)])


def _packed(message: EventMessage) -> bytes:
    """Serialise a message for ROS 1 by today's definition."""
    events, frame_id = message.events, message.frame_id.encode()
    seconds, nanoseconds = divmod(message.stamp, NS_PER_S)
    head = struct.pack("<IIII", 0, seconds, nanoseconds, len(frame_id)) + frame_id
    records = np.empty(len(events), _RECORD)
    records["x"], records["y"], records["p"] = events.x, events.y, events.p
    records["s"], records["ns"] = np.divmod(events.t, NS_PER_S)
    size = struct.pack("<III", message.height, message.width, len(events))
    return head + size + records.tobytes()


def _cdr_events(records: np.ndarray[tuple[int, int], np.dtype[np.uint8]]) -> bytes:
    """Spread packed events (N, 13) as CDR aligns them.

    CDR aligns each member, not the struct: x of every event but the first comes one byte of
    padding after the polarity before it, and two more precede its time. The rows below
    therefore start 2 bytes before the first event, whose x and y have no such gap behind them.
    """
    rows = np.zeros((len(records), _CDR_EVENT), np.uint8)
    rows[:, 0:4] = records[:, 0:4]  # x, y
    rows[:, 6:15] = records[:, 4:13]  # seconds, nanoseconds, polarity
    spread = rows.reshape(-1)[2:-1]
    spread[:4] = records[:1, :4].reshape(-1)
    return spread.tobytes()
