"""The bags of a simulated recording: topics, their rates, and how they are stored."""

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags import rosbag1, rosbag2
from tqdm import tqdm

from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S
from emoflow_ros.simulation import messages as msg
from emoflow_ros.simulation.imu import SimulatedImu
from emoflow_ros.simulation.messages import ImuSample, MessageEncoder
from emoflow_ros.simulation.recording import SimulatedRecording

TRUTH_PERIOD = NS_PER_S // 20  # depth and flow, as in MVSEC
_POSE_PERIOD = NS_PER_S // 100
_INFO_PERIOD = NS_PER_S // 20
_EVENT_BATCH = 10 * NS_PER_MS


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
        Topic("/davis/left/events", msg.EVENT_ARRAY, batch_ends, encode_events),
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
            range(start, end + 1, TRUTH_PERIOD),
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
