"""Measure the running node: sustained replay over DDS, freshness, memory and processor time.

A simulated recording is written as a bag of EVT3 packets and replayed with the executable `replay`
through the executable `estimator`, in processes of their own on two cores; this process
subscribes. Each case has its sensor, its rate of events and its pace of the replay.

The age of a twist is the time from its stamp to its publication, as DDS stamps it. `replay`
publishes a packet of 1 to 4 ms at its end, and about every 4 ms a mark just before it: the
recording's time passes on the clock as the marks say. At a pace of 5 an event is one fifth of the
recording's time later on the clock, and ages are those on the clock. The first second does not
count.

A window is lost if the estimator did not answer it. A message is lost if the node's queue was full;
the node counts it as a gap in `seq`. Resident memory and processor time come from
/proc. Resident pages that the worker shares with the server it is forked from count in both.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.utilities import get_rmw_implementation_identifier

from benchmarks._event_loop import Loop, Sensor, simulate_loops, write_loop
from benchmarks._node_figures import Sent, Targets, figures, process_table, rows
from benchmarks._rows import lay_out
from benchmarks._running_node import DOMAIN, replay_through_node
from emoflow_ros.cli import run
from emoflow_ros.config import load_config
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import machine, versions

CORES = 2


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        sensor: whose events they are.
        targets: what it is held to.
        pace: of the replay.
        mev_per_s: million events per second, at most; None: as many as the sensor sees.
        per_frame: packets per 4.096 ms.
        seconds, long_seconds: length of the recording, s, and that with --long.
    """

    sensor: Sensor
    targets: Targets
    pace: float = 1.0
    mev_per_s: float | None = None
    per_frame: int = 1
    seconds: float = 60.0
    long_seconds: float = 600.0


_DAVIS346 = Sensor(346, 260, 0.2)
_VGA = Sensor(640, 480, 0.08)
_HD = Sensor(1280, 720, 0.06)
_OVERLOAD = Targets(age_p95_ms=150, longest_run=3)
CASES = {
    "fresh": Case(_DAVIS346, Targets(twists_per_s=50, age_p50_ms=30, age_p95_ms=45, lost=0)),
    "overload-2x": Case(_DAVIS346, _OVERLOAD, pace=2),
    "overload-5x": Case(_DAVIS346, _OVERLOAD, pace=5),
    "overload-10x": Case(_DAVIS346, _OVERLOAD, pace=10),
    "vga": Case(
        _VGA,
        Targets(twists_per_s=30, age_p95_ms=80),
        mev_per_s=10,
        seconds=20,
        long_seconds=60,
    ),
    "hd": Case(
        _HD,
        Targets(twists_per_s=10, age_p95_ms=150, lost=0),
        mev_per_s=25,
        per_frame=2,
        seconds=20,
        long_seconds=60,
    ),
    "hd-50": Case(
        _HD,
        Targets(longest_run=3),
        mev_per_s=50,
        per_frame=4,
        seconds=10,
        long_seconds=30,
    ),
}


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="example: python benchmarks/node.py --cases fresh overload-5x --seconds 30",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--cases", nargs="+", default=CASES, choices=CASES, metavar="CASE",
        help=f"default: all of {', '.join(CASES)}")  # fmt: skip
    lengths = parser.add_mutually_exclusive_group()
    lengths.add_argument("--seconds", type=float, metavar="S", help="recorded, of all cases")
    lengths.add_argument(
        "--long", action="store_true", help="ten minutes of 346x260, one of the larger ones"
    )
    add(
        "--out",
        type=Path,
        default=Path("out/benchmarks/node.json"),
        help="default: out/benchmarks/node.json; bags of up to 6 GB lie beside it for a while",
    )
    return parser


def _measure(args: argparse.Namespace) -> None:
    if args.seconds is not None and not 5 <= args.seconds <= 3600:
        raise InputError("--seconds", f"{args.seconds:g} s", "give a length in [5, 3600] s")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    args.out.parent.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {
        "machine": machine(),
        "cores_used": CORES,
        "load_average_at_start": os.getloadavg()[0],
        "versions": versions(),
        "middleware": get_rmw_implementation_identifier(),
        "configuration": load_config("realtime").flat(),
        "cases": {},
        "rows": [],
    }
    print(f"{report['machine']['processor']}, load before {report['load_average_at_start']:.1f}")
    for sensor in {CASES[name].sensor: None for name in args.cases}:
        cases = {name: CASES[name] for name in args.cases if CASES[name].sensor == sensor}
        for name, loop in _loops(sensor, cases).items():
            case = cases[name]
            seconds = args.seconds or (case.long_seconds if args.long else case.seconds)
            found = _run_case(name, case, loop, seconds, args.out.parent)
            report["cases"][name] = found
            report["rows"] += found.pop("rows")
            args.out.write_text(json.dumps(report, indent=2) + "\n")  # what is there is kept
    print(f"written to {args.out}")


def _loops(sensor: Sensor, cases: Mapping[str, Case]) -> dict[str, Loop]:
    """Simulate the loops of one sensor's cases; cases with the same events share one."""
    rates = list(dict.fromkeys((case.mev_per_s, case.per_frame) for case in cases.values()))
    loops = dict(zip(rates, simulate_loops(sensor, rates, progress=True), strict=True))
    return {name: loops[case.mev_per_s, case.per_frame] for name, case in cases.items()}


def _run_case(name: str, case: Case, loop: Loop, seconds: float, folder: Path) -> dict[str, Any]:
    events = loop.events(seconds)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        bag = Path(temporary) / name
        write_loop(bag, loop, seconds, case.pace, progress=True)
        observed = replay_through_node(bag, case.pace)
    windows = loop.windows(seconds, load_config("realtime").window)
    found = figures(observed, Sent(loop.size(seconds), events, windows))
    judged = rows(name, case.pace, case.targets, found)
    print(
        f"\n{name}: {loop.camera.width}x{loop.camera.height}, {seconds:g} s of "
        f"{events / seconds / 1e6:.1f} million events per second at {case.pace:g}x\n"
        f"{lay_out(judged)}\n\n{process_table(found['processes'])}"
    )
    return {
        "camera": f"{loop.camera.width}x{loop.camera.height}",
        "recorded_s": seconds,
        "events_per_s": events / seconds,
        "pace": case.pace,
        **found,
        "rows": [row.as_dict() for row in judged],
    }


if __name__ == "__main__":
    sys.exit(main())
