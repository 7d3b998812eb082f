"""The node's side of the worker: starts it, feeds it, and replaces it when it dies or hangs."""

import contextlib
import multiprocessing
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from multiprocessing.process import BaseProcess
from typing import Any

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.options import replace_options
from emoflow_ros.core.twist import grid_times
from emoflow_ros.core.windows import Window
from emoflow_ros.errors import InputError
from emoflow_ros.node.answer import unpack
from emoflow_ros.node.channel import Arrays, Channel
from emoflow_ros.node.queue import DropOldestQueue
from emoflow_ros.node.tasks import Loss, Notice, Outcome, Task, Wishes
from emoflow_ros.node.worker import WARM_UP_CAMERA, serve

FACTORY = "emoflow_ros.core.factory:make_estimator"

_IDLE_S = 0.1
_LONGEST_PAUSE_S = 10.0
_START_S = 120.0  # the first start on a machine compiles, and CUDA takes its time
_FIX = "or set on_missing_device to cpu"


class WorkerDiedError(Exception):
    """The worker ended, or was ended, before it answered."""


class Supervisor:
    """Runs tasks through a worker process, one at a time, in a thread of its own.

    A worker that dies or takes longer than `timeout_s` is replaced; that costs the window it
    was working on. The replacement is forked from a server process that has the estimator's
    modules loaded already. Where CUDA fails a worker and `may_use_cpu` is set, the next ones
    estimate on the CPU.

    Args:
        capacity: windows that may wait; one more drops the oldest.
        timeout_s: time for one window.
        may_use_cpu: whether to go on without the device that is asked for.
        on_outcome: called in the supervisor's thread with what became of a task or the worker.
        factory: `module:function` that makes the estimator in the worker.

    Attributes:
        queue: where tasks are put.
        ready: set once the first worker is warm.
        wishes: what results hold besides the estimate.
    """

    def __init__(
        self,
        *,
        capacity: int,
        timeout_s: float,
        may_use_cpu: bool,
        on_outcome: Callable[[Outcome], None],
        factory: str = FACTORY,
    ) -> None:
        self.queue: DropOldestQueue[Task] = DropOldestQueue(capacity)
        self.ready = threading.Event()
        self.wishes = Wishes()
        self._timeout_s = timeout_s
        self._may_use_cpu = may_use_cpu
        self._on_cpu = False  # because the device failed
        self._on_outcome = on_outcome
        self._factory = factory
        self._context = multiprocessing.get_context("forkserver")
        # The factory imports its estimators late; that of the default profile is wanted at once.
        self._context.set_forkserver_preload(
            [factory.partition(":")[0], "emoflow_ros.core.lattice_estimator", serve.__module__]
        )
        self._setup: tuple[Camera, Config] | None = None
        self._configured: tuple[Camera, Config] | None = None
        self._epoch = -1
        self._task: Task | None = None
        self._last_twist = -1
        self._process: BaseProcess | None = None
        self._channel: Channel | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    def start(self) -> None:
        """Start the thread, which starts the worker; `ready` is set when that is warm."""
        self._thread.start()

    def check(self, config: Config) -> None:
        """Wait for a worker that can estimate with this configuration; call it before `start`.

        Raises:
            InputError: there is none, and why.
        """
        try:
            self._start_worker()
            self._configure(WARM_UP_CAMERA, config)
        except WorkerDiedError as error:
            self.stop()
            raise InputError("estimator.device", str(error), _FIX) from None

    def configure(self, camera: Camera, config: Config) -> None:
        """Set what the next windows are estimated with. Windows wait until this was called."""
        self._setup = (camera, config)

    def unconfigure(self) -> None:
        """Let windows wait until `configure` is called again."""
        self._setup = None

    @property
    def pid(self) -> int | None:
        """The worker's process id, None while there is none."""
        process = self._process
        return None if process is None else process.pid

    def stop(self) -> None:
        """End the worker at once, also in the middle of a window."""
        self._stopping.set()
        self._kill()
        if self._thread.is_alive():
            self._thread.join(timeout=0.5)
        self._kill()

    def _run(self) -> None:
        # The server process and its workers inherit this thread's mask: Ctrl-C is for the node.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        pause = _IDLE_S
        while not self._stopping.is_set():
            try:
                if self._channel is None:
                    self._start_worker()
                if not self.ready.is_set():  # a replacement has windows waiting
                    self._warm_up()
                    self.ready.set()
                answered = self._serve_next()
            except WorkerDiedError as error:
                if self._stopping.is_set():
                    break
                self._lose_worker(str(error))
                self._stopping.wait(pause)
                pause = min(2 * pause, _LONGEST_PAUSE_S)
            else:
                if answered:
                    pause = _IDLE_S
        self._kill()

    def _serve_next(self) -> bool:
        """Run the oldest task, if there is one and the camera is known."""
        setup = self._setup
        if setup is None:
            self._stopping.wait(_IDLE_S)
            return False
        task = self._task = self.queue.get(_IDLE_S)
        if task is None:
            self._check_idle_worker()
            return False
        setup = self._setup or setup  # what holds now that a window has come
        if setup != self._configured:
            self._configure(*setup)
        cold = task.epoch != self._epoch
        if cold:
            self._last_twist = -1
        self._epoch = task.epoch
        window, wishes = task.window, self.wishes
        header, arrays = self._request(
            {
                "kind": "window",
                "t_start": window.t_start,
                "t_end": window.t_end,
                "cold": cold,
                "wishes": asdict(wishes),
                "times": self._twist_times(window, wishes.twist_rate),
            },
            {name: getattr(window.events, name) for name in ("x", "y", "t", "p")},
        )
        if header.get("fatal"):
            self._fail_over(header)
            raise WorkerDiedError(f"a window failed: {header['error']}")
        if "error" in header:
            self._on_outcome(Loss(f"a window failed: {header['error']}", worker=False, task=task))
        else:
            result = unpack(task, header, arrays)
            if result.twists:
                self._last_twist = result.twists[-1].t
            self._on_outcome(result)
        return True

    def _twist_times(self, window: Window, rate: float) -> list[int] | None:
        """Choose the times of a window's twists: None is the middle."""
        if rate == 0:
            return None
        return grid_times(window.t_start, window.t_end, rate, self._last_twist)

    def _configure(self, camera: Camera, config: Config) -> None:
        used = replace_options(config, {"estimator.device": "cpu"}) if self._on_cpu else config
        answer, _ = self._request(
            {"kind": "configure", "camera": asdict(camera), "config": used.flat()},
            {},
            timeout_s=_START_S,
        )
        if "error" not in answer:
            self._configured = (camera, config)
        elif self._fail_over(answer):
            self._configure(camera, config)
        else:
            raise WorkerDiedError(f"the worker cannot be configured: {answer['error']}")

    def _fail_over(self, answer: dict[str, Any]) -> bool:
        """Use the CPU from now on, if the device is to blame and that is allowed."""
        if not (answer["device"] and self._may_use_cpu) or self._on_cpu:
            return False
        self._on_cpu = True
        self._on_outcome(Notice(f"{answer['error']}; estimating on the CPU until configured anew"))
        return True

    def _start_worker(self) -> None:
        mine, its = self._context.Pipe()
        process = self._context.Process(
            target=serve, args=(its, self._factory), name="estimator_worker", daemon=True
        )
        try:
            process.start()
        except (OSError, EOFError) as error:
            raise WorkerDiedError(f"the worker cannot be started ({error})") from None
        finally:
            its.close()
        self._process, self._channel, self._configured = process, Channel(mine), None
        if self._stopping.is_set():
            raise WorkerDiedError("stopped")

    def _warm_up(self) -> None:
        answer, _ = self._request({"kind": "warm_up"}, {}, timeout_s=_START_S)
        if "error" in answer:
            raise WorkerDiedError(f"the worker cannot be started: {answer['error']}")

    def _request(
        self, header: dict[str, Any], arrays: Arrays, timeout_s: float | None = None
    ) -> tuple[dict[str, Any], Arrays]:
        """Send a request and wait for the answer; past the time the worker is killed."""
        assert self._channel is not None
        limit = self._timeout_s if timeout_s is None else timeout_s
        started = time.monotonic()
        watchdog = threading.Timer(limit, self._kill)
        watchdog.start()
        try:
            self._channel.send(header, arrays)
            return self._channel.receive()
        except (EOFError, OSError):
            pass
        finally:
            watchdog.cancel()
        if time.monotonic() - started >= limit:
            raise WorkerDiedError(f"the worker gave no answer in {limit:g} s and was ended")
        raise WorkerDiedError(f"the worker died ({self._exit_reason()})")

    def _check_idle_worker(self) -> None:
        """Notice a death between two windows, which then costs none."""
        assert self._process is not None
        if not self._process.is_alive():
            raise WorkerDiedError(f"the worker died ({self._exit_reason()})")

    def _exit_reason(self) -> str:
        assert self._process is not None
        self._process.join(1.0)
        code = self._process.exitcode
        return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"

    def _lose_worker(self, reason: str) -> None:
        self._kill()
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        self._on_outcome(Loss(f"{reason}; it is started again", worker=True, task=self._task))
        self._task = None

    def _kill(self) -> None:
        process = self._process
        if process is not None:
            with contextlib.suppress(ValueError, OSError):
                process.kill()
