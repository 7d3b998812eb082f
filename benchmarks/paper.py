"""Measure the seconds per iteration of the published loop on this machine, as JSON.

On a GPU there is a target beside them: a fifth of the published 9.75 ms, for the first variant.
"""

import argparse
import json
import os
import platform
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.optim.optimizer import register_optimizer_step_post_hook
from tqdm import tqdm

from benchmarks._rows import verdict
from emoflow_ros.cli import run
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window
from emoflow_ros.core.types.options import replace_options
from emoflow_ros.published.estimator import ImplicitEstimator
from emoflow_ros.published.implicit_config import ImplicitConfig

CAMERA = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)
WINDOW_NS = 90 * NS_PER_MS
ITERATIONS, CONTRAST_ONLY = 1000, 200  # of the published loop
TARGET_CUDA_S = 9.75e-3 / 5
VARIANTS: dict[str, dict[str, Any]] = {
    "paper, 8x256, one Euler step": {},
    "4x256, one Euler step": {"field.layers": 4},
    "8x256, rk4 with 1 step": {"warp.solver": "rk4"},
}


@dataclass(frozen=True)
class Timing:
    """Median seconds per iteration: in the contrast-only phase, and with the DEC."""

    contrast: float
    contrast_and_dec: float


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="example: python benchmarks/paper.py --iterations 9 > paper.json",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--iterations", type=int, default=5, help="per variant and phase (default 5)"
    )
    parser.add_argument("--events", type=int, default=30_000, help="per window (default 30000)")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="default: all cores")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    return parser


def _measure(args: argparse.Namespace) -> None:
    torch.set_num_threads(args.threads)
    window = _window(args.events)
    results = {}
    for name, overrides in tqdm(VARIANTS.items(), desc="variants", file=sys.stderr):
        overrides = {"max_events": args.events, "device": args.device, **overrides}
        results[name] = vars(time_iterations(window, overrides, args.iterations))
    machine = {
        "processor": platform.processor() or platform.machine(),
        "threads": args.threads,
        "torch": torch.__version__,
        "device": args.device,
    }
    report: dict[str, Any] = {"machine": machine, "events": args.events}
    report["seconds_per_iteration"] = results
    if args.device == "cuda":
        report["target"] = compare_with_target(next(iter(results.values())))
    print(json.dumps(report, indent=2))


def compare_with_target(timing: dict[str, float]) -> dict[str, Any]:
    """Hold the mean time per iteration, over the whole loop, against the target."""
    share = CONTRAST_ONLY / ITERATIONS
    mean = share * timing["contrast"] + (1 - share) * timing["contrast_and_dec"]
    return {
        "seconds_per_iteration": TARGET_CUDA_S,
        "result": mean,
        "verdict": verdict(mean, TARGET_CUDA_S),
    }


def _window(count: int) -> Window:
    """Make events at random: the cost does not depend on what they show."""
    rng = np.random.default_rng(0)
    events = Events(
        rng.integers(0, CAMERA.width, count).astype(np.uint16),
        rng.integers(0, CAMERA.height, count).astype(np.uint16),
        np.sort(rng.integers(0, WINDOW_NS, count)),
        np.ones(count, np.bool_),
    )
    return Window(0, WINDOW_NS, events)


def time_iterations(window: Window, overrides: dict[str, Any], iterations: int) -> Timing:
    """Fit once, and take the median time between the optimiser's steps in either phase."""
    values = {
        **overrides,
        "optimizer.iterations": 2 * iterations + 1,
        "loss.contrast_only": iterations + 1,  # the first iteration is slower and not counted
    }
    stamps: list[float] = []

    def record(*_arguments: object) -> None:
        if overrides["device"] == "cuda":
            torch.cuda.synchronize()
        stamps.append(time.perf_counter())

    hook = register_optimizer_step_post_hook(record)
    ImplicitEstimator(CAMERA, replace_options(ImplicitConfig(), values)).estimate(window)
    hook.remove()
    seconds = np.diff(stamps)
    return Timing(float(np.median(seconds[:iterations])), float(np.median(seconds[iterations:])))


if __name__ == "__main__":
    sys.exit(main())
