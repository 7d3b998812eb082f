"""An estimate as the plain data that crosses the channel: a header and arrays."""

from dataclasses import asdict
from typing import Any

import numpy as np

from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.gyro_faults import GyroState, GyroStatus
from emoflow_ros.core.twist import Twist
from emoflow_ros.node.channel import Arrays
from emoflow_ros.node.tasks import Result, Task


def pack(estimate: Estimate, twists: list[Twist]) -> tuple[dict[str, Any], Arrays]:
    """Turn an estimate, without its samplers, and its twists into plain data."""
    header = {
        "t_start": estimate.t_start,
        "t_end": estimate.t_end,
        "t": estimate.t,
        "status": estimate.status,
        "model": estimate.model,
        "quality": asdict(estimate.quality),
        "gyro": [estimate.gyro.state, estimate.gyro.reason],
        "times": [twist.t for twist in twists],
    }
    arrays: Arrays = {
        "linear": np.asarray(estimate.linear, np.float64),
        "angular": np.asarray(estimate.angular, np.float64),
        "covariance": np.asarray(estimate.covariance, np.float64),
        "twists": np.array([(*w.linear, *w.angular) for w in twists], np.float64).reshape(-1, 6),
    }
    return header, arrays


def unpack(task: Task, header: dict[str, Any], arrays: Arrays) -> Result:
    """Build a task's result from its answer; what `pack` does not know of are pictures."""
    state, reason = header["gyro"]
    estimate = Estimate(
        t_start=header["t_start"],
        t_end=header["t_end"],
        t=header["t"],
        status=Status(header["status"]),
        model=MotionModel(header["model"]),
        quality=Quality(**header["quality"]),
        gyro=GyroStatus(GyroState(state), reason),
        linear=arrays.pop("linear"),
        angular=arrays.pop("angular"),
        covariance=arrays.pop("covariance"),
    )
    rows = zip(header["times"], arrays.pop("twists"), strict=True)
    twists = tuple(Twist(t, row[:3], row[3:]) for t, row in rows)
    return Result(task, estimate, twists, pictures=arrays)
