"""Measure the running node: sustained replay over DDS, latency, memory and processor time.

A simulated recording is written as a bag and replayed with the executable `replay` through the
executable `estimator`, in processes of their own; this process subscribes. Recordings longer than
10 s repeat 10 s, each time stamped later: time goes on, the motion jumps at the seams.

Latency is from the publication of the message with a window's last event, as DDS stamps it, to
the reception of the window's twist. A message holds 10 ms of events and is published at their
end. Resident memory and processor time come from /proc. Resident pages that the worker shares
with the server it is forked from count in both.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.utilities import get_rmw_implementation_identifier
from scipy.stats import linregress

from benchmarks._running_node import (
    DOMAIN,
    SAMPLE_S,
    START,
    Observed,
    RepeatedRecording,
    Sample,
    replay_through_node,
)
from benchmarks._scoring import MIN_WINDOWS, SCENES, verdict
from emoflow_ros.cli import run
from emoflow_ros.core.config import load_config
from emoflow_ros.core.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import machine, versions
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.simulation.recording_files import write_bag

LONGEST_SIMULATED_S = 10.0
WARM_UP_WINDOWS = 3  # the first one is cold, the next ones meet what it leaves behind
MIN_SAMPLES = 3
MIN_SAMPLES_FOR_GROWTH = 60  # for its target to mean something

TARGET_SLOWER_PERCENT = 1.0  # a replay that falls behind makes all else easier
TARGET_P95_MS = 60.0
TARGET_MEMORY_MB = 1500.0
TARGET_GROWTH_MB_PER_MIN = 1.0  # "flat": 10 MB in 10 minutes


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="example, for the memory over 10 minutes (a bag of 12 GB beside --out): "
        "python benchmarks/node.py --duration 600",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--scene", default="calm", choices=SCENES, metavar="SCENE", help="default: calm")
    add("--seed", type=int, default=0, help="default: 0")
    add("--duration", type=float, default=120.0, metavar="S",
        help="seconds (default: 120, a bag of 2.4 GB beside --out)")  # fmt: skip
    add("--rate", type=float, default=1.0, metavar="R", help="pace of the replay (default: 1)")
    add(
        "--out",
        type=Path,
        default=Path("out/benchmarks/node.json"),
        help="default: out/benchmarks/node.json",
    )
    return parser


def _measure(args: argparse.Namespace) -> None:
    if not 5 <= args.duration <= 3600:
        raise InputError("--duration", f"{args.duration:g} s", "give a length in [5, 3600] s")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    load = os.getloadavg()[0]
    config = load_config("realtime")
    seconds = min(args.duration, LONGEST_SIMULATED_S)
    simulated = simulate(
        args.scene, duration_s=seconds, seed=args.seed, start_ns=START, progress=True
    )
    source = RepeatedRecording(simulated, args.duration)
    expected = source.windows(config.window)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=args.out.parent) as folder:
        bag = Path(folder) / "recording"
        encoder = MessageEncoder(ros1=False)
        write_bag(bag, encoder, source.topics(encoder), progress=True)
        observed = replay_through_node(bag, args.rate)
    report = {
        "machine": machine(),
        "load_average_at_start": load,
        "versions": versions(),
        "middleware": get_rmw_implementation_identifier(),
        "scene": args.scene,
        "seed": args.seed,
        "camera": f"{simulated.camera.width}x{simulated.camera.height}",
        "duration_s": args.duration,
        "simulated_s": seconds,
        "rate": args.rate,
        "configuration": config.flat(),
        **figures(expected, observed),
    }
    print(table(report))
    args.out.write_text(json.dumps(report, indent=2) + "\n")
    print(f"written to {args.out}")


def figures(expected: Mapping[int, int], observed: Observed) -> dict[str, Any]:
    """Compute everything that is reported.

    Args:
        expected: time of each window's last event by the window's end, ns.
        observed: one run over these windows.

    Raises:
        InputError: no events came, or the run was too short.
    """
    if len(observed.publications) < 2:
        raise InputError("replay", "no events came over DDS", "see its message above")
    (first, began), *_, (last, ended) = observed.publications
    received = _by_window(expected, observed.twists)
    latencies = _latencies_ms(expected, observed.publications, received)
    measured = [ms for ms in latencies[WARM_UP_WINDOWS:] if ms is not None]
    p50, p95, largest = np.percentile(measured, [50, 95, 100]) if measured else [None] * 3
    samples = observed.samples
    both = [
        Sample(a.time, a.resident_mb + b.resident_mb, a.cpu_s + b.cpu_s)
        for a, b in zip(samples["node"], samples["worker"], strict=True)
    ]
    return {
        "listening_s": observed.listening_s,
        "replayed_at": (last - first) / NS_PER_S / (ended - began),
        "windows": {
            "expected": len(expected),
            "estimated": len(received),
            "dropped": int(observed.diagnostics["windows_dropped"]),
        },
        "warm_up_ms": latencies[:WARM_UP_WINDOWS],
        "latency_ms": {"windows": len(measured), "p50": p50, "p95": p95, "max": largest},
        "processes": {
            role: _usage(taken) for role, taken in {"node + worker": both, **samples}.items()
        },
        "diagnostics": observed.diagnostics,
    }


def _by_window(expected: Mapping[int, int], twists: Mapping[int, float]) -> dict[int, float]:
    """Return the reception of each window's twist by the window's end.

    A twist holds at the middle of the window's latest part, whose length the estimator chooses:
    not before the middle of the whole window. With strides of at least half a window it belongs
    to the first window that ends after it.
    """
    ends = sorted(expected)
    owners = np.searchsorted(ends, list(twists), side="right")
    return {
        ends[k]: received
        for k, received in zip(owners, twists.values(), strict=True)
        if k < len(ends)
    }


def _latencies_ms(
    expected: Mapping[int, int],
    publications: Sequence[tuple[int, float]],
    received: Mapping[int, float],
) -> list[float | None]:
    """From each window's last event to its twist; None where one of them did not come."""
    ends = [last for last, _ in publications]
    latencies: list[float | None] = []
    for window, last in expected.items():
        k = int(np.searchsorted(ends, last))
        # What came before the subscription is not known, so the first message bounds nothing.
        known = 0 < k < len(ends) and window in received
        published = publications[k][1] if known else None
        latencies.append(None if published is None else 1e3 * (received[window] - published))
    return latencies


def _usage(samples: Sequence[Sample]) -> dict[str, Any]:
    """Sum up a process; its growth is that of the later half, when all buffers are filled."""
    if len(samples) < MIN_SAMPLES:
        raise InputError("--duration", "too short for its memory", "give a longer one")
    first, last, later = samples[0], samples[-1], samples[len(samples) // 2 :]
    minutes = [s.time / 60 for s in later]
    return {
        "resident_mb_max": max(s.resident_mb for s in samples),
        "growth_mb_per_min": float(linregress(minutes, [s.resident_mb for s in later]).slope),
        "cores": (last.cpu_s - first.cpu_s) / (last.time - first.time),
        "resident_mb": [round(s.resident_mb, 1) for s in samples],
    }


def table(report: Mapping[str, Any]) -> str:
    """Lay a report out for people, targets and results side by side."""
    windows, latency, usage = report["windows"], report["latency_ms"], report["processes"]
    both = usage["node + worker"]
    long_enough = len(both["resident_mb"]) >= MIN_SAMPLES_FOR_GROWTH
    flat = TARGET_GROWTH_MB_PER_MIN if long_enough else None
    slower = 100 * (1 - report["replayed_at"] / report["rate"])
    rows: list[tuple[str, float | None, float | None]] = [
        (f"replay slower than {report['rate']:g}x, %", TARGET_SLOWER_PERCENT, slower),
        ("windows expected", None, windows["expected"]),
        ("  of these without a twist", 0, windows["expected"] - windows["estimated"]),
        ("  of these dropped", 0, windows["dropped"]),
        ("last event to twist, median, ms", None, latency["p50"]),
        ("last event to twist, 95 %, ms", TARGET_P95_MS, latency["p95"]),
        ("last event to twist, longest, ms", None, latency["max"]),
        ("memory of node + worker, MB", TARGET_MEMORY_MB, both["resident_mb_max"]),
        ("its growth in the later half, MB/min", flat, both["growth_mb_per_min"]),
    ]
    lines = [
        f"{report['scene']}, {report['camera']}, {report['duration_s']:g} s replayed at "
        f"{report['replayed_at']:.3f}x, {report['machine']['processor']}, load before "
        f"{report['load_average_at_start']:.1f}",
        f"\n{'':<38}{'target':>9}{'result':>9}",
    ]
    lines += [
        f"{label:<38}{_number(target):>9}{_number(value):>9}  {verdict(value, target)}".rstrip()
        for label, target, value in rows
    ]
    warm_up = ", ".join(map(_number, report["warm_up_ms"]))
    lines += [
        f"not among the latencies: the first {WARM_UP_WINDOWS} windows, {warm_up} ms",
        f"from the node's start until it listened: {report['listening_s']:.1f} s",
        f"\n{'process':<16}{'MB':>9}{'MB/min':>9}{'cores':>9}",
    ]
    for role, figures in usage.items():
        keys = ("resident_mb_max", "growth_mb_per_min", "cores")
        lines.append(f"{role:<16}" + "".join(f"{_number(figures[key]):>9}" for key in keys))
    if not long_enough:
        lines.append(f"growth is judged from {MIN_SAMPLES_FOR_GROWTH * SAMPLE_S:g} s on")
    if windows["expected"] < MIN_WINDOWS:
        lines.append(f"fewer than {MIN_WINDOWS} windows: a check, not a result")
    return "\n".join(lines)


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.2f}"


if __name__ == "__main__":
    sys.exit(main())
