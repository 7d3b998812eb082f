"""The definition of a bag's EventArray messages, where it is another than today's."""

from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.typesys import TypesysError, get_types_from_msg

from msg_adapters import DecodeError
from msg_adapters.defined_arrays import (
    EVENTS,
    HEADER,
    NANOSECONDS,
    SECONDS,
    TEXT,
    ArrayLayout,
)

_CODES = {
    "bool": "<u1", "byte": "<u1", "char": "<u1",
    "uint8": "<u1", "uint16": "<u2", "uint32": "<u4", "uint64": "<u8",
    "int8": "<i1", "int16": "<i2", "int32": "<i4", "int64": "<i8",
    "float32": "<f4", "float64": "<f8",
}  # fmt: skip
_TODAY = ArrayLayout(
    (("header", HEADER), ("height", "<u4"), ("width", "<u4"), ("events", EVENTS)),
    (("x", "<u2"), ("y", "<u2"), (SECONDS, "<u4"), (NANOSECONDS, "<u4"), ("polarity", "<u1")),
)


def other_layout(connection: Connection) -> ArrayLayout | None:
    """Read the definition that a bag carries of a type of arrays of events.

    Returns:
        The layout; None where it is today's, or where no definition can be read.

    Raises:
        DecodeError: the definition is another than today's, and not one that can be decoded.
    """
    definition = connection.msgdef
    if definition.format is not MessageDefinitionFormat.MSG or not definition.data.strip():
        return None
    members: list[tuple[str, str]] = []
    event: tuple[tuple[str, str], ...] = ()
    try:
        types = get_types_from_msg(definition.data, connection.msgtype)
        for name, (node, argument) in types[connection.msgtype][1]:
            kind = _kind(node, argument)
            if kind == EVENTS:
                event = _event_members(types, str(argument[0][1]))
            members.append((name, kind))
    except (TypesysError, KeyError):
        return None
    layout = ArrayLayout(tuple(members), event)
    return None if layout == _TODAY else layout


def _kind(node: object, argument: object) -> str:
    """Return the kind of a message's member.

    Raises:
        DecodeError: one that is not understood.
    """
    match node, argument:
        case Nodetype.NAME, "std_msgs/msg/Header":
            return HEADER
        case Nodetype.SEQUENCE, ((Nodetype.NAME, _), _):
            return EVENTS
        case Nodetype.BASE, ("string", _):
            return TEXT
        case Nodetype.BASE, (str(base), _) if base in _CODES:
            return _CODES[base]
    raise DecodeError("its definition has members of unknown kinds")


def _event_members(types: object, name: str) -> tuple[tuple[str, str], ...]:
    """Return name and code of an event's members; a time is two."""
    members: list[tuple[str, str]] = []
    for member, (node, argument) in types[name][1]:  # type: ignore[index]
        match node, argument:
            case Nodetype.NAME, "builtin_interfaces/msg/Time":
                members += [(SECONDS, "<u4"), (NANOSECONDS, "<u4")]
            case Nodetype.BASE, (str(base), _) if base in _CODES:
                members.append((member, _CODES[base]))
            case _:
                raise DecodeError(f"the member '{member}' of its events is of an unknown kind")
    return tuple(members)
