"""Measure the stream of twists as a subscriber hears it: random recordings through the node.

Each recording is written as a bag of PointCloud2 messages and replayed with the executable `replay`
through the executable `estimator`. What the topics say is compared with the exact truth at the
stamps: the share of the 100 ms intervals after the first twist that have one, while the image moves
(by more than 5 px/s in the median) and at rest, the longest silence, the normalised error squared
of w (NEES, 1 where the covariance is right) and errors beyond 3 standard deviations.
"""

import argparse
import json
import os
import re
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from numpy.typing import NDArray

from benchmarks._event_loop import CALIBRATION, EVENTS, START
from benchmarks._rows import lay_out
from benchmarks._running_node import DOMAIN, Observer, listen_to_replay
from benchmarks._stream_figures import Heard, Stream, figures, rows
from benchmarks.scoreboard.simulated_subjects import DURATION_S, RandomSubject
from benchmarks.scoreboard.subjects import Material
from emoflow_ros.cli import run
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import machine, versions
from emoflow_ros.simulation.messages import CAMERA_INFO, POINT_CLOUD, MessageEncoder
from emoflow_ros.simulation.recording_files import Topic, write_bag

_BATCH = 5 * NS_PER_MS
_LEAD_IN = 2 * NS_PER_S  # of calibration alone, in which all find their topics
_STEP = 5 * NS_PER_MS  # over which the image's true speed is taken


class Subscriber(Observer):
    """Keeps what the twists with covariance say, besides what an Observer keeps."""

    def __init__(self) -> None:
        self.now, self.windows = Heard(), Heard()
        super().__init__()
        self.create_subscription(
            TwistWithCovarianceStamped, "/egomotion/twist_now", self._take_now, 1000
        )

    def _take_now(self, message: TwistWithCovarianceStamped) -> None:
        _keep(self.now, message)

    def _take_with_covariance(self, message: TwistWithCovarianceStamped) -> None:
        super()._take_with_covariance(message)
        _keep(self.windows, message)


def _keep(heard: Heard, message: TwistWithCovarianceStamped) -> None:
    stamp, twist = message.header.stamp, message.twist.twist
    heard.times.append((stamp.sec * NS_PER_S + stamp.nanosec - START) / NS_PER_S)
    heard.angular.append(np.array([twist.angular.x, twist.angular.y, twist.angular.z]))
    heard.covariance.append(np.reshape(message.twist.covariance, (6, 6))[3:, 3:])


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stream",
        description=__doc__,
        epilog="example: python -m benchmarks.stream --seeds 0-7 --profile realtime",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--seeds", default="0-59", help="A-B, of the random recordings (default: 0-59)")
    add("--profile", default="realtime", help="of the node (default: realtime)")
    add(
        "--cache",
        type=Path,
        default=Path("out/accuracy/cache"),
        help="folder of random recordings that were simulated before",
    )
    add("--out", type=Path, default=Path("out/benchmarks/stream.json"))
    return parser


def parse_seeds(text: str) -> range:
    """Parse `A-B`, both included.

    Raises:
        InputError: another form, or no seed.
    """
    match = re.fullmatch(r"(\d+)-(\d+)", text)
    if not match or int(match[1]) > int(match[2]):
        raise InputError("--seeds", f"'{text}' is not A-B with A <= B", "give for example 0-7")
    return range(int(match[1]), int(match[2]) + 1)


def _measure(args: argparse.Namespace) -> None:
    seeds = parse_seeds(args.seeds)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {
        "machine": machine(),
        "load_average_at_start": os.getloadavg()[0],
        "versions": versions(),
        "profile": args.profile,
        "recordings": [],
    }
    for seed in seeds:
        material = RandomSubject(seed, args.cache).load()
        found = _listen(seed, material, args.profile, args.out.parent)
        report["recordings"].append(found)
        print(_line(found), flush=True)
        judged = rows(report["recordings"])
        report["rows"] = [row.as_dict() for row in judged]
        args.out.write_text(json.dumps(report, indent=2) + "\n")  # what is there is kept
    print(f"\n{lay_out(judged)}\nwritten to {args.out}")


def _listen(seed: int, material: Material, profile: str, folder: Path) -> dict[str, Any]:
    arguments = ("--ros-args", "-r", f"events:={EVENTS}", "-p", f"profile:={profile}")
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        bag = Path(temporary) / f"{seed:04d}"
        _write(bag, material)
        heard = listen_to_replay(bag, 1.0, Subscriber, arguments)
    twist = [(stamp - START) / NS_PER_S for stamp, _ in heard.observed.twists]
    stream = Stream(seed, DURATION_S, twist, heard.now, heard.windows, heard.observed.statuses)
    return figures(stream, lambda t: _speed(material, t), lambda t: _angular(material, t))


def _write(bag: Path, material: Material) -> None:
    encoder = MessageEncoder(ros1=False, event_type=POINT_CLOUD)
    camera, events = material.calibration, material.events

    def encode(end: int) -> bytes:
        start = end - START - _BATCH
        first, last = np.searchsorted(events.t, [start, start + _BATCH])
        part = events[first:last]
        return encoder.events(START + start, camera, replace(part, t=part.t + START))

    ends = range(START + _BATCH, START + round(DURATION_S * NS_PER_S) + _BATCH, _BATCH)
    calibrations = range(START - _LEAD_IN, ends[-1], 50 * NS_PER_MS)
    topics = [
        Topic(EVENTS, POINT_CLOUD, ends, encode),
        Topic(CALIBRATION, CAMERA_INFO, calibrations, lambda t: encoder.camera_info(t, camera)),
    ]
    write_bag(bag, encoder, topics, progress=False)


def _speed(material: Material, t: float) -> float:
    """Median speed of the image's static pixels, px/s."""
    flows = material.truth.flows
    assert flows is not None
    start = min(max(0, round(t * NS_PER_S) - _STEP // 2), round(DURATION_S * NS_PER_S) - _STEP)
    true = flows.displacement(start, start + _STEP)
    assert true is not None
    static = true.valid if true.moving is None else true.valid & ~true.moving
    length = np.linalg.norm(true.displacement[static], axis=1)
    return float(np.median(length)) * NS_PER_S / _STEP if len(length) else 0.0


def _angular(material: Material, t: float) -> NDArray[np.float64]:
    twists = material.truth.twists
    assert twists is not None
    true = twists.twist(round(t * NS_PER_S))
    return np.full(3, np.nan) if true is None else true.angular


def _line(found: Mapping[str, Any]) -> str:
    heard = ", ".join(f"{kind} {n} of {of}" for kind, (of, n) in found["intervals"].items())
    errors = ", ".join(
        f"{name}: NEES {found[name]['nees'] or float('nan'):.2f}, "
        f"missed {found[name]['missed_percent'] or 0.0:.1f} %"
        for name in ("now", "windows")
    )
    return f"{found['seed']:4d}: {heard}; silence {found['silence_s']:.2f} s; {errors}"


if __name__ == "__main__":
    sys.exit(main())
