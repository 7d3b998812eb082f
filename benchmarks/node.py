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
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier, try_shutdown
from scipy.stats import linregress

from benchmarks._scoring import MIN_WINDOWS, SCENES, verdict
from emoflow_ros.cli import run
from emoflow_ros.core.config import load_config
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.node.discovery import import_message_type
from emoflow_ros.offline.provenance import machine, versions
from emoflow_ros.simulation.bags import Topic, write_bag
from emoflow_ros.simulation.messages import CAMERA_INFO, EVENT_ARRAY, MessageEncoder
from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from msg_adapters import make_decoder

START = 1_500_000_000 * NS_PER_S
LONGEST_SIMULATED_S = 10.0
BATCH = 10 * NS_PER_MS
CAMERA_INFO_PERIOD = 50 * NS_PER_MS
LEAD_IN = 2 * NS_PER_S  # calibration alone, so that the observer, too, hears the first events
EVENTS = "/davis/left/events"
DOMAIN = "87"
WARM_UP_WINDOWS = 3  # the first one is cold, the next ones meet what it leaves behind
SAMPLE_S = 1.0
MIN_SAMPLES = 3
MIN_SAMPLES_FOR_GROWTH = 60  # for its target to mean something
QUIET_S = 3.0  # for the windows that wait, and the diagnostics after them
WAIT_S = 180.0  # the first start on a machine compiles
STOP_S = 5.0

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
    add("--duration", type=float, default=10.0, metavar="S", help="seconds (default: 10)")
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


class RepeatedRecording:
    """A recording over and over, each time later by its length, in batches of 10 ms.

    Args:
        recording: what is repeated.
        duration_s: of the whole.
    """

    def __init__(self, recording: SimulatedRecording, duration_s: float) -> None:
        self._recording = recording
        self._length = (recording.t_end - recording.t_start) // BATCH * BATCH
        self._end = recording.t_start + round(duration_s * NS_PER_S)

    @property
    def batch_ends(self) -> range:
        """Times (ns) at which a batch ends and is published."""
        return range(self._recording.t_start + BATCH, self._end + 1, BATCH)

    def batch(self, end: int) -> Events:
        """Return the events of the 10 ms before `end`."""
        events = self._recording.events
        begin = end - BATCH
        shift = (begin - self._recording.t_start) // self._length * self._length
        first, last = np.searchsorted(events.t, [begin - shift, end - shift])
        part = events[first:last]
        return Events(part.x, part.y, part.t + shift, part.p)

    def topics(self, encoder: MessageEncoder) -> list[Topic]:
        """List what the node needs: events and calibration."""
        camera = self._recording.camera
        infos = range(self._recording.t_start - LEAD_IN, self._end, CAMERA_INFO_PERIOD)

        def encode_events(end: int) -> bytes:
            return encoder.events(end - BATCH, camera, self.batch(end))

        return [
            Topic(EVENTS, EVENT_ARRAY, self.batch_ends, encode_events),
            Topic(
                EVENTS.replace("events", "camera_info"),
                CAMERA_INFO,
                infos,
                lambda t: encoder.camera_info(t, camera),
            ),
        ]

    def windows(self, policy: WindowPolicy) -> dict[int, int]:
        """Return the time of each window's last event by the window's middle, ns."""
        slicer = WindowSlicer(policy)
        return {
            (window.t_start + window.t_end) // 2: int(window.events.t[-1])
            for end in self.batch_ends
            for window in slicer.push(self.batch(end))
        }


@dataclass(frozen=True)
class Sample:
    """What a process holds and has used.

    Attributes:
        time: Unix time, s.
        resident_mb: memory, MB (10^6 bytes).
        cpu_s: user and system time since its start.
    """

    time: float
    resident_mb: float
    cpu_s: float

    @classmethod
    def of(cls, role: str, pid: int) -> "Sample":
        """Read a process from /proc.

        Raises:
            InputError: it has ended.
        """
        try:
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
            # Field 2, the name in parentheses, may hold blanks; utime and stime are 14 and 15.
            stat = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            raise InputError(role, "ended during the run", "see its message above") from None
        ticks = int(stat[11]) + int(stat[12])
        resident = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
        return cls(time.time(), resident, ticks / os.sysconf("SC_CLK_TCK"))


@dataclass
class Observed:
    """What came over DDS, in Unix time, and what the processes used.

    Attributes:
        publications: (time of the message's last event in ns, publication in s).
        twists: reception in s by stamp in ns.
        diagnostics: the node's last numbers.
        listening_s: from the start of the node's process to its subscription.
        samples: by role, one each SAMPLE_S of the replay.
    """

    publications: list[tuple[int, float]] = field(default_factory=list)
    twists: dict[int, float] = field(default_factory=dict)
    diagnostics: dict[str, str] = field(default_factory=dict)
    listening_s: float = float("nan")
    samples: dict[str, list[Sample]] = field(default_factory=dict)


class Observer(Node):
    """Fills `observed`."""

    def __init__(self) -> None:
        super().__init__("benchmark")
        self.observed = Observed()
        self._decoder = make_decoder(EVENT_ARRAY, "cdr")
        self.twists: Subscription = self.create_subscription(
            TwistStamped, "/egomotion/twist", self._take_twist, 1000
        )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, 10)

    def watch_events(self) -> None:
        """Subscribe to the events, too: only after the node, for which `replay` waits."""
        message_type = import_message_type(EVENT_ARRAY)
        self.create_subscription(message_type, EVENTS, self._take_events, 1000, raw=True)

    def watch_processes(self, pids: Mapping[str, int]) -> None:
        """Sample processes, given by role, from now on."""
        samples = self.observed.samples
        samples.update({role: [] for role in pids})

        def sample() -> None:
            for role, pid in pids.items():
                samples[role].append(Sample.of(role, pid))

        self._sampling = self.create_timer(SAMPLE_S, sample)

    def watch_processes_no_longer(self) -> None:
        """End the sampling."""
        self.destroy_timer(self._sampling)

    def _take_twist(self, message: TwistStamped, info: Mapping[str, int]) -> None:
        stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        self.observed.twists[stamp] = info["received_timestamp"] / NS_PER_S

    def _take_events(self, data: bytes, info: Mapping[str, int]) -> None:
        events = self._decoder.decode(data).events
        if len(events):
            published = info["source_timestamp"] / NS_PER_S
            self.observed.publications.append((int(events.t[-1]), published))

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        self.observed.diagnostics = {v.key: v.value for v in message.status[0].values}


def replay_through_node(bag: Path, rate: float) -> Observed:
    """Run the node and `replay` until all twists have come.

    Raises:
        InputError: a process ended too early, or the node did not listen in time.
    """
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        observer = Observer()
        observed = observer.observed
        started = time.monotonic()
        with _running("estimator") as node:
            _spin_until(observer.twists.get_publisher_count, observer, node)
            with _running("replay", str(bag), "--rate", f"{rate}", "--wait", f"{WAIT_S}") as replay:
                _spin_until(lambda: observer.count_subscribers(EVENTS), observer, node, replay)
                observed.listening_s = time.monotonic() - started
                observer.watch_events()
                observer.watch_processes(_pids(node.pid) | {"replay": replay.pid})
                while replay.poll() is None:
                    rclpy.spin_once(observer, timeout_sec=0.1)
                observer.watch_processes_no_longer()
                if replay.returncode:
                    raise InputError(
                        "replay", f"exit code {replay.returncode}", "see its message above"
                    )
            ended = time.monotonic()
            _spin_until(lambda: time.monotonic() - ended > QUIET_S, observer, node)
        return observed
    finally:
        try_shutdown()


def _spin_until(
    condition: Callable[[], Any], observer: Observer, *processes: subprocess.Popen[bytes]
) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        for process in processes:
            if process.poll() is not None:
                raise InputError(
                    Path(process.args[0]).name, "ended too early", "see its message above"
                )
        if time.monotonic() > deadline:
            raise InputError("estimator", f"silent for {WAIT_S:g} s", "see its messages above")
        rclpy.spin_once(observer, timeout_sec=0.02)


@contextmanager
def _running(name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run an executable of the package as `ros2 run` does."""
    try:
        path = f"{get_package_prefix('emoflow_ros')}/lib/emoflow_ros/{name}"
    except PackageNotFoundError:
        raise InputError("emoflow_ros", "not installed", "source scripts/env.sh") from None
    process = subprocess.Popen([path, *arguments], start_new_session=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)  # nothing happens if it has ended
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()


def _pids(node: int) -> dict[str, int]:
    """Find the node's processes: the worker is its only grandchild, the server between them."""
    [(server, worker)] = [(child, below) for child in _children(node) for below in _children(child)]
    return {"node": node, "worker": worker, "server": server, "benchmark": os.getpid()}


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


def figures(expected: Mapping[int, int], observed: Observed) -> dict[str, Any]:
    """Compute everything that is reported.

    Args:
        expected: time of each window's last event by the window's middle, ns.
        observed: one run over these windows.

    Raises:
        InputError: no events came, or the run was too short.
    """
    if len(observed.publications) < 2:
        raise InputError("replay", "no events came over DDS", "see its message above")
    (first, began), *_, (last, ended) = observed.publications
    latencies = _latencies_ms(expected, observed)
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
            "estimated": len(expected.keys() & observed.twists.keys()),
            "dropped": int(observed.diagnostics["windows_dropped"]),
        },
        "warm_up_ms": latencies[:WARM_UP_WINDOWS],
        "latency_ms": {"windows": len(measured), "p50": p50, "p95": p95, "max": largest},
        "processes": {
            role: _usage(taken) for role, taken in {"node + worker": both, **samples}.items()
        },
        "diagnostics": observed.diagnostics,
    }


def _latencies_ms(expected: Mapping[int, int], observed: Observed) -> list[float | None]:
    """From each window's last event to its twist; None where one of them did not come."""
    ends = [last for last, _ in observed.publications]
    latencies: list[float | None] = []
    for stamp, last in expected.items():
        k = int(np.searchsorted(ends, last))
        # What came before the subscription is not known, so the first message bounds nothing.
        known = 0 < k < len(ends) and stamp in observed.twists
        published = observed.publications[k][1] if known else None
        latencies.append(None if published is None else 1e3 * (observed.twists[stamp] - published))
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
    rows: list[tuple[str, float | None, float | None]] = [
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
