"""The event topics of a bag and the decoders of their messages."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

from rosbags.interfaces import Connection

from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_files import Bag, serialization
from emoflow_ros.readers.event_definition import other_layout
from msg_adapters import (
    DecodeError,
    Decoder,
    EventMessage,
    Statistics,
    make_decoder,
    supported_types,
)
from msg_adapters.defined_arrays import DefinedArrayDecoder
from msg_adapters.formats import event_array


class TopicDecoder:
    """Decodes the messages of a topic, those of each connection by its type and serialisation.

    Args:
        connections: of the topic, as `event_connections` gives them.

    Raises:
        InputError: a type whose definition is not understood.
    """

    def __init__(self, connections: list[Connection]) -> None:
        self._decoders = {c.id: _decoder(c) for c in connections}

    def decode(self, connection: Connection, data: bytes) -> EventMessage:
        """Decode the next message.

        Raises:
            DecodeError: it is damaged.
        """
        return self._decoders[connection.id].decode(data)

    @property
    def statistics(self) -> Statistics:
        """What all connections have had together."""
        total = Statistics()
        for part in (decoder.statistics for decoder in self._decoders.values()):
            for field in fields(Statistics):
                if field.name != "encoding":
                    count = getattr(total, field.name) + getattr(part, field.name)
                    setattr(total, field.name, count)
            total.encoding = part.encoding or total.encoding
        return total


def _decoder(connection: Connection) -> Decoder:
    """Make the decoder of a connection.

    Raises:
        InputError: its type has another definition than today's, which is not understood.
    """
    kind = serialization(connection)
    assert kind is not None
    decoder = make_decoder(connection.msgtype, kind)
    if connection.msgtype not in event_array.TYPES:
        return decoder
    try:
        layout = other_layout(connection)
        if layout is not None and kind != "ros1":
            raise DecodeError("its definition is not today's")
    except DecodeError as error:
        raise InputError(
            connection.topic, f"{connection.msgtype} cannot be decoded: {error}", "convert the bag"
        ) from None
    return decoder if layout is None else DefinedArrayDecoder(layout)


def event_connections(bag: Bag) -> dict[str, list[Connection]]:
    """Find the connections of event messages, by topic."""
    found: dict[str, list[Connection]] = {}
    for connection in bag.connections:
        if connection.msgtype in supported_types() and serialization(connection):
            found.setdefault(connection.topic, []).append(connection)
    return found


def choose_events(path: Path, bag: Bag, topic: str | None) -> list[Connection]:
    """Find the one event topic, or the one asked for.

    Raises:
        InputError: none, several, or no such topic.
    """
    known = event_connections(bag)
    if topic is not None:
        if topic in known:
            return known[topic]
        wrong = f"no event topic '{topic}'"
    elif len(known) == 1:
        return next(iter(known.values()))
    elif known:
        raise InputError(
            path, f"{len(known)} event topics: {', '.join(sorted(known))}", "choose with --topic"
        )
    else:
        wrong = "no topic of a known event type"
    there = ", ".join(sorted(set(_described(bag))))
    types = f"topics of the types {', '.join(supported_types())} can be decoded"
    fix = f"give one of {', '.join(sorted(known))}" if known else types
    raise InputError(path, f"{wrong}; it holds {there or 'no topics'}", fix)


def _described(bag: Bag) -> Iterator[str]:
    for connection in bag.connections:
        yield f"{connection.topic} ({connection.msgtype})"
