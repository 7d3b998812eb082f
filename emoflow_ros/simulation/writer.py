"""Write a simulated recording as MVSEC's files: data bag, truth bag, flow and calibration."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from tqdm import tqdm

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.bags import TRUTH_PERIOD, data_topics, truth_topics, write_bag
from emoflow_ros.simulation.factors import Factors
from emoflow_ros.simulation.imu import ImuModel, SimulatedImu, simulate_imu
from emoflow_ros.simulation.messages import MessageEncoder, ros_distortion
from emoflow_ros.simulation.recording import SimulatedRecording

FORMATS = ("rosbag1", "rosbag2")
_IMU = ImuModel()


@dataclass(frozen=True)
class OutputPaths:
    """Where the parts of a recording go; `within` names them.

    Attributes:
        data, truth: the bags; a ROS 1 bag is a file, a rosbag2 bag (mcap) a folder.
        flow: the npz of displacements.
        calibration: the camera_info YAML.
        factors: what a random recording was drawn as, YAML; None for other scenes.
    """

    data: Path
    truth: Path
    flow: Path
    calibration: Path
    factors: Path | None = None

    @classmethod
    def within(
        cls, folder: Path, name: str, bag_format: str, *, factors: bool = False
    ) -> "OutputPaths":
        """Name the parts as MVSEC does; `bag_format` is one of FORMATS."""
        suffix = ".bag" if bag_format == "rosbag1" else ""
        return cls(
            folder / f"{name}_data{suffix}",
            folder / f"{name}_gt{suffix}",
            folder / f"{name}_gt_flow_dist.npz",
            folder / f"{name}_calib.yaml",
            folder / f"{name}_factors.yaml" if factors else None,
        )

    def __iter__(self) -> Iterator[Path]:
        parts = (self.data, self.truth, self.flow, self.calibration, self.factors)
        return (path for path in parts if path is not None)

    def check(self, *, overwrite: bool) -> None:
        """Make the folder and see that the parts may be written there.

        Raises:
            InputError: a part exists and may not be overwritten, or the folder cannot be used.
        """
        folder = self.data.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError(folder, f"cannot be made ({reason})", "give another --out") from None
        if not os.access(folder, os.W_OK):
            raise InputError(folder, "cannot be written to", "give another --out")
        for path in self:
            if path.exists() and not overwrite:
                raise InputError(path, "exists already", "give --force to overwrite it")
            if path.is_dir() and not (path / "metadata.yaml").is_file():
                raise InputError(path, "is a folder, but not a bag", "give another --name")

    def remove(self) -> None:
        """Remove the parts that an earlier run left."""
        for path in self:
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


def write_recording(
    recording: SimulatedRecording,
    paths: OutputPaths,
    bag_format: str,
    *,
    imu: ImuModel = _IMU,
    progress: bool = False,
) -> SimulatedImu:
    """Write all parts, over those of an earlier run.

    Args:
        recording: what was simulated.
        paths: where to.
        bag_format: one of FORMATS.
        imu: how good the IMU is.
        progress: whether to show bars.

    Returns:
        What the IMU measured.
    """
    paths.remove()
    readings = simulate_imu(
        recording.truth, recording.t_start, recording.t_end, imu, recording.seed
    )
    encoder = MessageEncoder(ros1=bag_format == "rosbag1")
    _write_calibration(paths.calibration, recording.camera)
    write_bag(paths.data, encoder, data_topics(recording, encoder, readings), progress=progress)
    write_bag(paths.truth, encoder, truth_topics(recording, encoder), progress=progress)
    _write_flow(paths.flow, recording, progress)
    return readings


def write_factors(path: Path, factors: Factors) -> None:
    """Write what a random recording was drawn as: names and values, YAML."""
    path.write_text(yaml.safe_dump(factors.as_dict(), sort_keys=False), encoding="utf-8")


def _write_flow(path: Path, recording: SimulatedRecording, progress: bool) -> None:
    """Write MVSEC's flow file: at each stamp the displacement to the stamp after it.

    The last of the N stamps lies one period before the end of the recording, or less. Beyond
    MVSEC's arrays, `moving` marks the pixels that see the independently moving object.
    """
    stamps = range(recording.t_start, recording.t_end, TRUTH_PERIOD)
    camera = recording.camera
    flow = np.empty((2, len(stamps), camera.height, camera.width), np.float32)
    moving = np.empty(flow.shape[1:], np.bool_)
    for k, t in enumerate(tqdm(stamps, path.name, unit="flow", disable=not progress)):
        moving[k] = recording.truth.moving_mask(t)
        flow[:, k] = np.moveaxis(recording.truth.displacement(t, t + TRUTH_PERIOD), -1, 0)
    np.savez(
        path,
        timestamps=np.array(stamps) / NS_PER_S,
        x_flow_dist=flow[0],
        y_flow_dist=flow[1],
        moving=moving,
    )


def _write_calibration(path: Path, camera: Camera) -> None:
    """Write a ROS camera_info YAML file, as camera_calibration does."""
    model, coefficients = ros_distortion(camera)
    k = camera.intrinsic_matrix
    tree = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "davis_left",
        "camera_matrix": _matrix(k),
        "distortion_model": model,
        "distortion_coefficients": _matrix(np.array([coefficients])),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.hstack([k, np.zeros((3, 1))])),
    }
    text = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")


def _matrix(values: NDArray[np.float64]) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": values.ravel().tolist()}
