"""A pipeline in tests, with a fake worker and a fake node."""

from contextlib import ExitStack

import numpy as np
import pytest
from fake_estimators import Recorder
from fake_node import FakeNode
from fake_supervisor import install_fake_supervisor
from graph import DVS
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events
from emoflow_ros.node.pipeline import Pipeline
from emoflow_ros.node.settings import NodeOptions, Settings
from emoflow_ros.node.tasks import Job, Result
from emoflow_ros.node.topic_search import EventTopic
from emoflow_ros.simulation.messages import MessageEncoder

MS = 1_000_000
CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
LEFT = EventTopic("/left/events", DVS)
ENCODER = MessageEncoder(ros1=False)


class PipelineBench:
    """A pipeline that listens to /left/events, with windows of 10 ms of which two may wait."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, twist_rate: float = 0.0) -> None:
        supervisors = install_fake_supervisor(monkeypatch)
        self.node = FakeNode()
        self.made = ExitStack()
        self.settings = Settings(NodeOptions(), load_config()).changed(
            {
                "window.duration_ms": 10.0,
                "window.stride_ms": 10.0,
                "input.queue_windows": 2,
                "output.twist_rate": twist_rate,
            }
        )
        self.pipeline = Pipeline(
            self.node,  # type: ignore[arg-type]
            self.settings,
            factory="",
            wake=lambda: None,
            made=self.made,
        )
        [self.supervisor] = supervisors
        self.pipeline.take_topic(LEFT)

    def play(
        self, first_ms: int, last_ms: int, camera: Camera = CAMERA, *, pause: bool = True
    ) -> None:
        """Take a message with an event each 5 ms; without `pause` all in one turn, unfinished."""
        for t in range(first_ms, last_ms, 5):
            zero = np.zeros(1, np.uint16)
            events = Events(zero, zero, np.array([t * MS]), zero.astype(bool))
            self.pipeline.take_events(ENCODER.events(t * MS, camera, events))
            if pause:
                self.pipeline.cut_windows()

    def calibrate(self, camera: Camera = CAMERA) -> None:
        data = ENCODER.camera_info(0, camera)
        self.pipeline.take_camera_info(deserialize_message(data, CameraInfo))

    def answer(self, job: Job) -> Result:
        estimate = Recorder(job.camera, job.config).estimate(job.task.window)
        return Result(job.task, estimate)

    @property
    def said(self) -> list[str]:
        return [m.message for m in self.node.messages("egomotion/status")]
