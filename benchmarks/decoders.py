"""Measure how fast each decoder is on one core, and the memory it needs.

The speed is that of the fastest repeat: what other work on the machine does to the others is
not the decoder's.
"""

import argparse
import json
import platform
import sys
import time
import tracemalloc
from dataclasses import asdict, dataclass
from pathlib import Path

import numba
import numpy as np
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "msg_adapters"))

from encoders import COUNT_FROM_TIME_BASE, ENCODERS, payload, synthetic
from messages import event_array, event_packet, point_cloud

from benchmarks._rows import Row, lay_out
from emoflow_ros.cli import run
from emoflow_ros.core.types.events import Events
from emoflow_ros.readers.bag_files import open_bag
from msg_adapters import make_decoder

PACKET = "event_camera_msgs/msg/EventPacket"
RECORDINGS = Path(__file__).parents[2] / "shared" / "data" / "event_packets"
BYTES_PER_EVENT = 13
TARGETS = {  # million events per second on one core
    "dvs_msgs, CDR": 300,
    "dvs_msgs, ROS 1": 300,
    "PointCloud2": 200,
    "evt3": 50,
    "libcaer_cmp": 50,
    "libcaer": 150,
    "mono": 150,
    "evt2": 100,
    "evt21": None,
    "evt3, recorded": 50,
    "libcaer_cmp, recorded": 50,
}


@dataclass(frozen=True)
class Case:
    """Messages of one topic."""

    ros_type: str
    serialization: str
    messages: list[bytes]


@dataclass(frozen=True)
class Result:
    """Speed in million events per second, and peak memory over the size of what is returned."""

    decoder: str
    mev_per_s: float
    target: float | None
    events_per_message: float
    memory_ratio: float


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: python benchmarks/decoders.py --seconds 1",
    )
    parser.add_argument("--events", type=int, default=30_000, help="per message (default 30000)")
    parser.add_argument("--seconds", type=float, default=0.5, help="per decoder (default 0.5)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/benchmarks/decoders.json"),
        help="default: out/benchmarks/decoders.json",
    )
    return parser


def _measure(args: argparse.Namespace) -> None:
    cases = _cases(_events(args.events)) | _recorded()
    results = [
        _measure_case(name, case, args.seconds) for name, case in tqdm(cases.items(), leave=False)
    ]
    machine = {
        "processor": _processor(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }
    rows = [
        Row(f"{r.decoder}: million events per second", r.mev_per_s, at_least=r.target)
        for r in results
    ]
    report = {
        "machine": machine,
        "results": [asdict(r) for r in results],
        "rows": [row.as_dict() for row in rows],
    }
    print(lay_out(rows))
    print(f"\n{'decoder':<24}{'ev/message':>12}{'memory':>8}")
    for r in results:
        print(f"{r.decoder:<24}{r.events_per_message:>12.0f}{r.memory_ratio:>8.2f}")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(report, indent=2) + "\n")
    print(f"written to {args.out}")


def _events(count: int) -> Events:
    """Events of less than 4.3 s, which is what one packet of `mono` can hold."""
    events = synthetic(np.random.default_rng(0), count)
    return Events(events.x, events.y, events.t // 20_000 * 1000, events.p)


def _cases(events: Events) -> dict[str, Case]:
    """One message of the same events for each decoder."""
    points = np.zeros(len(events), [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")])
    points["x"], points["y"], points["t"], points["p"] = (
        events.x,
        events.y,
        events.t / 1e9,
        events.p,
    )
    cases = {
        "dvs_msgs, CDR": Case("dvs_msgs/msg/EventArray", "cdr", [event_array(events, "cdr")]),
        "dvs_msgs, ROS 1": Case("dvs_msgs/EventArray", "ros1", [event_array(events, "ros1")]),
        "PointCloud2": Case("sensor_msgs/msg/PointCloud2", "cdr", [point_cloud(points)]),
    }
    for encoding, encode in ENCODERS.items():
        time_base = int(events.t[0]) if encoding in COUNT_FROM_TIME_BASE else 0
        data = event_packet(payload(encode(events, time_base)), encoding, time_base=time_base)
        cases[encoding] = Case(PACKET, "cdr", [data])
    return cases


def _recorded() -> dict[str, Case]:
    """Real packets, where they are."""
    cases = {}
    for name, folder in (("evt3", "test_events_1"), ("libcaer_cmp", "test_events_2")):
        if (RECORDINGS / folder).is_dir():
            with open_bag(RECORDINGS / folder) as bag:
                messages = [bytes(data) for _, _, data in bag.messages()]
            cases[f"{name}, recorded"] = Case(PACKET, "cdr", messages)
    return cases


def _measure_case(name: str, case: Case, seconds: float) -> Result:
    decoder = make_decoder(case.ros_type, case.serialization)

    def decode() -> int:
        return sum(len(decoder.decode(data).events) for data in case.messages)

    events = decode()
    best = float("inf")
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        start = time.perf_counter()
        decode()
        best = min(best, time.perf_counter() - start)
    longest = max(case.messages, key=len)
    tracemalloc.start()
    decoded = decoder.decode(longest)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return Result(
        decoder=name,
        mev_per_s=events / best / 1e6,
        target=TARGETS[name],
        events_per_message=events / len(case.messages),
        memory_ratio=peak / (BYTES_PER_EVENT * len(decoded.events)),
    )


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor()


if __name__ == "__main__":
    sys.exit(main())
