"""An event input, and the messages that tests give it."""

from typing import Any

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import Events, WindowPolicy
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_input import EventInput
from emoflow_ros.node.tasks import Task
from emoflow_ros.simulation.messages import EVENT_ARRAY, MessageEncoder

CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
SMALL = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)
MS = 1_000_000


class Bench:
    """An input with what it counted and said."""

    def __init__(self, **kwargs: Any) -> None:
        self.statistics = Statistics()
        self.warnings: list[str] = []
        self.input = EventInput(
            EVENT_ARRAY,
            EventBudget(WindowPolicy(duration_ms=10.0), 30_000),
            **{
                "timestamps": Timestamps.FUSED,
                "frame_id": "",
                "statistics": self.statistics,
                "warn": self.warnings.append,
            }
            | kwargs,
        )
        self.input.camera = CAMERA
        self._encoder = MessageEncoder(ros1=False)

    def push(
        self,
        *times_ms: float,
        stamp_ms: float | None = None,
        camera: Camera = CAMERA,
        part: int = 1,
    ) -> list[Task]:
        self.take(*times_ms, stamp_ms=stamp_ms, camera=camera, part=part)
        return self.cut()

    def cut(self) -> list[Task]:
        return [task for tasks in self.input.cut() for task in tasks]

    def take(
        self,
        *times_ms: float,
        stamp_ms: float | None = None,
        camera: Camera = CAMERA,
        part: int = 1,
    ) -> None:
        t = np.array([round(ms * MS) for ms in times_ms], np.int64)
        zeros = np.zeros(len(t), np.uint16)
        events = Events(zeros, zeros, t, zeros.astype(bool))
        stamp = round((times_ms[0] if stamp_ms is None else stamp_ms) * MS)
        self.input.take(self._encoder.events(stamp, camera, events), part)
