"""Coverage-guided fuzzing of every decoder: `make fuzz`.

Each target runs in a process of its own, because libFuzzer never returns. A target fails on any
exception but DecodeError, and on more events than the bytes can hold. The compiled kernels run
as plain Python here, so that coverage guides into them and every index is checked.

    python test/msg_adapters/fuzz_decoders.py [--runs N] [--target NAME]
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"

import atheris
import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
with atheris.instrument_imports(include=["msg_adapters"]):
    from encoders import ENCODERS, payload, synthetic
    from messages import event_array, event_packet, point_cloud

    from msg_adapters import DecodeError, make_decoder, supported_types

    PACKET = "event_camera_msgs/msg/EventPacket"
    make_decoder(PACKET, "cdr")  # imports all formats and encodings, instrumented

DEFAULT_RUNS = 1_000_000
MAX_LENGTH = 400
MAX_EVENTS_PER_BYTE = 8
TARGETS = [
    *(f"{t}:{s}" for t in supported_types() for s in ("cdr", "ros1")),
    *(f"{PACKET}:{encoding}" for encoding in ENCODERS),
]


def main() -> int:
    """Fuzz one target or all, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=DEFAULT_RUNS, help="inputs for each target")
    parser.add_argument("--target", choices=TARGETS, help="default: all, one after another")
    parser.add_argument("--corpus", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.corpus:
        fuzz(options.target, options.runs, options.corpus)
    for target in [options.target] if options.target else TARGETS:
        print(f"== {target}: {options.runs} inputs", flush=True)
        command = [sys.executable, __file__, "--target", target, "--runs", str(options.runs)]
        with tempfile.TemporaryDirectory() as corpus:
            (Path(corpus) / "valid").write_bytes(valid_input(target))
            code = subprocess.run([*command, "--corpus", corpus], check=False).returncode
        if code:
            return code
    return 0


def fuzz(target: str, runs: int, corpus: Path) -> None:
    """Run libFuzzer on one target, starting from the corpus; ends the process."""
    ros_type, kind = target.rsplit(":", 1)
    decoder = make_decoder(ros_type, "ros1" if kind == "ros1" else "cdr")
    wrap = _packet_of(kind) if kind in ENCODERS else bytes

    def one_input(data: bytes) -> None:
        message = wrap(data)
        try:
            decoded = decoder.decode(message)
        except DecodeError:
            return
        count = len(decoded.events) + decoded.dropped_outside
        if count > MAX_EVENTS_PER_BYTE * len(message):
            raise AssertionError(f"{count} events out of {len(message)} bytes")

    flags = [f"-atheris_runs={runs}", f"-max_len={MAX_LENGTH}", "-verbosity=0"]
    flags.append(f"-artifact_prefix={tempfile.gettempdir()}/")
    atheris.Setup([sys.argv[0], *flags, str(corpus)], one_input)
    atheris.Fuzz()


def valid_input(target: str) -> bytes:
    """Make the input to start from: a message, or a payload behind the byte that is seq."""
    ros_type, kind = target.rsplit(":", 1)
    events = synthetic(np.random.default_rng(3), 10)
    if kind in ENCODERS:
        return b"\0" + payload(ENCODERS[kind](events, int(events.t[0])))
    if ros_type == PACKET:
        return event_packet(payload(ENCODERS["evt3"](events)), "evt3", kind)
    if ros_type.endswith("EventArray"):
        return event_array(events, kind, package=ros_type.partition("/")[0])
    points = np.zeros(10, [("x", "<u2"), ("y", "<f4"), ("t", "<f8"), ("p", "i1")])
    points["x"], points["y"], points["t"], points["p"] = events.x, events.y, events.t, events.p
    return point_cloud(points, kind)


def _packet_of(encoding: str):
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


if __name__ == "__main__":
    sys.exit(main())
