"""Stamps of the camera's frames, which the MVSEC protocols are counted in."""

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.readers import Recording
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.bag_files import deserialize, open_bag, read_messages
from emoflow_ros.readers.mvsec import MvsecRecording

_IMAGE = "sensor_msgs/msg/Image"
_IMAGE_NAMES = ("image_raw", "image_mono")


def frame_stamps(recording: Recording) -> NDArray[np.int64] | None:
    """Times (N,) in ns of the frames beside the events; None where the recording has none."""
    if isinstance(recording, BagRecording):
        return _bag_stamps(recording.path, recording.topic.rpartition("/")[0])
    if isinstance(recording, MvsecRecording):
        with h5py.File(recording.path) as file:
            name = recording.topic.rpartition("/")[0] + "/image_raw_ts"
            if name in file:
                return np.rint(file[name][:] * NS_PER_S).astype(np.int64)
    return None


def _bag_stamps(path: Path, namespace: str) -> NDArray[np.int64] | None:
    with open_bag(path) as bag:
        names = [f"{namespace}/{name}" for name in _IMAGE_NAMES]
        images = [c for c in bag.connections if c.msgtype == _IMAGE and c.topic in names]
        if not images:
            return None
        headers = (
            deserialize(bag, connection, data).header.stamp
            for connection, _, data in read_messages(path, bag, images[:1])
        )
        return np.array([s.sec * NS_PER_S + s.nanosec for s in headers], np.int64)
