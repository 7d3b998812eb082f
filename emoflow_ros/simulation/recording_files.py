"""Write a simulated recording as MVSEC's files: data bag, truth bag, flow and calibration."""

import heapq
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags import rosbag1, rosbag2
from tqdm import tqdm

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.simulation import messages as msg
from emoflow_ros.simulation.factors import Factors
from emoflow_ros.simulation.messages import ImuSample, MessageEncoder, ros_distortion
from emoflow_ros.simulation.recording import SimulatedRecording
from emoflow_ros.simulation.simulated_truth import ImuModel, SimulatedImu, simulate_imu

FORMATS = ("rosbag1", "rosbag2")
_TRUTH_PERIOD = NS_PER_S // 20  # depth and flow, as in MVSEC
_POSE_PERIOD = NS_PER_S // 100
_INFO_PERIOD = NS_PER_S // 20
_EVENT_BATCH = 10 * NS_PER_MS
_IMU = ImuModel()


@dataclass(frozen=True)
class OutputPaths:
    """Where the parts of a recording go; `within` names them.

    Attributes:
        data, truth: the bags; a ROS 1 bag is a file, a rosbag2 bag (mcap) a folder.
        flow: the npz of displacements.
        calibration: the camera_info YAML.
        factors: the drawn factors of a random recording, YAML; None for other scenes.
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
        """Make the folder and check that the parts may be written there.

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
        """Remove the parts that an earlier run wrote."""
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
    event_type: str = msg.EVENT_ARRAY,
    imu: ImuModel = _IMU,
    progress: bool = False,
) -> SimulatedImu:
    """Write all parts, over those of an earlier run.

    Args:
        recording: what was simulated.
        paths: where to.
        bag_format: one of FORMATS.
        event_type: of the messages of events, see MessageEncoder.
        imu: how good the IMU is.
        progress: whether to show bars.

    Returns:
        What the IMU measured.
    """
    paths.remove()
    readings = simulate_imu(
        recording.truth, recording.t_start, recording.t_end, imu, recording.seed
    )
    encoder = MessageEncoder(ros1=bag_format == "rosbag1", event_type=event_type)
    _write_calibration(paths.calibration, recording.camera)
    write_bag(paths.data, encoder, data_topics(recording, encoder, readings), progress=progress)
    write_bag(paths.truth, encoder, truth_topics(recording, encoder), progress=progress)
    _write_flow(paths.flow, recording, progress)
    return readings


def write_factors(path: Path, factors: Factors) -> None:
    """Write the drawn factors of a random recording: names and values, YAML."""
    path.write_text(yaml.safe_dump(factors.as_dict(), sort_keys=False), encoding="utf-8")


def _write_flow(path: Path, recording: SimulatedRecording, progress: bool) -> None:
    """Write MVSEC's flow file: at each stamp the displacement to the stamp after it.

    The last of the N stamps lies one period before the end of the recording, or less. Beyond
    MVSEC's arrays, `moving` marks the pixels that see the independently moving object.
    """
    stamps = range(recording.t_start, recording.t_end, _TRUTH_PERIOD)
    camera = recording.camera
    flow = np.empty((2, len(stamps), camera.height, camera.width), np.float32)
    moving = np.empty(flow.shape[1:], np.bool_)
    for k, t in enumerate(tqdm(stamps, path.name, unit="flow", disable=not progress)):
        moving[k] = recording.truth.moving_mask(t)
        flow[:, k] = np.moveaxis(recording.truth.displacement(t, t + _TRUTH_PERIOD), -1, 0)
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


@dataclass(frozen=True)
class Topic:
    """A topic with a message at each of `times` (ns), made by `encode(time)`."""

    name: str
    msgtype: str
    times: Sequence[int]
    encode: Callable[[int], bytes]


def data_topics(
    recording: SimulatedRecording, encoder: MessageEncoder, imu: SimulatedImu
) -> list[Topic]:
    """List what the sensor sends: events in batches of 10 ms, calibration and IMU."""
    camera, events = recording.camera, recording.events

    def encode_events(end: int) -> bytes:
        first, last = np.searchsorted(events.t, [end - _EVENT_BATCH, end])
        return encoder.events(end - _EVENT_BATCH, camera, events[first:last])

    def encode_imu(t: int) -> bytes:
        k = int(np.searchsorted(imu.stamps, t))
        return encoder.imu(t, ImuSample(imu.angular[k], imu.force[k]))

    start, end = recording.t_start, recording.t_end
    batch_ends = range(start + _EVENT_BATCH, end + _EVENT_BATCH, _EVENT_BATCH)
    return [
        Topic("/davis/left/events", encoder.event_type, batch_ends, encode_events),
        Topic(
            "/davis/left/camera_info",
            msg.CAMERA_INFO,
            range(start, end, _INFO_PERIOD),
            lambda t: encoder.camera_info(t, camera),
        ),
        Topic("/davis/left/imu", msg.IMU, imu.stamps.tolist(), encode_imu),
    ]


def truth_topics(recording: SimulatedRecording, encoder: MessageEncoder) -> list[Topic]:
    """List the ground truth: depth on the rectified grid, and the camera's pose."""
    truth, rectified = recording.truth, recording.truth.rectified()
    start, end = recording.t_start, recording.t_end
    return [
        Topic(
            "/davis/left/depth_image_rect",
            msg.IMAGE,
            range(start, end + 1, _TRUTH_PERIOD),
            lambda t: encoder.depth_image(t, rectified.depth(t)),
        ),
        Topic(
            "/davis/left/pose",
            msg.POSE,
            range(start, end + 1, _POSE_PERIOD),
            lambda t: encoder.pose(t, truth.pose(t)),
        ),
    ]


def write_bag(
    path: Path, encoder: MessageEncoder, topics: Sequence[Topic], *, progress: bool
) -> None:
    """Write all messages in order of time, into a ROS 1 bag or a rosbag2 folder (mcap).

    Args:
        path: does not exist yet.
        encoder: its serialisation decides which kind of bag it is.
        topics: what to write.
        progress: whether to show a bar.
    """
    writer: rosbag1.Writer | rosbag2.Writer
    if encoder.ros1:
        writer = rosbag1.Writer(path)
    else:
        writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    queue = heapq.merge(*([(t, k) for t in topic.times] for k, topic in enumerate(topics)))
    total = sum(len(topic.times) for topic in topics)
    with writer:
        connections = [
            writer.add_connection(topic.name, topic.msgtype, typestore=encoder.typestore)
            for topic in topics
        ]
        for t, k in tqdm(queue, path.name, total, unit="message", disable=not progress):
            writer.write(connections[k], t, topics[k].encode(t))
