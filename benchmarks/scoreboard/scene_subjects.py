"""Short recordings of the simulator's hand-made scenes."""

from dataclasses import dataclass
from pathlib import Path

from benchmarks._scoring import SimulatedTruth
from benchmarks.scoreboard.gyros import gyro_of_simulation
from benchmarks.scoreboard.subjects import Material
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.truth import Truth

_FPS = 500


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
