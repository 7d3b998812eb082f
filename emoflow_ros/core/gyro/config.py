"""Options of the gyro."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.types.options import option
from emoflow_ros.errors import InputError

ROTATION_FROM_TF = "tf"
# DAVIS drivers publish the IMU in the camera's axes, and so do MVSEC's bags.
ROTATIONS = {"davis": (0.0, 0.0, 0.0), "mvsec": (0.0, 0.0, 0.0)}


@dataclass(frozen=True)
class GyroConfig:
    """Whether a gyro is used, how it is mounted, and its errors; docs/operations.md explains them.

    Raises:
        InputError: `rotation` is neither three angles nor a known name.
    """

    use: str = option(
        "off",
        "off: use no gyro; auto: use one if there is one; require: the same, and report an error "
        "while there is none",
        choices=("off", "auto", "require"),
    )
    rotation: str = option(
        "0,0,0",
        "orientation of the IMU in the camera's optical frame: roll,pitch,yaw in degrees (about "
        f"x, then y, then z, as in URDF), {' or '.join(ROTATIONS)}, or tf",
    )
    time_offset_ms: float = option(
        0.0,
        "added to the IMU's stamps to get the events' time",
        unit="ms",
        minimum=-10_000.0,
        maximum=10_000.0,
    )
    noise: float = option(
        0.01,
        "noise density of the gyro",
        unit="deg/s per square root of Hz",
        minimum=1e-5,
        maximum=10.0,
    )
    bias_deg_s: float = option(
        1.0,
        "standard deviation of the gyro's bias before anything is known of it",
        unit="deg/s",
        minimum=0.0,
        maximum=100.0,
    )
    bias_walk: float = option(
        0.02,
        "random walk of the bias",
        unit="deg/s per square root of a second",
        minimum=0.0,
        maximum=10.0,
    )
    scale_error: float = option(
        0.01, "relative standard deviation of the gyro's scale", minimum=0.0, maximum=0.5
    )
    rotation_error_deg: float = option(
        0.3,
        "standard deviation of the rotation between IMU and camera",
        unit="deg",
        minimum=0.0,
        maximum=30.0,
    )
    range_deg_s: float = option(
        2000.0,
        "angular velocity that the gyro cannot exceed; 0 if it is not known",
        unit="deg/s",
        minimum=0.0,
        maximum=1e5,
    )

    def __post_init__(self) -> None:
        if self.rotation != ROTATION_FROM_TF:
            self.matrix()

    def matrix(self) -> NDArray[np.float64]:
        """Rotation (3, 3) from the IMU's axes to the optical frame.

        Raises:
            InputError: `rotation` is tf, which only the node knows, or no rotation at all.
        """
        text = self.rotation.strip()
        angles = ROTATIONS.get(text) or _angles(text)
        if angles is None:
            wrong, names = f"'{text}' is no rotation", ", ".join((*ROTATIONS, ROTATION_FROM_TF))
            if text == ROTATION_FROM_TF:
                wrong, names = "only the node has tf", ", ".join(ROTATIONS)
            raise InputError(
                "imu.rotation", wrong, f"give 'roll,pitch,yaw' in degrees, or one of {names}"
            )
        return np.asarray(Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), np.float64)

    @property
    def time_offset_ns(self) -> int:
        """What is added to the IMU's stamps, ns."""
        return round(self.time_offset_ms * 1e6)


def _angles(text: str) -> tuple[float, ...] | None:
    """Three finite numbers with commas between them; None if that is not what it is."""
    try:
        angles = tuple(float(word) for word in text.split(","))
    except ValueError:
        return None
    return angles if len(angles) == 3 and np.isfinite(angles).all() else None
