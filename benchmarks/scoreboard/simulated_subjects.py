"""Recordings of the simulator: short ones of its hand-made scenes, and random ones by seed.

The random ones are simulated once and kept on disk.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._scoring import SimulatedTruth
from benchmarks.scoreboard.gyros import gyro_of_simulation
from benchmarks.scoreboard.subjects import Material, Subject
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.simulation.random_recording import (
    Factors,
    draw_factors,
    random_truth,
    simulate_random,
)
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.truth import Truth

DURATION_S = 3.0
# Part of the names of cached files. Count on whenever the same factors give other events.
SIMULATOR_VERSION = 1
_FPS = 500  # of hand-made scenes


@dataclass(frozen=True)
class SceneSubject:
    """A scene by name, simulated when it is needed.

    Attributes:
        scene: a key of `emoflow_ros.simulation.recording.SCENES`.
        seed: of everything in it.
        duration_s: length.
    """

    scene: str
    seed: int
    duration_s: float
    group: str = "scene"

    @property
    def name(self) -> str:
        """Group, scene and seed."""
        return f"{self.group}/{self.scene}-{self.seed}"

    @property
    def missing(self) -> Path | None:
        """Nothing: it is simulated."""
        return None

    def load(self) -> Material:
        """Simulate it, with 500 images per second."""
        made = simulate(self.scene, duration_s=self.duration_s, seed=self.seed, fps=_FPS)
        truth = SimulatedTruth(made.truth)
        gyro = gyro_of_simulation(made.truth, made.t_start, made.t_end, self.name)
        return Material(made.events, made.camera, made.camera, Truth(truth, truth), gyro=gyro)


@dataclass(frozen=True)
class RandomSubject:
    """The random recording of a seed.

    Attributes:
        seed: of its factors.
        cache: folder of recordings that were simulated before; None simulates each time.
        duration_s: length.
    """

    seed: int
    cache: Path | None
    duration_s: float = DURATION_S
    group: str = "random"

    @property
    def name(self) -> str:
        """The group and the seed."""
        return f"{self.group}/{self.seed:04d}"

    @property
    def missing(self) -> Path | None:
        """Nothing: it is simulated."""
        return None

    def load(self) -> Material:
        """Read the events from the cache, or simulate them and put them there."""
        factors = draw_factors(self.seed)
        if self.cache is None:
            made = simulate_random(factors, duration_s=self.duration_s)
            events, camera, calibration = made.events, made.camera, made.calibration
        else:
            path = self.cache / f"{self.seed:04d}-{self._digest(factors)}.npz"
            if not path.exists():
                self._simulate(factors, path)
            events, camera, calibration = _read(path)
        exact = random_truth(factors, duration_s=self.duration_s)
        truth = SimulatedTruth(exact)
        gyro = gyro_of_simulation(exact, 0, round(self.duration_s * NS_PER_S), self.name)
        told = {name: value for name, value in factors.as_dict().items() if name != "seed"}
        return Material(events, camera, calibration, Truth(truth, truth), factors=told, gyro=gyro)

    def _digest(self, factors: Factors) -> str:
        made_from = [SIMULATOR_VERSION, self.duration_s, factors.as_dict()]
        text = json.dumps(made_from, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def _simulate(self, factors: Factors, path: Path) -> None:
        """Write the recording in one step, so that the cache never holds a part of one."""
        recording = simulate_random(factors, duration_s=self.duration_s)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.partial")
        cameras = [asdict(recording.camera), asdict(recording.calibration)]
        events = recording.events
        with partial.open("wb") as file:
            np.savez_compressed(
                file, x=events.x, y=events.y, t=events.t, p=events.p, cameras=json.dumps(cameras)
            )
        partial.replace(path)


def random_subjects(seeds: Iterable[int], cache: Path) -> list[Subject]:
    """List the random recordings of some seeds."""
    return [RandomSubject(seed, cache) for seed in seeds]


def _read(path: Path) -> tuple[Events, Camera, Camera]:
    with np.load(path) as archive:
        events = Events(archive["x"], archive["y"], archive["t"], archive["p"])
        true, told = json.loads(str(archive["cameras"]))
    return events, _camera(true), _camera(told)


def _camera(fields: dict[str, Any]) -> Camera:
    return Camera(**{**fields, "distortion": tuple(fields["distortion"])})
