"""Measure time and accuracy of the real-time estimator on simulated scenes, beside the targets.

Everything runs on one thread. A window's time is that of the whole estimate, covariance
included, and of the flow image at the window's middle. EPE and outliers are over the pixels with
events, averaged per window and then over windows; errors of w are over windows and axes. The
published loop is timed on a window of the same run.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import torch
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from benchmarks._rows import Row, verdict
from benchmarks._scoring import (
    MEASURES,
    MIN_WINDOWS,
    PAPER_SPEED_UP,
    SCENES,
    Score,
    SimulatedTruth,
    normalised_errors,
    summarise,
)
from benchmarks.paper import CONTRAST_ONLY as PAPER_CONTRAST_ONLY
from benchmarks.paper import ITERATIONS as PAPER_ITERATIONS
from benchmarks.paper import time_iterations as time_paper_loop
from emoflow_ros.cli import run
from emoflow_ros.config import Config, load_config
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.estimate import Estimate, Estimator
from emoflow_ros.core.types.events import NS_PER_S, Window, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import machine, versions
from emoflow_ros.evaluation.window_results import assess
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from emoflow_ros.truth import Truth

# Published with early stopping: 17.85 s of 38.98 s, summed over four MVSEC sequences.
PAPER_EARLY_STOP = round(PAPER_ITERATIONS * 17.85 / 38.98)


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="example: python benchmarks/realtime.py --scenes calm agile --seeds 0 1 2",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--scenes", nargs="+", default=SCENES, choices=SCENES, metavar="SCENE", help="default: all"
    )
    parser.add_argument(
        "--seeds", nargs="+", type=int, default=range(5), metavar="SEED", help="default: 0 to 4"
    )
    parser.add_argument("--windows-per-seed", type=int, default=18, help="default: 18")
    parser.add_argument(
        "--cold-every", type=int, default=3, help="time each n-th window cold, too (default: 3)"
    )
    parser.add_argument(
        "--paper-iterations", type=int, default=3, help="of each of its phases (default: 3)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/benchmarks/realtime.json"),
        help="default: out/benchmarks/realtime.json",
    )
    return parser


def _measure(args: argparse.Namespace) -> None:
    for name in ("windows_per_seed", "cold_every", "paper_iterations"):
        if getattr(args, name) < 1:
            raise InputError(f"--{name.replace('_', '-')}", "less than 1", "give at least 1")
    use_one_thread()
    config = load_config("realtime")
    load = os.getloadavg()[0]
    scores: dict[str, dict[int, list[Score]]] = {scene: {} for scene in args.scenes}
    runs = [(scene, seed) for scene in args.scenes for seed in args.seeds]
    for scene, seed in tqdm(runs, desc="recordings", file=sys.stderr):
        recording, windows = record(scene, seed, config.window, args.windows_per_seed)
        scores[scene][seed] = score(recording, windows, config, args.cold_every)
    scenes = {name: summarise(name, by_seed) for name, by_seed in scores.items()}
    report = {
        "machine": machine(),
        "threads": 1,
        "load_average_at_start": load,
        "versions": versions(),
        "seeds": list(args.seeds),
        "windows_per_seed": args.windows_per_seed,
        "configuration": config.flat(),
        "scenes": scenes,
        # The last recording's last window stands for all: the loop's cost does not depend on it.
        "paper": compare_with_paper(
            scene,
            windows[-1],
            args.paper_iterations,
            scenes[scene]["all"]["warm_ms"],
        ),
    }
    report["rows"] = [row.as_dict() for row in rows(report)]
    print(table(report))
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(report, indent=2) + "\n")
    print(f"written to {args.out}")


def use_one_thread() -> None:
    """Keep numba, torch and the linear algebra library to one thread each."""
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    threadpool_limits(limits=1)


def record(
    scene: str, seed: int, policy: WindowPolicy, count: int, **options: Any
) -> tuple[SimulatedRecording, list[Window]]:
    """Simulate a scene and cut it into `count` windows; `options` go to the simulator."""
    # A window is complete with the first event after it, hence the further 10 ms.
    duration_s = ((count - 1) * policy.stride_ns + policy.duration_ns) / NS_PER_S + 0.01
    recording = simulate(scene, duration_s=duration_s, seed=seed, **options)
    return recording, WindowSlicer(policy).push(recording.events)[:count]


class Timed(NamedTuple):
    """An estimate and what it took, its flow image included, which alone took `flow_seconds`."""

    estimate: Estimate
    seconds: float
    flow_seconds: float


def timed(estimator: Estimator, window: Window) -> Timed:
    """Estimate a window and draw its flow image, if it has a flow."""
    start = time.perf_counter()
    estimate = estimator.estimate(window)
    estimated = time.perf_counter()
    if estimate.flow is None:
        return Timed(estimate, estimated - start, float("nan"))
    estimate.flow.velocity(estimate.t)
    end = time.perf_counter()
    return Timed(estimate, end - start, end - estimated)


def score(
    recording: SimulatedRecording, windows: Sequence[Window], config: Config, cold_every: int
) -> list[Score]:
    """Estimate the windows one after another, some of them cold, too, and assess them."""
    estimator = make_estimator(recording.camera, config)
    for window in windows[:2]:  # compiles, where that was not done before
        estimator.estimate(window)
    estimator.reset()
    budget = EventBudget(config.window, config.estimator.max_events)
    thinned = [budget.thin(window) for window in windows]  # as the node does before the worker
    runs = [timed(estimator, window) for window in thinned]
    cold_seconds = np.full(len(windows), np.nan)
    for k in range(0, len(windows), cold_every):
        cold_seconds[k] = timed(make_estimator(recording.camera, config), thinned[k]).seconds
    simulated = SimulatedTruth(recording.truth)
    scores = []
    for k, (window, warm) in enumerate(zip(windows, runs, strict=True)):
        estimate = warm.estimate
        part = window.since(estimate.t_start)
        result = assess(k, part, estimate, Truth(simulated, simulated))
        nees_w, nees_v = normalised_errors(estimate, result)
        scores.append(
            Score(result, warm.seconds, warm.flow_seconds, float(cold_seconds[k]), nees_w, nees_v)
        )
    return scores


def compare_with_paper(
    scene: str, window: Window, iterations: int, warm_ms: float | None
) -> dict[str, Any]:
    """Time the published loop's iterations on a window, and extrapolate to whole fits.

    Args:
        scene: where the window is from.
        window: also one of those that were estimated.
        iterations: how many are timed, with the contrast alone and with both losses.
        warm_ms: median time of the scene's warm windows.
    """
    timing = time_paper_loop(window, {"device": "cpu"}, iterations)
    comparison: dict[str, Any] = {
        "scene": scene,
        "events": min(len(window.events), 30_000),
        "iterations_measured_per_phase": iterations,
        "seconds_per_iteration": vars(timing),
        "note": "seconds = iterations x measured seconds per iteration; the loop was not run to "
        "its end here; profiles.py does so, and has EPE and speed on the same windows",
    }
    for name, count in (("full", PAPER_ITERATIONS), ("early_stopping", PAPER_EARLY_STOP)):
        dec = count - PAPER_CONTRAST_ONLY
        seconds = PAPER_CONTRAST_ONLY * timing.contrast + dec * timing.contrast_and_dec
        comparison[name] = {
            "iterations": count,
            "seconds": seconds,
            "over_warm_window": 1e3 * seconds / warm_ms if warm_ms else None,
        }
    return comparison


def rows(report: Mapping[str, Any]) -> list[Row]:
    """Hold what has a target against it, over all seeds."""
    found = [
        Row(f"{scene}: {m.label}", figures["all"][m.key], figures["targets"][m.key])
        for scene, figures in report["scenes"].items()
        for m in MEASURES
        if m.key in figures["targets"]
    ]
    loop = report["paper"]["full"]
    label = f"published loop, {loop['iterations']} iterations, over a warm window"
    return [*found, Row(label, loop["over_warm_window"], at_least=PAPER_SPEED_UP)]


def table(report: Mapping[str, Any]) -> str:
    """Lay a report out for people, targets and results side by side."""
    processor, threads = report["machine"]["processor"], report["threads"]
    lines = [f"{processor}, {threads} thread, seeds {report['seeds']}"]
    for scene, figures in report["scenes"].items():
        over_all = figures["all"]
        lines.append(
            f"\n{scene}: {over_all['windows']} windows, {over_all['events_used']:.0f} of "
            f"{over_all['events']:.0f} events used, models {over_all['models']}"
        )
        lines.append(f"  {'':<42}{'target':>9}{'all seeds':>11}{'worst seed':>12}")
        for measure in MEASURES:
            target = figures["targets"].get(measure.key)
            value, worst = over_all[measure.key], figures["worst_seed"][measure.key]
            numbers = f"{_number(target):>9}{_number(value):>11}{_number(worst):>12}"
            lines.append(f"  {measure.label:<42}{numbers}  {verdict(value, target)}".rstrip())
        if over_all["windows"] < MIN_WINDOWS:
            lines.append(f"  fewer than {MIN_WINDOWS} windows: a check, not a result")
    return "\n".join([*lines, "", *_paper_lines(report["paper"])])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}" if abs(value) < 1000 else f"{value:.3g}"


def _paper_lines(paper: Mapping[str, Any]) -> list[str]:
    seconds = paper["seconds_per_iteration"]
    lines = [
        f"published loop on a window of {paper['scene']}: {seconds['contrast']:.2f} s per iteration"
        f" with the contrast alone, {seconds['contrast_and_dec']:.2f} s with both losses",
        f"  {paper['note']}",
    ]
    for name in ("full", "early_stopping"):
        fit = paper[name]
        ratio = fit["over_warm_window"]
        met = "missed" if ratio is None or ratio < PAPER_SPEED_UP else "met"
        lines.append(
            f"  {fit['iterations']} iterations x measured = {fit['seconds']:.0f} s, "
            f"{ratio or 0:.0f} x the warm window; target {PAPER_SPEED_UP:.0f} x: {met}"
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
