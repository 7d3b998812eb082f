"""Finds the decoder of a ROS type, and of an EventPacket's encoding.

Every module in `formats/` and `encodings/` registers itself: a new one needs no change here.
"""

import importlib
import pkgutil
from collections.abc import Callable, Iterator
from functools import cache
from types import ModuleType

import msg_adapters.encodings
import msg_adapters.formats
from msg_adapters.message import DecodeError, Decoder, Serialization, Statistics
from msg_adapters.packet_decoder import PacketDecoder

type Factory = Callable[[Serialization], Decoder]


def make_decoder(ros_type: str, serialization: Serialization) -> Decoder:
    """Make the decoder for one topic, compiled and ready for its first message.

    Args:
        ros_type: as in `dvs_msgs/msg/EventArray`, or the ROS 1 form `dvs_msgs/EventArray`.
        serialization: `cdr` (ROS 2) or `ros1`.

    Raises:
        DecodeError: no decoder for the type (names those that exist), or an unknown
            serialisation.
    """
    if serialization not in ("cdr", "ros1"):
        raise DecodeError(f"unknown serialisation '{serialization}': use cdr or ros1")
    package, _, name = ros_type.partition("/")
    factory = _factories().get(f"{package}/msg/{name.removeprefix('msg/')}")
    if factory is None:
        raise DecodeError(f"no decoder for '{ros_type}': use one of {', '.join(supported_types())}")
    return factory(serialization)


def supported_types() -> tuple[str, ...]:
    """ROS types with a decoder, in the form `package/msg/Name`."""
    return tuple(sorted(_factories()))


def make_packet_decoder(encoding: str, statistics: Statistics) -> PacketDecoder:
    """Make the decoder for the payloads of one stream of packets.

    Args:
        encoding: as EventPacket names it, for example `evt3`.
        statistics: what to count in.

    Raises:
        DecodeError: an unknown encoding (names those that exist).
    """
    if encoding not in packet_decoders():
        known = ", ".join(sorted(packet_decoders()))
        raise DecodeError(f"unknown encoding '{encoding}': known are {known}")
    return packet_decoders()[encoding](statistics)


@cache
def packet_decoders() -> dict[str, type[PacketDecoder]]:
    """Collect ENCODING and DECODER of every module in `encodings/`, which compiles them."""
    return {module.ENCODING: module.DECODER for module in _modules_of(msg_adapters.encodings)}


@cache
def _factories() -> dict[str, Factory]:
    """Collect TYPES and DECODER of every module in `formats/`."""
    factories: dict[str, Factory] = {}
    for module in _modules_of(msg_adapters.formats):
        factories |= dict.fromkeys(module.TYPES, module.DECODER)
    return factories


def _modules_of(package: ModuleType) -> Iterator[ModuleType]:
    """Import the modules directly inside a package, in order of name."""
    for found in pkgutil.iter_modules(package.__path__):
        yield importlib.import_module(f"{package.__name__}.{found.name}")
