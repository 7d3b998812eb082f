"""Observe recordings in several processes, and write down what came out."""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.scoreboard.figures import W_DEG_S, W_SHARE, Figures, figures_of
from benchmarks.scoreboard.observe import observe
from benchmarks.scoreboard.picture import event_picture
from benchmarks.scoreboard.subjects import Subject
from benchmarks.scoreboard.verdicts import Verdict, judge
from benchmarks.scoreboard.windows import Windows
from emoflow_ros.config import Config

WINDOWS_FOLDER = "windows"


@dataclass(frozen=True)
class Outcome:
    """One recording of a run.

    Attributes:
        name, group: of the recording.
        figures, verdict: see there.
        windows: the table that they are from.
        gyro_scale: what the truth's angular velocity may have been multiplied with.
        factors: of a random recording.
        picture: small event image as PNG.
    """

    name: str
    group: str
    figures: Figures
    verdict: Verdict
    windows: Windows
    gyro_scale: float = 1.0
    factors: dict[str, Any] = field(default_factory=dict)
    picture: bytes = b""

    def document(self) -> dict[str, Any]:
        """Everything but the table and the picture, for JSON."""
        return {
            "name": self.name,
            "group": self.group,
            "accurate": self.verdict.accurate,
            "consistent": self.verdict.consistent,
            "criteria": dict(self.verdict.criteria),
            "figures": asdict(self.figures),
            "factors": self.factors,
            "windows": f"{WINDOWS_FOLDER}/{file_name(self.name)}.npz",
        }


def measure(subject: Subject, config: Config) -> Outcome:
    """Load one recording, run the estimator over it and judge the outcome."""
    material = subject.load()
    windows = observe(material, config)
    figures = figures_of(windows, material.gyro_scale)
    return Outcome(
        subject.name,
        subject.group,
        figures,
        judge(figures),
        windows,
        material.gyro_scale,
        material.factors,
        event_picture(material.events, material.camera),
    )


def measure_all(subjects: Sequence[Subject], config: Config, jobs: int) -> list[Outcome]:
    """Measure recordings in `jobs` processes of one thread each, shown by a bar; in their order."""
    os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"  # for the processes
    outcomes: dict[str, Outcome] = {}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        running = {pool.submit(measure, subject, config): subject for subject in subjects}
        try:
            for done in tqdm(as_completed(running), "recordings", len(running), unit=""):
                outcomes[running[done].name] = done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [outcomes[subject.name] for subject in subjects]


def save_windows(folder: Path, outcomes: Sequence[Outcome]) -> None:
    """Write each recording's table as `windows/NAME.npz`, array `windows`."""
    (folder / WINDOWS_FOLDER).mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        path = folder / WINDOWS_FOLDER / f"{file_name(outcome.name)}.npz"
        np.savez_compressed(path, windows=outcome.windows)


def severity(outcome: Outcome) -> tuple[float, float]:
    """Sort key, the worst recordings last: criteria missed, then w's error over its bound."""
    figures = outcome.figures
    bound = max(W_DEG_S, W_SHARE * figures.w_true_rms) if figures.estimates else W_DEG_S
    error = figures.w_rms / bound
    return len(outcome.verdict.missed), error if math.isfinite(error) else 0.0


def file_name(name: str) -> str:
    """Name of a recording as part of a file's name."""
    return name.replace("/", "-")
