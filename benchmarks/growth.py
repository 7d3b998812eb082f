"""Measure how the time of a warm window grows with its events and with the camera's pixels.

Windows are of the calm scene, 90 ms long, on one thread; the time is that of the whole estimate
and the flow image. More events come from lower contrast thresholds, more pixels from the same
lens over a finer sensor. The events of each window are thinned evenly to the number wanted.

Linear is what is nowhere further than 10 % from the straight line through all points. (With growth
by the power 1.1 from 10 k to 1 M events a point would be 12 % off.)
"""

import argparse
import gc
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import psutil
from matplotlib.figure import Figure
from scipy.stats import linregress
from tqdm import tqdm

from benchmarks._event_loop import scaled_camera
from benchmarks._rows import Row, lay_out
from benchmarks.realtime import record, timed, use_one_thread
from emoflow_ros.cli import run
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.types.events import Window, WindowPolicy
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import machine, versions
from emoflow_ros.simulation.recording import davis346
from emoflow_ros.simulation.sensor import SensorModel

SCENE, SEED = "calm", 0
EVENTS = (10_000, 30_000, 100_000, 300_000, 1_000_000)
EVENTS_PER_SIZE = 30_000
SIZES = ((320, 240), (346, 260), (640, 480), (1280, 720))
LINEAR_PERCENT = 10.0  # target: how far a point may be off the line
# Gives well over a million events in 90 ms.
SENSITIVE = SensorModel(threshold_on=0.02, threshold_off=0.02, refractory_us=0)


@dataclass(frozen=True)
class Point:
    """One measurement.

    Attributes:
        label: for people.
        events: per window.
        pixels: of the camera.
        unknowns: of the flow lattice.
        warm_ms: median over the warm windows.
        warm_windows: how many there were.
        resident_mib: memory of the whole process afterwards, with its windows and libraries.
    """

    label: str
    events: int
    pixels: int
    unknowns: int
    warm_ms: float
    warm_windows: int
    resident_mib: float


@dataclass(frozen=True)
class Line:
    """Least squares of milliseconds = intercept_ms + slope_ms * size.

    Attributes:
        r_squared: share of the variance that the line explains.
        largest_deviation_percent: of a measurement from the line.
    """

    slope_ms: float
    intercept_ms: float
    r_squared: float
    largest_deviation_percent: float

    @classmethod
    def through(cls, sizes: Sequence[int], milliseconds: Sequence[float]) -> "Line":
        """Fit measurements at two sizes or more."""
        fit = linregress(sizes, milliseconds)
        measured = np.asarray(milliseconds)
        off = np.abs(fit.intercept + fit.slope * np.asarray(sizes) - measured) / measured
        slope, intercept, r_squared = map(float, (fit.slope, fit.intercept, fit.rvalue**2))
        return cls(slope, intercept, r_squared, 100 * float(off.max()))


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="example: python benchmarks/growth.py --windows 20",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--windows", type=int, default=10, help="per measurement (default: 10)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/benchmarks/growth.json"),
        help="the plot lies beside it (default: out/benchmarks/growth.json)",
    )
    return parser


def _measure(args: argparse.Namespace) -> None:
    if args.windows < 2:
        raise InputError("--windows", f"{args.windows}", "give at least 2: the first one is cold")
    use_one_thread()
    at_start = resident_mib()
    by_events = _with_bar("events", measure_events(EVENTS, args.windows), len(EVENTS))
    by_pixels = _with_bar("pixels", measure_sizes(SIZES, args.windows), len(SIZES))
    lines = {
        "events": Line.through([p.events for p in by_events], [p.warm_ms for p in by_events]),
        "pixels": Line.through([p.pixels for p in by_pixels], [p.warm_ms for p in by_pixels]),
    }
    report = {
        "machine": machine(),
        "threads": 1,
        "load_average_at_end": os.getloadavg()[0],
        "versions": versions(),
        "scene": SCENE,
        "seed": SEED,
        "windows": args.windows,
        "resident_mib_at_start": at_start,
        "by_events": [asdict(point) for point in by_events],
        "by_pixels": [asdict(point) for point in by_pixels],
        "lines": {name: asdict(line) for name, line in lines.items()},
        "rows": [row(name, line).as_dict() for name, line in lines.items()],
    }
    print(table("events", by_events, lines["events"]))
    print(table("pixels", by_pixels, lines["pixels"]))
    print(f"resident at the start, torch and other libraries alone: {at_start:.0f} MiB")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(report, indent=2) + "\n")
    plot = args.out.with_suffix(".png")
    draw(by_events, by_pixels, lines).savefig(plot, dpi=150)
    print(f"written to {args.out} and {plot}")


def _with_bar(name: str, points: Iterator[Point], total: int) -> list[Point]:
    return list(tqdm(points, desc=name, total=total, file=sys.stderr))


def measure_events(counts: Sequence[int], windows: int) -> Iterator[Point]:
    """Yield one point per number of events, on a DAVIS346."""
    camera = davis346("none")
    full = record(SCENE, SEED, WindowPolicy(), windows, camera=camera, sensor=SENSITIVE)[1]
    cases = [[thinned(window, count) for window in full] for count in counts]
    del full  # far larger than what is measured
    for count, case in zip(counts, cases, strict=True):
        yield _point(f"{count // 1000}k events", camera, case)


def measure_sizes(sizes: Sequence[tuple[int, int]], windows: int) -> Iterator[Point]:
    """Yield one point per sensor size (width, height), with EVENTS_PER_SIZE events each."""
    for width, height in sizes:
        camera = scaled_camera(width, height)
        full = record(SCENE, SEED, WindowPolicy(), windows, camera=camera)[1]
        case = [thinned(window, EVENTS_PER_SIZE) for window in full]
        del full  # far larger than what is measured
        yield _point(f"{width}x{height}", camera, case)


def thinned(window: Window, count: int) -> Window:
    """Keep `count` events, evenly spread over the window's.

    Raises:
        ValueError: the window has fewer.
    """
    if len(window.events) < count:
        raise ValueError(f"the window has {len(window.events)} events, {count} are needed")
    chosen = window.events[np.arange(count) * len(window.events) // count]
    return Window(window.t_start, window.t_end, chosen)


def _point(label: str, camera: Camera, windows: Sequence[Window]) -> Point:
    """Estimate windows of equally many events one after another."""
    count = len(windows[0].events)
    estimator = LatticeEstimator(camera, LatticeConfig(max_events=count))
    for window in windows[:2]:  # compiles, where that was not done before
        estimator.estimate(window)
    estimator.reset()
    runs = [timed(estimator, window) for window in windows]
    warm = [1e3 * run.seconds for run in runs if run.estimate.quality.warm]
    if not warm:
        raise InputError(label, "not one warm window", "give more --windows")
    return Point(
        label,
        count,
        camera.width * camera.height,
        estimator.lattice.unknowns,
        float(np.median(warm)),
        len(warm),
        resident_mib(),
    )


def resident_mib() -> float:
    """Memory that this process holds now, MiB."""
    gc.collect()
    return float(psutil.Process().memory_info().rss / 2**20)


def table(name: str, points: Sequence[Point], line: Line) -> str:
    """Lay one series out for people."""
    rows = [f"{'':<16}{'events':>9}{'pixels':>9}{'unknowns':>10}{'warm ms':>9}{'MiB':>7}"]
    rows += [
        f"{p.label:<16}{p.events:>9}{p.pixels:>9}{p.unknowns:>10}{p.warm_ms:>9.1f}"
        f"{p.resident_mib:>7.0f}"
        for p in points
    ]
    rows += [
        f"line: {line.intercept_ms:.1f} ms + {1e5 * line.slope_ms:.2f} ms per 100 000 {name}, "
        f"R^2 {line.r_squared:.4f}",
        f"{lay_out([row(name, line)])}\n",
    ]
    return "\n".join(rows)


def row(name: str, line: Line) -> Row:
    """Hold a line against its target."""
    figure = f"growth with {name}: furthest point off the line, %"
    return Row(figure, line.largest_deviation_percent, LINEAR_PERCENT)


def draw(by_events: Sequence[Point], by_pixels: Sequence[Point], lines: dict[str, Line]) -> Figure:
    """Plot both series with their lines."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, name, points in ((left, "events", by_events), (right, "pixels", by_pixels)):
        sizes = np.array([getattr(point, name) for point in points])
        line = lines[name]
        axes.plot(sizes, [p.warm_ms for p in points], "o", label="warm window, median")
        ends = np.array([0, sizes.max()])
        fit = f"line, $R^2$ = {line.r_squared:.4f}"
        axes.plot(ends, line.intercept_ms + line.slope_ms * ends, label=fit)
        axes.set(xlabel=name, ylabel="ms", xlim=(0, None), ylim=(0, None))
        axes.legend()
    left.set_title("346x260 px")
    right.set_title(f"{EVENTS_PER_SIZE} events")
    return figure


if __name__ == "__main__":
    sys.exit(main())
