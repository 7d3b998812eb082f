"""The image that an estimator works on: that of a DAVIS346, whatever the sensor.

Texture, blur and errors of the flow are measured in pixels. On a sensor of twice as many pixels
the same scene takes twice the pixels, and every option in pixels would have to follow. So the
events are moved to an image of about 346 x 260 pixels, without rounding, and the flow back. The
time that a window takes then does not depend on the sensor, either.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.lattice import Lattice

_LONGER_SIDE_PX = 346  # that options in pixels are meant for; smaller sensors keep their pixels


@dataclass(frozen=True)
class WorkingImage:
    """The image an estimator works on.

    Attributes:
        sensor: the camera as it is.
        camera: the same with the pixels of the working image.
    """

    sensor: Camera
    camera: Camera

    @classmethod
    def of(cls, sensor: Camera) -> "WorkingImage":
        """Choose the working image of a sensor."""
        ratio = reduction(sensor)
        if ratio == 1.0:
            return cls(sensor, sensor)
        width, height = (max(2, round((n - 1) / ratio) + 1) for n in sensor.size)
        return cls(sensor, sensor.resized(width, height))

    @property
    def sensor_px(self) -> NDArray[np.float32]:
        """Pixels of the sensor per pixel of the working image in x and y, (2,)."""
        sensor, camera = np.array(self.sensor.size), np.array(self.camera.size)
        return ((sensor - 1) / (camera - 1)).astype(np.float32)

    def on_sensor(
        self, lattice: Lattice, flow: NDArray[np.float32]
    ) -> tuple[Lattice, NDArray[np.float32]]:
        """Bring a lattice and its field (columns, rows, times, 2) to the sensor's pixels."""
        if self.camera is self.sensor:
            return lattice, flow
        nodes = Lattice(*self.sensor.size, lattice.columns, lattice.rows, lattice.times)
        return nodes, flow * self.sensor_px


def reduction(sensor: Camera) -> float:
    """Sensor pixels per pixel of the working image, 1 for sensors that are no larger."""
    return max(1.0, (max(sensor.size) - 1) / (_LONGER_SIDE_PX - 1))
