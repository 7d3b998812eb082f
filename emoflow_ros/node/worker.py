"""The worker process: the only part of the node that imports the estimators.

It answers one request at a time, `configure` or `window`, over a `Channel`, and ends when the
node's end of it closes.
"""

import importlib
import signal
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config, load_config
from emoflow_ros.core.estimate import Estimator, Status
from emoflow_ros.core.events import Events
from emoflow_ros.core.gyro_readings import GyroReadings
from emoflow_ros.core.twist import at_middle, sample
from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.errors import InputError
from emoflow_ros.node.answer import pack
from emoflow_ros.node.channel import Arrays, Channel
from emoflow_ros.node.pictures import Painter
from emoflow_ros.node.tasks import Wishes
from emoflow_ros.tracebacks import keep_traceback

type EstimatorFactory = Callable[[Camera, Config], Estimator]

WARM_UP_CAMERA = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)

_WARM_UP_EVENTS = 20_000
_WARM_UP_SPEED = 200  # px/s


def serve(connection: Connection, factory: str) -> None:
    """Run the worker until the connection closes.

    Args:
        connection: to the node.
        factory: `module:function` that makes the estimator from a camera and a Config.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole terminal: the node
    module, _, function = factory.partition(":")  # decides when its worker ends.
    worker = _Worker(getattr(importlib.import_module(module), function))
    channel = Channel(connection)
    try:
        while True:
            channel.send(*worker.answer(*channel.receive()))
    except (EOFError, OSError):
        return


class _Worker:
    def __init__(self, make_estimator: EstimatorFactory) -> None:
        self._make_estimator = make_estimator
        self._estimator: Estimator | None = None
        self._painter: Painter | None = None

    def answer(self, header: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
        """Do what a request asks for; errors are an answer, too, and cost a cold start."""
        try:
            match header["kind"]:
                case "warm_up":
                    return self._warm_up(), {}
                case "configure":
                    return self._configure(header), {}
                case "window":
                    return self._estimate(header, arrays)
                case kind:
                    return {"error": f"unknown request {kind}"}, {}
        except Exception as error:
            if self._estimator is not None:
                self._estimator.reset()
            return _describe(error), {}

    def _warm_up(self) -> dict[str, Any]:
        """Estimate synthetic events once, so that the first real window meets compiled code."""
        camera = WARM_UP_CAMERA
        rng = np.random.default_rng(0)
        end = 90 * NS_PER_MS
        t = np.sort(rng.integers(0, end, _WARM_UP_EVENTS))
        dots = rng.integers(0, (camera.width, camera.height), (500, 2))
        x, y = dots[rng.integers(0, len(dots), len(t))].T
        moved = (x + t * _WARM_UP_SPEED // NS_PER_S) % camera.width
        events = Events(moved.astype(np.uint16), y.astype(np.uint16), t, x % 2 == 0)
        self._make_estimator(camera, Config()).estimate(Window(0, end, events))
        return {}

    def _configure(self, header: dict[str, Any]) -> dict[str, Any]:
        camera = Camera(**header["camera"] | {"distortion": tuple(header["camera"]["distortion"])})
        self._painter = Painter(camera)
        config = load_config(header["config"]["profile"], header["config"])
        self._estimator = self._make_estimator(camera, config)
        return {}

    def _estimate(self, header: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
        if self._estimator is None or self._painter is None:
            return {"error": "a window before the configuration"}, {}
        if header["cold"]:
            self._estimator.reset()
        gyro = None
        if "gyro_t" in arrays:
            gyro = GyroReadings(arrays.pop("gyro_t"), arrays.pop("gyro_w"))
        window = Window(header["t_start"], header["t_end"], Events(**arrays), gyro)
        estimate = self._estimator.estimate(window)
        if estimate.status is not Status.OK:
            return pack(estimate, [])
        window = window.since(estimate.t_start)
        times = header["times"]
        twists = [at_middle(estimate)] if times is None else sample(estimate, times)
        answer, values = pack(estimate, twists)
        if not all(np.isfinite(value).all() for value in values.values()):
            self._estimator.reset()
            return pack(replace(estimate, status=Status.DIVERGED), [])
        values |= self._painter.draw(Wishes(**header["wishes"]), estimate, window)
        return answer, values


def _describe(error: Exception) -> dict[str, Any]:
    """Say what went wrong, whether CUDA did, and whether the process can go on after it."""
    device = "CUDA" in str(error)
    out_of_memory = isinstance(error, MemoryError) or "DefaultCPUAllocator" in str(error)
    if isinstance(error, InputError):
        return {"error": str(error), "device": device, "fatal": False}
    line = " ".join(f"{type(error).__name__}: {error}".split()) + keep_traceback(error)
    return {"error": line, "device": device, "fatal": device or out_of_memory}
