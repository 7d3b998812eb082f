"""The worker process: the only part of the node that imports the estimators.

It answers one request at a time, `configure` or `window`, over a `Channel`, and ends when the
node's end of it closes.
"""

import importlib
import signal
from collections.abc import Callable
from dataclasses import asdict, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.estimate import Estimate, Estimator, Status
from emoflow_ros.core.events import Events
from emoflow_ros.core.options import replace_options
from emoflow_ros.core.twist import Twist, at_middle, sample
from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.node.channel import Arrays, Channel
from emoflow_ros.node.pictures import Painter
from emoflow_ros.node.tasks import Wishes

type EstimatorFactory = Callable[[Camera, Config], Estimator]

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
            return {"error": f"{type(error).__name__}: {error}"}, {}

    def _warm_up(self) -> dict[str, Any]:
        """Estimate synthetic events once, so that the first real window meets compiled code."""
        camera = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)
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
        self._estimator = self._make_estimator(camera, replace_options(Config(), header["config"]))
        return {}

    def _estimate(self, header: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
        if self._estimator is None or self._painter is None:
            return {"error": "a window before the configuration"}, {}
        if header["cold"]:
            self._estimator.reset()
        window = Window(header["t_start"], header["t_end"], Events(**arrays))
        estimate = self._estimator.estimate(window)
        if estimate.status is Status.OK and not _is_finite(estimate):
            self._estimator.reset()
            estimate = replace(estimate, status=Status.DIVERGED)
        if estimate.status is not Status.OK:
            return _pack(estimate, [])
        times = header["times"]
        twists = [at_middle(estimate)] if times is None else sample(estimate, times)
        answer, values = _pack(estimate, twists)
        values |= self._painter.draw(Wishes(**header["wishes"]), estimate, window)
        return answer, values


def _is_finite(estimate: Estimate) -> bool:
    values = (estimate.linear, estimate.angular, estimate.covariance)
    return all(np.isfinite(v).all() for v in values)


def _pack(estimate: Estimate, twists: list[Twist]) -> tuple[dict[str, Any], Arrays]:
    """Turn an estimate, without its samplers, and its twists into plain data."""
    header = {
        "t_start": estimate.t_start,
        "t_end": estimate.t_end,
        "t": estimate.t,
        "status": estimate.status,
        "model": estimate.model,
        "quality": asdict(estimate.quality),
        "times": [twist.t for twist in twists],
    }
    arrays: Arrays = {
        "linear": np.asarray(estimate.linear, np.float64),
        "angular": np.asarray(estimate.angular, np.float64),
        "covariance": np.asarray(estimate.covariance, np.float64),
        "twists": np.array([(*w.linear, *w.angular) for w in twists], np.float64).reshape(-1, 6),
    }
    return header, arrays
