"""Compare the profiles side by side on the same simulated windows.

All take windows as long as the published ones, 90 ms, and whole. realtime and rigid estimate all
18 of a recording, one after the other; the published loop starts every window cold and takes
minutes for each, so that it is run on the chosen windows only.
Tables come out: all windows of each profile, every profile on the windows of the slow ones, and on
these a verdict per scene, realtime / slow profile.
Everything runs on one thread. EPE, outliers and angular error are over the pixels with events,
averaged per window and then over windows; the error of w is over windows and axes, that of v the
median angle, sign included; seconds are medians, flow image included. Seconds of the processor
stand beside those of the clock for machines that do something else, too.

What is measured is kept in the folder, one file per profile and recording (and window): the same
command goes on where it was cut. Delete the files of a profile whose code has changed.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks._profile_tables import Cell, Row, paired_table, table, verdicts
from benchmarks._scoring import SCENES, SimulatedTruth, normalised_errors
from benchmarks.realtime import record, timed, use_one_thread
from emoflow_ros.cli import run
from emoflow_ros.config import Config, load_config
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import Window, WindowPolicy
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import machine, versions
from emoflow_ros.evaluation.window_results import assess
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import SimulatedRecording
from emoflow_ros.truth import Truth

PROFILES = ("realtime", "rigid", "paper_early_stop", "paper")
WINDOWS = 18  # of a recording

# The same windows for all: as long as the published ones, and whole.
PUBLISHED_WINDOWS = {
    "window.duration_ms": 90.0,
    "window.stride_ms": 0.0,
    "window.max_displacement_px": 0.0,
}


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="example: python benchmarks/profiles.py --profiles paper_early_stop --seeds 0 "
        "--windows 9 --minutes 600",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    for name, values in (("profiles", PROFILES), ("scenes", SCENES)):
        metavar = name[:-1].upper()
        add(f"--{name}", nargs="+", default=values, choices=values, metavar=metavar,
            help=f"from {', '.join(values)} (default: all)")  # fmt: skip
    add("--seeds", nargs="+", type=int, default=(0, 1, 2), metavar="SEED", help="default: 0 1 2")
    add("--windows", nargs="+", type=int, default=(9,), metavar="INDEX",
        help=f"windows of the published loop, 0 to {WINDOWS - 1} (default: 9)")  # fmt: skip
    add("--minutes", type=float, default=60.0,
        help="begin nothing after so long; 0 lays out what is there (default: 60)")  # fmt: skip
    add("--out", type=Path, default=Path("out/benchmarks/profiles"), metavar="DIR",
        help="default: out/benchmarks/profiles")  # fmt: skip
    return parser


@dataclass(frozen=True)
class Job:
    """One profile on one recording.

    Attributes:
        profile: one of PROFILES.
        scene, seed: of the recording.
        window: the one to estimate; None for all of them in a row.
    """

    profile: str
    scene: str
    seed: int
    window: int | None

    @property
    def file_name(self) -> str:
        """Name of the file that keeps the result."""
        part = "" if self.window is None else f"-window{self.window}"
        return f"{self.profile}-{self.scene}-seed{self.seed}{part}.json"


def _measure(args: argparse.Namespace) -> None:
    if not all(0 <= window < WINDOWS for window in args.windows):
        raise InputError("--windows", f"not all within 0 to {WINDOWS - 1}", "give such indices")
    began = time.monotonic()
    use_one_thread()
    configs = {profile: load_config(profile, PUBLISHED_WINDOWS) for profile in args.profiles}
    left = [job for job in _jobs(args, configs) if not _is_done(args.out / job.file_name, configs)]
    for job in tqdm(left, desc="profiles", file=sys.stderr):
        if time.monotonic() - began >= 60 * args.minutes:
            break
        _save(args.out / job.file_name, measure(job, configs[job.profile]))
    cells = list(_load(args.out, configs))
    report = "\n".join([table(cells), paired_table(cells), verdicts(cells)])
    print(report)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "table.md").write_text(report)
    print(f"written to {args.out}")


def _jobs(args: argparse.Namespace, configs: dict[str, Config]) -> Iterator[Job]:
    for profile in args.profiles:
        windows = args.windows if configs[profile].method == "implicit" else (None,)
        for seed in args.seeds:
            for scene in args.scenes:
                yield from (Job(profile, scene, seed, window) for window in windows)


def measure(job: Job, config: Config) -> Cell:
    """Estimate the windows of a job and compare them with the truth."""
    load = os.getloadavg()[0]
    recording, windows = _recording(job.scene, job.seed, config.window)
    estimator = make_estimator(recording.camera, config)
    if job.window is None:
        for window in windows[:2]:  # compiles, where that was not done before
            estimator.estimate(window)
        estimator.reset()
        chosen = list(enumerate(windows))
    else:
        chosen = [(job.window, windows[job.window])]
    simulated = SimulatedTruth(recording.truth)
    truth = Truth(simulated, simulated)
    rows = []
    for index, window in chosen:
        began = time.process_time()
        estimate, seconds, _ = timed(estimator, window)
        cpu_seconds = time.process_time() - began
        rows.append(_row(index, window, estimate, truth, (seconds, cpu_seconds)))
    where = {"machine": machine(), "versions": versions(), "load_average_at_start": load}
    return Cell(job.profile, job.scene, job.seed, tuple(rows), config.flat(), where)


@cache
def _recording(
    scene: str, seed: int, policy: WindowPolicy
) -> tuple[SimulatedRecording, list[Window]]:
    return record(scene, seed, policy, WINDOWS)


def _row(
    index: int, window: Window, estimate: Estimate, truth: Truth, seconds: tuple[float, float]
) -> Row:
    result = assess(index, window, estimate, truth)
    flow, static = result.flow, result.static_flow
    nees_w, nees_v = normalised_errors(estimate, result)
    w_rms = float(np.degrees(np.sqrt(np.mean(result.angular_error**2))))
    return Row(
        index=index,
        status=result.status,
        model=result.model,
        epe_px=flow.epe_px if flow else None,
        static_epe_px=static.epe_px if static else None,
        out_percent=flow.pe3 if flow else None,
        ae_deg=flow.ae_deg if flow else None,
        true_px=flow.truth_px if flow else None,
        w_rms_deg_s=_known(w_rms),
        v_error_deg=_known(result.direction_error_deg),
        seconds=seconds[0],
        cpu_seconds=seconds[1],
        nees_w=_known(nees_w),
        nees_v=_known(nees_v),
        events=result.quality.events,
        iterations=result.quality.iterations,
        stop_reason=result.quality.stop_reason,
        contrast_gain=_known(result.quality.contrast_gain),
    )


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _save(path: Path, cell: Cell) -> None:
    """Write a cell whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(asdict(cell), indent=2) + "\n")
    part.replace(path)


def _read(path: Path) -> Cell:
    values: dict[str, Any] = json.loads(path.read_text())
    return Cell(**{**values, "rows": tuple(Row(**row) for row in values["rows"])})


def _is_done(path: Path, configs: dict[str, Config]) -> bool:
    """Whether a job has been measured, with the values that the profile has now."""
    if not path.is_file():
        return False
    cell = _read(path)
    now = configs[cell.profile].flat()
    return all(now.get(name, value) == value for name, value in cell.configuration.items())


def _load(folder: Path, configs: dict[str, Config]) -> Iterator[Cell]:
    """Read what was measured of these profiles, in this run or an earlier one."""
    for profile in configs:
        paths: Sequence[Path] = sorted(folder.glob(f"{profile}-*.json"))
        yield from (_read(path) for path in paths if _is_done(path, configs))


if __name__ == "__main__":
    sys.exit(main())
