"""The event topics of a bag and the decoders of their messages."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

from rosbags.interfaces import Connection

from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_files import Bag, serialization
from msg_adapters import Decoder, EventMessage, Statistics, make_decoder, supported_types


class TopicDecoder:
    """Decodes the messages of a topic, those of each connection by its type and serialisation.

    Args:
        connections: of the topic, as `event_connections` gives them.
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
    kind = serialization(connection)
    assert kind is not None
    return make_decoder(connection.msgtype, kind)


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
        wrong = "no event topic"
    there = ", ".join(sorted(set(_described(bag))))
    fix = f"give one of {', '.join(sorted(known))}" if known else "give a bag with events"
    raise InputError(path, f"{wrong}; it holds {there or 'no topics'}", fix)


def _described(bag: Bag) -> Iterator[str]:
    for connection in bag.connections:
        yield f"{connection.topic} ({connection.msgtype})"
