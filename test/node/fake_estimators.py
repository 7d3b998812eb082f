"""Estimators that the worker runs in tests: each shows one good or bad behaviour."""

import errno
import os
import resource
import signal
import time
from collections.abc import Sequence
from dataclasses import replace

import numba
import numpy as np
import psutil

from emoflow_ros.config import Config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.gyro.gyro import Gyro
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import Window
from emoflow_ros.errors import InputError
from emoflow_ros.node.warm_up import WARM_UP_ENDS

_POISON_X = 7  # a window of events in this column alone triggers the bad behaviour


def in_warm_up(window: Window) -> bool:
    """Tell whether it is one of the windows that the worker estimates before it is ready."""
    return window.t_end in WARM_UP_ENDS


class Recorder:
    """Answer with what it was given: angular = (events, windows since the reset, camera width)."""

    def __init__(self, camera: Camera, config: Config) -> None:
        self.camera = camera
        self.config = config
        self.windows = 0

    def estimate(self, window: Window) -> Estimate:
        self.windows += 1
        return Estimate(
            t_start=window.t_start,
            t_end=window.t_end,
            t=(window.t_start + window.t_end) // 2,
            status=Status.OK,
            quality=Quality(events=len(window.events), stop_reason="converged"),
            model=MotionModel.FULL,
            linear=np.array([0.0, 0.6, 0.8]),
            angular=np.array([len(window.events), self.windows, self.camera.width], float),
            covariance=np.eye(6),
            flow=Shift(self.camera),
            motion=SpeedingUp(window.t_start),
        )

    def reset(self) -> None:
        self.windows = 0


class Compiler(Recorder):
    """Compile a function for each window; angular = (process id, 0, 0)."""

    def estimate(self, window: Window) -> Estimate:
        numba.njit(lambda x: x + 1)(1)
        return replace(super().estimate(window), angular=np.array([os.getpid(), 0.0, 0.0]))


class FullDisk(Recorder):
    """Its compiled code cannot be written."""

    def estimate(self, window: Window) -> Estimate:
        raise OSError(errno.ENOSPC, "No space left on device")


class GyroRecorder(Recorder):
    """Answer with what a gyro says: its angular velocity, and what became of it."""

    def __init__(self, camera: Camera, config: Config) -> None:
        super().__init__(camera, config)
        self.gyro = Gyro(config.imu)

    def estimate(self, window: Window) -> Estimate:
        measured = self.gyro.measure(window.t_start, window.t_end, window.gyro)
        angular = measured.w if measured else np.zeros(3)
        return replace(super().estimate(window), angular=angular, gyro=self.gyro.status)


class SpeedingUp:
    """A motion that turns about x, by as many rad/s as ns have passed in the window."""

    def __init__(self, t_start: int) -> None:
        self.t_start = t_start

    def angular(self, t: int) -> np.ndarray:
        return np.array([t - self.t_start, 0, 0], float)

    def linear(self, t: int) -> np.ndarray:
        return np.array([0.0, 0.6, 0.8])


class Shift:
    """A flow of (1, -2) px/s, unknown in the first column of its image."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def velocity(self, t: int) -> np.ndarray:
        flow = np.tile(np.float32([1, -2]), (self.camera.height, self.camera.width, 1))
        flow[:, 0] = np.nan
        return flow

    def tracks(self, points: np.ndarray, times: Sequence[int]) -> np.ndarray:
        since = (np.array(times) - times[0]) / 1e9
        return points + since[:, None, None] * (1.0, -2.0)


class Poisoned(Recorder):
    """Misbehaves on windows of events in column 7 alone."""

    def estimate(self, window: Window) -> Estimate:
        if (window.events.x == _POISON_X).all():
            self.misbehave()
        return super().estimate(window)


class Dying(Poisoned):
    def misbehave(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Hanging(Poisoned):
    def misbehave(self) -> None:
        time.sleep(3600)


class Raising(Poisoned):
    def misbehave(self) -> None:
        raise FloatingPointError("no luck")


class Greedy(Poisoned):
    """Wants more memory than there is: the process may not have 256 MiB more."""

    def misbehave(self) -> None:
        limit = psutil.Process().memory_info().vms + 2**28
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        np.ones(2**29)


class NoCuda(Recorder):
    """A machine without the device."""

    def __init__(self, camera: Camera, config: Config) -> None:
        if config.device == "cuda":
            raise InputError("estimator.device", "no CUDA device was found", "use cpu")
        super().__init__(camera, config)


class LosesCuda(Poisoned):
    """A device that is there, until it fails as torch says it."""

    def misbehave(self) -> None:
        if self.config.device == "cuda":
            raise RuntimeError("CUDA error: unspecified launch failure\nlook at dmesg")


class NotFinite(Recorder):
    def estimate(self, window: Window) -> Estimate:
        estimate = super().estimate(window)
        if (window.events.x == _POISON_X).all():
            estimate.angular[1] = np.nan
        return estimate


class Trackless(Recorder):
    """Its flow cannot be followed, as the latest twist wants it."""

    def estimate(self, window: Window) -> Estimate:
        found = super().estimate(window)
        return found if in_warm_up(window) else replace(found, flow=Still())


class Still:
    """A flow that knows nothing."""

    def tracks(self, points: np.ndarray, times: Sequence[int]) -> np.ndarray:
        raise ValueError("no tracks")


class Exhausted(Recorder):
    """The latest twist runs out of memory."""

    def estimate(self, window: Window) -> Estimate:
        found = super().estimate(window)
        return found if in_warm_up(window) else replace(found, flow=Large())


class Large:
    """A flow that no memory holds."""

    def tracks(self, points: np.ndarray, times: Sequence[int]) -> np.ndarray:
        raise MemoryError("no memory")


class Slow(Recorder):
    """Needs 50 ms for a window."""

    def estimate(self, window: Window) -> Estimate:
        time.sleep(0.05)
        return super().estimate(window)


class Busy(Recorder):
    """Optimises for ever, without ever letting go of the interpreter."""

    def estimate(self, window: Window) -> Estimate:
        if not in_warm_up(window):
            while True:
                pass
        return super().estimate(window)


class ByProfile(Recorder):
    """Tells its configuration."""

    def estimate(self, window: Window) -> Estimate:
        said = f"{self.config.profile} {self.config.window.duration_ms}"
        return replace(super().estimate(window), quality=Quality(events=5, stop_reason=said))
