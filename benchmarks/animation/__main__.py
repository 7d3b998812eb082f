"""Draw the README's animation: events, sharpened events, flow, and the twist as it comes in.

Without INPUT a simulated flight is estimated, else a recording. One picture per window. The band is
2 standard deviations of the published covariance, the line the estimate, white dots are the truth
where it is known. The ending of --out chooses the format: .webp, .gif or .png (animated).
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks._scoring import SimulatedTruth
from benchmarks.animation.drawing import FORMATS, Flight, Step, frame, save
from emoflow_ros.cli import run
from emoflow_ros.config import load_config
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.factory import make_estimator
from emoflow_ros.readers import open_recording, require_camera
from emoflow_ros.simulation.recording import SCENES, simulate
from emoflow_ros.truth import load_truth

MOST_BYTES = 3_000_000


def main() -> int:
    """Run the command."""
    return run(lambda: _animate(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.animation",
        description=__doc__,
        epilog="example: python -m benchmarks.animation recording.bag --out out/recording.gif",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("input", nargs="?", type=Path, metavar="INPUT", help="a recording (default: simulated)")
    add("--calib", type=Path, metavar="FILE", help="calibration, if the recording has none")
    add("--gt", type=Path, nargs="+", default=[], metavar="GT", help="ground truth")
    add("--scene", choices=SCENES, default="forward", metavar="SCENE", help="default: forward")
    add("--seed", type=int, default=0, help="of the scene (default: 0)")
    add("--duration", type=float, default=2.5, metavar="S", help="default: 2.5")
    add("--profile", default="realtime", help="default: realtime")
    add("--pace", type=float, default=0.5, help="times real time (default: 0.5)")
    add("--out", type=Path, default=Path("docs/images/flight.webp"), metavar="FILE",
        help="default: docs/images/flight.webp")  # fmt: skip
    return parser


def _animate(args: argparse.Namespace) -> None:
    if args.out.suffix not in FORMATS:
        raise InputError("--out", f"'{args.out.suffix}'", f"give one of {', '.join(FORMATS)}")
    if not 0.01 <= args.pace <= 10:
        raise InputError("--pace", f"{args.pace:g}", "give a factor in [0.01, 10]")
    flight = _recorded(args) if args.input else _simulated(args)
    steps = list(estimated(flight, args.profile))
    if not any(step.estimate.flow for step in steps):
        raise InputError(args.input or args.scene, "no window has a flow", "give another recording")
    frames = [frame(flight, steps, i) for i in tqdm(range(len(steps)), "frames", file=sys.stderr)]
    gaps = np.diff([step.estimate.t for step in steps]) if len(steps) > 1 else [10**8]
    save(args.out, frames, float(np.median(gaps)) / NS_PER_MS / args.pace)
    size = args.out.stat().st_size
    print(f"{len(frames)} frames, {size / 1e6:.2f} MB: {args.out}")
    if size > MOST_BYTES:
        print(f"more than {MOST_BYTES / 1e6:g} MB: give a shorter --duration", file=sys.stderr)


def _simulated(args: argparse.Namespace) -> Flight:
    recording = simulate(args.scene, duration_s=args.duration, seed=args.seed, progress=True)
    return Flight(recording.camera, recording.events, SimulatedTruth(recording.truth))


def _recorded(args: argparse.Namespace) -> Flight:
    with open_recording(args.input, calibration=args.calib) as recording:
        camera = require_camera(recording)
        twists = load_truth(recording, args.gt).twists
        parts: list[Events] = []
        for events in filter(len, recording.event_chunks()):
            parts.append(events)
            if events.t[-1] - parts[0].t[0] > args.duration * NS_PER_S:
                break
    events = Events.concatenate(parts)
    return Flight(camera, events[events.t < events.t[0] + int(args.duration * NS_PER_S)], twists)


def estimated(flight: Flight, profile: str) -> Iterator[Step]:
    """Estimate the windows of a flight one after the other."""
    config = load_config(profile)
    estimator = make_estimator(flight.camera, config)
    for window in WindowSlicer(config.window).push(flight.events):
        estimate = estimator.estimate(window)
        yield Step(window.since(estimate.t_start), estimate)


if __name__ == "__main__":
    sys.exit(main())
