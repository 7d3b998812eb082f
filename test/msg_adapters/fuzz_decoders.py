"""Coverage-guided fuzzing of every decoder and of the readers of plain files: `make fuzz`.

Each target runs in a process of its own, because libFuzzer never returns. A target fails on any
exception but DecodeError (readers: InputError), and on more events or memory than limits.py
allows. The compiled kernels run as plain Python here, so that coverage guides into them, on
arrays that refuse every index outside of 0 to N - 1: NumPy alone would let negative ones pass.

    python test/msg_adapters/fuzz_decoders.py [--runs N] [--seed N] [--target NAME]
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import atheris
import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
with atheris.instrument_imports(include=["msg_adapters", "emoflow_ros.readers"]):
    from checked_arrays import checked_njit

    from emoflow_ros.core.numerics import jit

    jit.njit = checked_njit  # before the kernels are imported
    from encoders import ENCODERS, payload, synthetic
    from limits import EVENTS_PER_BYTE, decode_within_limits
    from messages import event_array, event_packet, point_cloud

    from emoflow_ros.errors import InputError
    from emoflow_ros.readers.numpy_arrays import NumpyRecording
    from emoflow_ros.readers.prophesee_raw import PropheseeRawRecording
    from msg_adapters import make_decoder, supported_types

    PACKET = "event_camera_msgs/msg/EventPacket"
    PACKETS = (PACKET, "event_array_msgs/msg/EventArray")
    make_decoder(PACKET, "cdr")  # imports all formats and encodings, instrumented

type Target = Callable[[bytes], None]

DEFAULT_RUNS = 1_000_000
MAX_LENGTH = 400
DENSEST = max(EVENTS_PER_BYTE, key=EVENTS_PER_BYTE.__getitem__)
READERS = {"raw": PropheseeRawRecording, "npz": NumpyRecording, "npy": NumpyRecording}
TARGETS = [
    *(f"{t}:{s}" for t in supported_types() for s in ("cdr", "ros1")),
    *(f"{PACKET}:{encoding}" for encoding in ENCODERS),
    *(f"file:{suffix}" for suffix in READERS),
]


def main() -> int:
    """Fuzz one target or all, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=DEFAULT_RUNS, help="inputs for each target")
    parser.add_argument("--seed", type=int, default=0, help="default 0: another one each time")
    parser.add_argument("--target", choices=TARGETS, help="default: all")
    options = parser.parse_args()
    targets = [options.target] if options.target else TARGETS
    starts = {target: valid_input(target) for target in targets}
    for target, start in starts.items():
        print(f"== {target}: {options.runs} inputs", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            process = os.fork()
            if process == 0:
                fuzz(target, start, options.runs, options.seed, Path(folder))
            code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        if code:
            print(f"== {target}: failed", flush=True)
            return 1
    return 0


def fuzz(target: str, start: bytes, runs: int, seed: int, folder: Path) -> None:
    """Run libFuzzer on one target, starting from a valid input; ends the process."""
    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "valid").write_bytes(start)
    name, kind = target.rsplit(":", 1)
    one_input = read_file(kind, folder) if name == "file" else decode(name, kind)
    flags = [f"-atheris_runs={runs}", f"-seed={seed}", f"-max_len={MAX_LENGTH}", "-verbosity=0"]
    flags.append(f"-artifact_prefix={tempfile.gettempdir()}/")
    atheris.Setup([sys.argv[0], *flags, str(corpus)], one_input)
    atheris.Fuzz()


def decode(ros_type: str, kind: str) -> Target:
    """Decode whole messages, or payloads in packets of an encoding, all by one decoder."""
    decoder = make_decoder(ros_type, "ros1" if kind == "ros1" else "cdr")
    if kind in ENCODERS:
        wrap = _packet_of(kind)
        return lambda data: _ignore(decode_within_limits(decoder, kind, wrap(data)))
    others = {"EventArray": "event_array", "PointCloud2": "point_cloud"}
    limit = DENSEST if ros_type in PACKETS else others[ros_type.rpartition("/")[2]]
    return lambda data: _ignore(decode_within_limits(decoder, limit, data))


def read_file(suffix: str, folder: Path) -> Target:
    """Open files of a format and read all of their events."""
    path = folder / f"events.{suffix}"

    def one_input(data: bytes) -> None:
        path.write_bytes(_npz(data) if suffix == "npz" else data)
        try:
            with READERS[suffix](path) as recording:
                count = sum(len(events) for events in recording.event_chunks())
        except InputError:
            return
        if count > EVENTS_PER_BYTE[DENSEST] * len(data):
            raise AssertionError(f"{count} events out of {len(data)} bytes")

    return one_input


def valid_input(target: str) -> bytes:
    """Make the input to start from: a message or file, or a payload behind the byte that is seq."""
    ros_type, kind = target.rsplit(":", 1)
    events = synthetic(np.random.default_rng(3), 10)
    if kind == "raw":
        return b"% evt 3.0\n% geometry 346x260\n% end\n" + payload(ENCODERS["evt3"](events))
    if kind == "npz":
        return _npy(events.t)
    if kind in ENCODERS:
        return b"\0" + payload(ENCODERS[kind](events, int(events.t[0])))
    if ros_type in PACKETS:
        return event_packet(payload(ENCODERS["evt3"](events)), "evt3", kind)
    if ros_type.endswith("EventArray"):
        return event_array(events, kind, package=ros_type.partition("/")[0])
    points = np.zeros(10, [("x", "<u2"), ("y", "<f4"), ("t", "<f8"), ("p", "i1")])
    points["x"], points["y"], points["t"], points["p"] = events.x, events.y, events.t, events.p
    return point_cloud(points, kind)


def _ignore(_: object) -> None:
    """A target returns nothing."""


def _packet_of(encoding: str) -> Callable[[bytes], bytes]:
    """Make the input the payload of a packet; its first byte is the low byte of seq."""
    name = encoding.encode() + b"\0"
    start = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0" + bytes(3)
    start += (260).to_bytes(4, "little") + (346).to_bytes(4, "little")

    def wrap(data: bytes) -> bytes:
        seq = data[:1].ljust(8, b"\0")
        body = start + seq + bytes(8) + len(name).to_bytes(4, "little") + name
        body += b"\0"  # is_bigendian
        body += bytes(-len(body) % 4)
        return body + len(data[1:]).to_bytes(4, "little") + data[1:]

    return wrap


def _npz(t: bytes) -> bytes:
    """Make an archive of ten events whose member t.npy is the input, with a right checksum."""
    file = BytesIO()
    with ZipFile(file, "w") as archive:
        for name in "xyp":
            archive.writestr(f"{name}.npy", _npy(np.zeros(10, np.uint16)))
        archive.writestr("t.npy", t)
    return file.getvalue()


def _npy(values: np.ndarray) -> bytes:
    file = BytesIO()
    np.save(file, values)
    return file.getvalue()


if __name__ == "__main__":
    sys.exit(main())
