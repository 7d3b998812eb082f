"""Messages of ROS 1 as the CDR bytes that ROS 2 publishes."""

import struct

import numpy as np
from rosbags.interfaces import Connection
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from emoflow_ros.errors import InputError

# Header header, uint32 height, uint32 width, Event[] events
_EVENT_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_FRAME_ID_AT = 12  # after sequence number and stamp
_ROS1_EVENT = 13
_CDR_EVENT = 16


class Ros1Converter:
    """Converts the serialised messages of a ROS 1 bag.

    Args:
        connections: of the bag; they define the types that are not standard.
    """

    def __init__(self, connections: list[Connection]) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        for connection in connections:
            try:
                types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            except TypesysError:
                continue  # `to_cdr` says so, if the topic is wanted
            self._store.register({k: v for k, v in types.items() if k not in self._store.fielddefs})

    def to_cdr(self, data: bytes, msgtype: str) -> bytes:
        """Convert one message.

        Raises:
            InputError: the message is damaged or of a type that is not defined.
        """
        try:
            if msgtype in _EVENT_ARRAYS:
                return self._event_array(data, msgtype)
            return bytes(self._store.ros1_to_cdr(data, msgtype))
        except (SerdeError, TypesysError, KeyError, ValueError, struct.error) as error:
            reason = " ".join(str(error).split()).rstrip(".")
            raise InputError(
                msgtype, f"message cannot be converted ({reason})", "leave it out with --topics"
            ) from None

    def _event_array(self, data: bytes, msgtype: str) -> bytes:
        (frame_id_size,) = struct.unpack_from("<I", data, _FRAME_ID_AT)
        count_at = _FRAME_ID_AT + 4 + frame_id_size + 8
        (count,) = struct.unpack_from("<I", data, count_at)
        records = np.frombuffer(data, np.uint8, offset=count_at + 4).reshape(count, _ROS1_EVENT)
        # A message without events ends in their count.
        empty = self._store.ros1_to_cdr(data[:count_at] + bytes(4), msgtype)
        return b"".join([empty[:-4], struct.pack("<I", count), _cdr_events(records)])


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
