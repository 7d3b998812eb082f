"""Measure the memory of positions rung by rung, each with the truth below it.

The rung that loses most is the one to work on. Rungs: `tracks`, how far patches are from where they
should be, across their edges, with the true flow; `lines`, the angular velocity that places 80 ms
apart give with the true direction of translation; `truth`, the adjustment from the true flow and
motion, without the lattice's motion as evidence; `starts`, from the true flow and its own starts;
`own`, as it runs but with all events; `lattice`, the estimate without a memory. Writes ladder.json
into --out.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from benchmarks.scoreboard.simulated_subjects import random_subjects
from benchmarks.scoreboard.subjects import SHARED_DATA, Material, Subject, shared_subjects
from emoflow_ros.cli import run
from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera_motion import motion_matrices
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.lattice.motion_windows import MotionWindows
from emoflow_ros.core.odometry import State
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.stream.bounded_windows import BoundedWindows
from emoflow_ros.core.stream.cleaning import CleanWindows, clean
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Window, WindowSlicer
from emoflow_ros.report.documents import write_json

Array = NDArray[np.float64]

RUNGS = ("tracks", "lines", "truth", "starts", "own", "lattice")
_SEEDS = range(14)
_HALF_NS = NS_PER_MS  # on either side of the time at which the true flow is taken
_LAG_NS = 80 * NS_PER_MS
_UNKNOWN = 1e4  # (rad/s)^2, of a motion that is a start and no evidence


@dataclass(frozen=True)
class TrueFlowField:
    """The true flow of a recording (a FlowSampler as far as the memory needs one).

    Attributes:
        material: the recording.
        instead: flow (height, width, 2) px/s where the truth is silent.
        rendered: flows by time, ns: to render one takes long.
    """

    material: Material
    instead: NDArray[np.float32]
    rendered: dict[int, NDArray[np.float32]] = field(default_factory=dict)

    def velocity(self, t: int) -> NDArray[np.float32]:
        """Flow at time t (ns), (height, width, 2) px/s."""
        if t not in self.rendered:
            self.rendered[t] = self._render(t)
        return self.rendered[t]

    def _render(self, t: int) -> NDArray[np.float32]:
        flows = self.material.truth.flows
        true = flows.displacement(t - _HALF_NS, t + _HALF_NS) if flows else None
        if true is None:
            return self.instead
        flow = true.displacement / np.float32(2 * _HALF_NS * 1e-9)
        return np.where(true.valid[..., None], flow, self.instead)

    def tracks(self, points: Array, times: Sequence[int]) -> Array:
        """Positions (len(times), N, 2) px of points (N, 2) given at times[0] (ns), step by step."""
        positions = [points]
        for begin, end in pairwise(times):
            flow = self.velocity(begin)
            height, width = flow.shape[:2]
            x, y = np.clip(np.round(positions[-1]).astype(int), 0, [width - 1, height - 1]).T
            positions.append(positions[-1] + flow[y, x] * ((end - begin) / NS_PER_S))
        return np.stack(positions)


@dataclass
class Errors:
    """Errors of one recording: of places across edges, px, and of w, deg/s, by rung."""

    by_rung: dict[str, list[float]] = field(default_factory=lambda: {r: [] for r in RUNGS})

    def figures(self) -> dict[str, dict[str, float]]:
        """Median and root mean square of each rung."""
        return {
            rung: {
                "median": float(np.median(values)) if values else np.nan,
                "rms": float(np.sqrt(np.mean(np.square(values)))) if values else np.nan,
            }
            for rung, values in self.by_rung.items()
        }


def measure(material: Material) -> Errors:
    """Run a recording once with the lattice, and with three memories that know different truths."""
    config = load_config("realtime")
    assert isinstance(config.estimator, LatticeConfig)
    fit = LatticeEstimator(material.calibration, config.estimator)
    alone = MotionWindows(fit, material.calibration, config.window)
    lattice = BoundedWindows(CleanWindows(alone, material.calibration), config.event_budget)
    reader = RememberingEstimator(
        lattice, material.calibration, lambda estimate, depths: (estimate, None)
    )
    memories = dict.fromkeys(("truth", "starts", "own"), reader.nothing())
    errors = Errors()
    for window in WindowSlicer(config.window).push(material.events):
        found = lattice.estimate(window)
        if found.status is not Status.OK or found.flow is None:
            continue
        seen = clean(window, material.calibration)
        for rung, told in _told(found, material).items():
            memories[rung], estimate = reader.step(memories[rung], seen, told)
            _note(errors, rung, estimate, material)
        _note(errors, "lattice", found, material)
        _places(errors, memories["starts"].odometry, reader, material, window)
    return errors


def _told(found: Estimate, material: Material) -> dict[str, Estimate]:
    """What the memories of the rungs are told instead of the lattice's estimate."""
    assert found.flow is not None
    flow: Any = TrueFlowField(material, found.flow.velocity(found.t))
    twist = material.truth.twists.twist(found.t) if material.truth.twists else None
    starts = replace(found, flow=flow)
    truth = starts
    if twist is not None:
        linear = np.zeros(3) if twist.linear is None else twist.linear
        unit = linear / max(float(np.linalg.norm(linear)), 1e-9)
        covariance = _UNKNOWN * np.eye(6)
        truth = replace(starts, angular=twist.angular, linear=unit, covariance=covariance)
    return {"truth": truth, "starts": starts, "own": found}


def _note(errors: Errors, rung: str, estimate: Estimate, material: Material) -> None:
    twist = material.truth.twists.twist(estimate.t) if material.truth.twists else None
    if twist is not None:
        apart = np.degrees(estimate.angular - twist.angular)
        errors.by_rung[rung].append(float(np.linalg.norm(apart)))


def _places(
    errors: Errors, state: State, reader: RememberingEstimator, material: Material, window: Window
) -> None:
    """Compare the newest places with where the true flow carries the patches from 80 ms ago."""
    flows = material.truth.flows
    if flows is None or state.adjusted is None:
        return
    before = int(np.abs(state.t - (state.t[-1] - _LAG_NS)).argmin())
    if before == len(state.t) - 1:
        return
    patches = state.patches.at(state.patches.shown & state.patches.found[:, before])
    true = flows.displacement(int(state.t[before]), int(state.t[-1]))
    if true is None or not len(patches):
        return
    camera, scale = reader.image.camera, reader.image.sensor_px
    rays = np.concatenate([patches.seen[:, before], np.ones((len(patches), 1))], axis=1)
    start = camera.project(rays) * scale
    pixel = np.clip(np.round(start).astype(int), 0, np.array(material.calibration.size) - 1)
    known = true.valid[pixel[:, 1], pixel[:, 0]]
    way = true.displacement[pixel[:, 1], pixel[:, 0]]
    error = (patches.place - (start + way) / scale)[known]
    if not len(error):
        return
    _, jacobian = camera.undistort(patches.place[known])
    root = patches.root[known, -1] @ jacobian
    across = np.linalg.svd(root)[2][:, 0]
    errors.by_rung["tracks"].append(float(np.median(np.abs((across * error).sum(axis=1)))))
    seconds = float(state.t[-1] - state.t[before]) * 1e-9
    middle = int(state.t[before] + state.t[-1]) // 2
    twist = material.truth.twists.twist(middle) if material.truth.twists else None
    if twist is not None and twist.linear is not None and np.linalg.norm(twist.linear) > 1e-3:
        plane = np.einsum("nij,nj->ni", jacobian, error)
        rate = _across_lines(patches.seen[known, -1], plane, patches.root[known, -1], twist.linear)
        errors.by_rung["lines"].append(float(np.degrees(np.linalg.norm(rate))) / seconds)


def _across_lines(seen: Array, error: Array, root: Array, v: Array) -> Array:
    """Rotation (3,) rad that errors (N, 2) across the epipolar lines of v look like, robustly."""
    a, b = motion_matrices(seen)
    line = a @ v
    line /= np.linalg.norm(line, axis=1, keepdims=True) + 1e-9
    normal = np.stack([-line[:, 1], line[:, 0]], axis=1)
    spread = np.linalg.inv(np.einsum("nji,njk->nik", root, root) + 1e-6 * np.eye(2))
    variance = np.einsum("ni,nij,nj->n", normal, spread, normal)
    value, rows = (normal * error).sum(axis=1), np.einsum("ni,nij->nj", normal, b)
    weight, found = np.ones(len(value)), np.zeros(3)
    for _ in range(6):
        weighted = rows * (weight / variance)[:, None]
        found = np.linalg.solve(weighted.T @ rows + 1e-6 * np.eye(3), weighted.T @ value)
        weight = 1 / (1 + (value - rows @ found) ** 2 / variance / 4) ** 2
    return found


def _table(figures: dict[str, dict[str, dict[str, float]]]) -> str:
    lines = [f"{'recording':<22}" + "".join(f"{rung:>16}" for rung in RUNGS)]
    lines.append(f"{'median / RMS':<22}{'px':>16}" + f"{'deg/s':>16}" * (len(RUNGS) - 1))
    for name, rungs in figures.items():
        cells = (f"{f['median']:.2f} / {f['rms']:.2f}" for f in rungs.values())
        lines.append(f"{name:<22}" + "".join(f"{cell:>16}" for cell in cells))
    means = []
    for rung in RUNGS:
        values = np.array([[f[rung]["median"], f[rung]["rms"]] for f in figures.values()])
        with np.errstate(invalid="ignore"):
            median, rms = np.exp(np.nanmean(np.log(np.maximum(values, 1e-6)), axis=0))
        means.append(f"{median:.2f} / {rms:.2f}")
    lines.append(f"{'geometric mean':<22}" + "".join(f"{cell:>16}" for cell in means))
    return "\n".join(lines)


def _subjects(options: argparse.Namespace) -> list[Subject]:
    simulated = random_subjects(options.seeds, options.cache)
    independent = [s for s in shared_subjects(options.data) if s.group == "independent"]
    return [s for s in (*simulated, *independent) if not s.missing]


def _run(options: argparse.Namespace) -> None:
    figures = {}
    for subject in tqdm(_subjects(options), "recordings", unit=""):
        figures[subject.name] = measure(subject.load()).figures()
    print(_table(figures))
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(options.out / "ladder.json", figures)


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scoreboard.ladder", description=__doc__
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA, help="other recordings")
    parser.add_argument("--seeds", type=int, nargs="+", default=_SEEDS, help="simulated recordings")
    parser.add_argument("--out", type=Path, default=Path("out/accuracy"))
    parser.add_argument("--cache", type=Path, default=Path("out/accuracy/cache"))
    options = parser.parse_args()
    return run(lambda: _run(options))


if __name__ == "__main__":
    sys.exit(main())
