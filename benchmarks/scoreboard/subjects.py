"""The recordings of the scoreboard: where they are and how they are opened."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from benchmarks.scoreboard.gyros import gyro_of_poses, own_gyro, without_bias
from benchmarks.scoreboard.truths import NominalFlow
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.readers import open_recording, require_camera
from emoflow_ros.truth import Truth, load_truth

INDEPENDENT = ("calm", "forward", "agile", "rotation", "street", "mover")
ROOT = Path(__file__).resolve().parents[2]
SHARED_DATA = ROOT.parent / "shared" / "data"


@dataclass(frozen=True)
class Material:
    """A recording in memory.

    Attributes:
        events: all of them, sorted by time.
        camera: the true camera.
        calibration: the camera as the estimator is told it is.
        truth: velocity and, with `exact_flow`, flow.
        exact_flow: whether `truth.flows` may be compared with; else it only tells how far the
            image moves.
        gyro_scale: largest factor by which the true angular velocity may be too small.
        factors: what a random recording was drawn from.
        gyro: readings of a gyro; None where there is none.
    """

    events: Events
    camera: Camera
    calibration: Camera
    truth: Truth
    exact_flow: bool = True
    gyro_scale: float = 1.0
    factors: dict[str, Any] = field(default_factory=dict)
    gyro: GyroReadings | None = None


class Subject(Protocol):
    """A recording by name, which other processes can load."""

    @property
    def name(self) -> str:
        """Unique, for example `independent/calm`."""
        ...

    @property
    def group(self) -> str:
        """`random`, `independent` or `real`."""
        ...

    @property
    def missing(self) -> Path | None:
        """The first of its files that is not there."""
        ...

    def load(self) -> Material:
        """Read or simulate it."""
        ...


@dataclass(frozen=True)
class Independent:
    """A recording of another simulator: data bag, poses and exact flow.

    Attributes:
        folder: of the files.
        key: what they begin with.
    """

    folder: Path
    key: str
    group: str = "independent"

    @property
    def name(self) -> str:
        """The group and the key."""
        return f"{self.group}/{self.key}"

    @property
    def _paths(self) -> list[Path]:
        ends = ("data.bag", "gt.bag", "gt_flow_dist.npz")
        return [self.folder / f"{self.key}_{end}" for end in ends]

    @property
    def missing(self) -> Path | None:
        """The first file that is not there."""
        return next((path for path in self._paths if not path.exists()), None)

    def load(self) -> Material:
        """Read events, poses and flow; the gyro is made from the poses."""
        data, *truth = self._paths
        material = _read(data, truth)
        poses = material.truth.poses
        return replace(material, gyro=gyro_of_poses(poses, self.name) if poses else None)


@dataclass(frozen=True)
class Real:
    """A real recording as an ECD folder with poses or a gyro, without flow.

    Attributes:
        folder: of the recording.
        depth: rough depth of the scene, m: tells which windows move and how much parallax they
            have.
        gyro_scale: largest factor by which the truth's angular velocity may be too small.
        rest_s: how long the camera is at rest at the start. The mean of the gyro's readings until
            then is its bias, which the truth does without.
    """

    folder: Path
    depth: float = math.inf
    gyro_scale: float = 1.0
    rest_s: float = 0.0
    group: str = "real"

    @property
    def name(self) -> str:
        """The group and the folder's name."""
        return f"{self.group}/{self.folder.name}"

    @property
    def missing(self) -> Path | None:
        """The folder, if it is not there."""
        return None if self.folder.is_dir() else self.folder

    def load(self) -> Material:
        """Read events, the truth beside them and the gyro, if there is one."""
        material = _read(self.folder, ())
        twists = material.truth.twists
        assert twists is not None
        if self.rest_s and material.gyro is not None:
            twists = without_bias(material.gyro, self.rest_s)
        flows = NominalFlow(twists, material.camera, self.depth)
        truth = Truth(twists, flows, poses=material.truth.poses)
        return Material(
            material.events,
            material.camera,
            material.camera,
            truth,
            exact_flow=False,
            gyro_scale=self.gyro_scale,
            gyro=material.gyro,
        )


def shared_subjects(data: Path) -> list[Subject]:
    """List the independent and the real recordings, whether they are there or not."""
    independent = [Independent(data / "independent", key) for key in INDEPENDENT]
    # Depths of 0.3 to 0.8 m; every contrast objective sees 1.13 to 1.2 times the gyro's rate. In
    # the first 0.6 s the events are sharper as they came than turned back by the gyro's readings.
    slider = Real(data / "ecd" / "slider_depth", depth=0.5)
    pan = Real(data / "ecd" / "shapes_rotation_start", gyro_scale=1.25, rest_s=0.6)
    return [*independent, slider, pan]


def _read(path: Path, truth: Sequence[Path]) -> Material:
    with open_recording(path) as recording:
        camera = require_camera(recording)
        events = Events.concatenate(list(recording.event_chunks()))
        gyro = own_gyro(recording.imu())
        return Material(events, camera, camera, load_truth(recording, truth), gyro=gyro)
