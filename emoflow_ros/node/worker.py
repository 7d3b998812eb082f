"""What runs in the worker process, which alone imports the estimators.

The worker answers one request at a time, `warm_up`, `configure` or `window`, over a `Channel`. Its
progress with the warm-up comes before that answer. Over another channel a thread of its own answers
slices while a window is estimated. The worker ends when the node's end of the first channel closes.
"""

import contextlib
import ctypes
import errno
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from emoflow_ros import compiled_code
from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.types.estimate import Estimate, Estimator, Status
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.errors import InputError, keep_traceback
from emoflow_ros.node.channel import Channel, pack, pack_present, unpack_window
from emoflow_ros.node.painter import Painter
from emoflow_ros.node.tasks import Arrays, Wishes
from emoflow_ros.node.warm_up import EstimatorFactory, warm_up

if TYPE_CHECKING:
    from emoflow_ros.core.products.present_motion import PresentMotion

# How long one thread may keep the other one waiting, s: Python's own value delays a slice's answer.
_SWITCH_S = 0.001
_UNWRITABLE = (errno.EACCES, errno.EDQUOT, errno.EFBIG, errno.ENOSPC, errno.EPERM, errno.EROFS)
_M_ARENA_MAX = -8  # of glibc's mallopt


def serve(connection: Connection, slices: Connection, factory: str, nice: int) -> None:
    """Run the worker until the connection closes.

    Args:
        connection: to the node, for everything but slices.
        slices: to the node.
        factory: `module:function` that makes the estimator from a camera and a Config.
        nice: how much lower its priority is than the node's.
    """
    # A terminal sends Ctrl-C to all of its processes; the node decides when its worker ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.setswitchinterval(_SWITCH_S)
    os.nice(nice)
    _share_memory()
    module, _, function = factory.partition(":")
    channel = Channel(connection)
    make_estimator = getattr(importlib.import_module(module), function)
    worker = _Worker(make_estimator, lambda progress: channel.send(progress, {}))
    beside = (Channel(slices), worker.answer_slice)
    threading.Thread(target=_answer_all, args=beside, name="slices", daemon=True).start()
    _answer_all(channel, worker.answer)


def _share_memory() -> None:
    """Let all threads allocate from one arena: each of several would keep what it has freed."""
    with contextlib.suppress(AttributeError):  # another C library than glibc
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def _answer_all(
    channel: Channel, answer: Callable[[dict[str, Any], Arrays], tuple[dict[str, Any], Arrays]]
) -> None:
    try:
        while True:
            channel.send(*answer(*channel.receive()))
    except (EOFError, OSError):
        return


class _Worker:
    def __init__(
        self,
        make_estimator: EstimatorFactory,
        tell: Callable[[dict[str, Any]], None] = lambda progress: None,
    ) -> None:
        self._make_estimator = make_estimator
        self._tell = tell
        self._estimator: Estimator | None = None
        self._painter: Painter | None = None
        self._present: PresentMotion | None = None
        self._last: tuple[Estimate, GyroReadings | None] | None = None  # window, with its gyro
        self._known: tuple[Estimate, GyroReadings | None] | None = None  # of these, by `_present`

    def answer(self, header: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
        """Do what a request asks for; after an error, which is answered, the estimator is cold."""
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
            self._last = None
            return _describe(error), {}

    def answer_slice(self, header: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
        """Estimate the motion at the end of a slice; this is called in another thread."""
        present, last = self._present, self._last
        if present is None or last is None:
            return pack_present(None)
        try:
            if last is not self._known:
                present.know(*last)
                self._known = last
            return pack_present(present.estimate(unpack_window(header, arrays)))
        except Exception as error:
            return _describe(error), {}

    def _warm_up(self) -> dict[str, Any]:
        """Compile and load all code before real events come.

        Returns:
            `compiled`: whether anything was compiled, and not found on disk.
        """
        from emoflow_ros.node.compilation import watched
        from emoflow_ros.node.compile_beside import compiled_beside

        with (
            compiled_beside() as begin,
            watched(lambda line: self._tell({"progress": line}), begin) as compilation,
        ):
            warm_up(self._make_estimator)
        return {"compiled": bool(compilation.count)}

    def _configure(self, header: dict[str, Any]) -> dict[str, Any]:
        camera = Camera(**header["camera"] | {"distortion": tuple(header["camera"]["distortion"])})
        self._painter = Painter(camera)
        config = load_config(header["config"]["profile"], header["config"])
        self._estimator = self._make_estimator(camera, config)
        # Of small products: a second thread of the linear algebra would only keep a core busy.
        threadpool_limits(limits=1, user_api="blas")
        self._present = self._last = None
        if isinstance(config.estimator, LatticeConfig):
            from emoflow_ros.core.products.present_motion import PresentMotion

            self._present = PresentMotion(camera, config.estimator)
        return {}

    def _estimate(self, header: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
        if self._estimator is None or self._painter is None:
            return {"error": "a window before the configuration"}, {}
        if header["cold"]:
            self._estimator.reset()
        window = unpack_window(header, arrays)
        began = time.monotonic(), time.process_time()
        estimate = self._estimator.estimate(window)
        work = {
            "wall_s": time.monotonic() - began[0],
            "processor_s": time.process_time() - began[1],
        }
        answer, values = pack(estimate)
        if estimate.told and not all(np.isfinite(value).all() for value in values.values()):
            self._estimator.reset()
            estimate = replace(estimate, status=Status.DIVERGED, flow=None, motion=None)
            answer, values = pack(estimate)
        self._last = estimate, window.gyro
        answer |= work
        if not estimate.told:
            return answer, values
        window = window.since(estimate.t_start)
        values |= self._painter.draw(Wishes(**header["wishes"]), estimate, window)
        return answer | {"drawing_s": self._painter.took}, values


def _describe(error: Exception) -> dict[str, Any]:
    """Say what went wrong, whether CUDA did, and whether the process can go on after it."""
    device = "CUDA" in str(error)
    out_of_memory = isinstance(error, MemoryError) or "DefaultCPUAllocator" in str(error)
    if isinstance(error, OSError) and error.errno in _UNWRITABLE:
        error = compiled_code.not_kept(error)  # the one thing that a worker writes
    if isinstance(error, InputError):
        return {"error": str(error), "device": device, "fatal": False}
    line = " ".join(f"{type(error).__name__}: {error}".split()) + keep_traceback(error)
    return {"error": line, "device": device, "fatal": device or out_of_memory}
