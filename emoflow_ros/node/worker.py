"""The worker process, which alone imports the estimators, and the node's handle of it.

The worker answers one request at a time, `warm_up`, `configure` or `window`, over a `Channel`. It
ends when the node's end of the channel closes.
"""

import contextlib
import importlib
import signal
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from typing import Any

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config, load_config
from emoflow_ros.core.estimate import Estimate, Estimator, FlowSampler, Status, at_middle, sample
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Events, Window
from emoflow_ros.core.products import (
    Tracker,
    Tracks,
    flow_to_rgb,
    sharpened_events,
    trails_at_unit_depth,
)
from emoflow_ros.errors import InputError, keep_traceback
from emoflow_ros.node.tasks import Arrays, Channel, Picture, Wishes, pack
from emoflow_ros.node.window_transfer import from_arrays

type EstimatorFactory = Callable[[Camera, Config], Estimator]

WARM_UP_CAMERA = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)

_WARM_UP_EVENTS = 20_000
_WARM_UP_SPEED = 200  # px/s
_TRACKED = 4  # windows: longer tracks tangle where the motion is fast


class WorkerDiedError(Exception):
    """The worker ended, or was ended, before it answered."""


class WorkerProcess:
    """A worker, started; one thread uses it, any thread may kill it.

    Args:
        context: how processes are started.
        factory: `module:function` that makes the estimator.
        stall_s: time for a transfer that has begun.

    Attributes:
        pid: its process id.

    Raises:
        WorkerDiedError: it cannot be started.
    """

    def __init__(self, context: ForkServerContext, factory: str, stall_s: float) -> None:
        mine, its = context.Pipe()
        self._process = context.Process(
            target=serve, args=(its, factory), name="estimator_worker", daemon=True
        )
        try:
            self._process.start()
        except (OSError, EOFError) as error:
            mine.close()
            raise WorkerDiedError(f"the worker cannot be started ({error})") from None
        finally:
            its.close()
        self.pid: int | None = self._process.pid
        self._channel = Channel(mine, stall_s)

    def request(
        self, header: Mapping[str, Any], arrays: Arrays, limit: float
    ) -> tuple[dict[str, Any], Arrays]:
        """Send a request and wait for the answer, for `limit` seconds at most.

        Raises:
            WorkerDiedError: there is none in that time.
        """
        try:
            self._channel.send(header, arrays)
            return self._channel.receive(limit)
        except TimeoutError:
            reason = f"the worker gave no answer in {limit:g} s and was ended"
            raise WorkerDiedError(reason) from None
        except (EOFError, OSError):
            raise WorkerDiedError(f"the worker died ({self._exit_reason()})") from None

    def check(self) -> None:
        """Notice a death between two requests.

        Raises:
            WorkerDiedError: it is dead.
        """
        if not self._process.is_alive():
            raise WorkerDiedError(f"the worker died ({self._exit_reason()})")

    def kill(self) -> None:
        """End it at once. Any thread may call this at any time."""
        with contextlib.suppress(ValueError, OSError):
            self._process.kill()

    def end(self) -> None:
        """End it, and close its files now rather than when the garbage collector does."""
        self.kill()
        self._channel.close()
        self._process.join(1.0)
        with contextlib.suppress(ValueError):  # it has not ended yet
            self._process.close()

    def _exit_reason(self) -> str:
        self._process.join(1.0)
        code = self._process.exitcode
        return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"


def serve(connection: Connection, factory: str) -> None:
    """Run the worker until the connection closes.

    Args:
        connection: to the node.
        factory: `module:function` that makes the estimator from a camera and a Config.
    """
    # A terminal sends Ctrl-C to all of its processes; the node decides when its worker ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    module, _, function = factory.partition(":")
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
            return _describe(error), {}

    def _warm_up(self) -> dict[str, Any]:
        """Estimate synthetic events once, so that the code is compiled before the first window."""
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
        window = from_arrays(header, arrays)
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


class Painter:
    """Draws the pictures of one window after another.

    Args:
        camera: whose windows they are.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._tracker: Tracker | None = None
        self._recent: deque[Tracks] = deque(maxlen=_TRACKED)

    def draw(self, wishes: Wishes, estimate: Estimate, window: Window) -> Arrays:
        """Draw the pictures that are wanted, of the sensor's size, at the estimate's time.

        Returns:
            Arrays by `Picture`: the flow (height, width, 2) in px/s, NaN = none, with a
            flow_stride of n only its pixels (n * row, n * column); its colours
            (height, width, 3); the sharpened events (height, width); the point tracks up to
            the window's end as line segments (S, 2, 4), see `trails_at_unit_depth`.
        """
        flow = estimate.flow
        if flow is None:
            return {}
        pictures: Arrays = {}
        if {Picture.FLOW, Picture.COLOR} & set(wishes.pictures):
            pictures[Picture.FLOW] = np.asarray(flow.velocity(estimate.t), np.float32)
        if Picture.COLOR in wishes.pictures:
            longest = wishes.flow_color_max or None
            pictures[Picture.COLOR] = flow_to_rgb(pictures[Picture.FLOW], longest)
        if Picture.FLOW in wishes.pictures:
            stride = wishes.flow_stride
            pictures[Picture.FLOW] = pictures[Picture.FLOW][::stride, ::stride]
        if Picture.EVENTS in wishes.pictures:
            size = (self._camera.width, self._camera.height)
            pictures[Picture.EVENTS] = sharpened_events(window, flow, estimate.t, *size)
        if Picture.TRACKS in wishes.pictures:
            tracks = self._follow(flow, window, wishes.tracks)
            pictures[Picture.TRACKS] = trails_at_unit_depth(tracks, self._camera)
        return {name: pictures[name] for name in wishes.pictures}

    def _follow(self, flow: FlowSampler, window: Window, count: int) -> Sequence[Tracks]:
        """Carry the points through the window; return the last windows' tracks."""
        if self._tracker is None:
            size = (self._camera.width, self._camera.height)
            self._tracker = Tracker(count, *size, longest=_TRACKED)
        self._recent.append(self._tracker.follow(flow, window.t_start, window.t_end))
        return self._recent


def _describe(error: Exception) -> dict[str, Any]:
    """Say what went wrong, whether CUDA did, and whether the process can go on after it."""
    device = "CUDA" in str(error)
    out_of_memory = isinstance(error, MemoryError) or "DefaultCPUAllocator" in str(error)
    if isinstance(error, InputError):
        return {"error": str(error), "device": device, "fatal": False}
    line = " ".join(f"{type(error).__name__}: {error}".split()) + keep_traceback(error)
    return {"error": line, "device": device, "fatal": device or out_of_memory}
