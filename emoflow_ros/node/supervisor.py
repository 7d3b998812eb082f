"""The node's side of the worker: starts it, feeds it, and replaces it when it dies or hangs."""

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from queue import SimpleQueue
from typing import Any

from emoflow_ros.config import Config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.options import replace_options
from emoflow_ros.errors import InputError
from emoflow_ros.node.channel import pack_window, unpack
from emoflow_ros.node.picture_budget import PictureBudget
from emoflow_ros.node.tasks import (
    Arrays,
    DropOldestQueue,
    Job,
    Loss,
    Notice,
    Outcome,
    Progress,
    Task,
)
from emoflow_ros.node.warm_up import WARM_UP_CAMERA
from emoflow_ros.node.worker import serve
from emoflow_ros.node.worker_process import SliceFeed, WorkerDiedError, WorkerProcess, why_lost

FACTORY = "emoflow_ros.factory:make_estimator"
STARTING = "the worker is starting"
_NEEDED_TO_WARM_UP = (
    "emoflow_ros.core.lattice.estimator", "emoflow_ros.core.products.present_motion",
)  # fmt: skip

_IDLE_S = 0.1
_LONGEST_PAUSE_S = 10.0
_START_S = 120.0  # the first start on a machine compiles, and CUDA takes its time
_FIX = "or set on_missing_device to cpu"


class Supervisor:
    """Runs jobs through a worker process, one at a time, in a thread of its own.

    A worker that dies or takes longer than `timeout_s` is replaced; that costs the window it
    was working on. The replacement is forked from a server process that has the estimator and its
    compiled code loaded already. Where CUDA fails a worker and `may_use_cpu` is set, the next ones
    estimate on the CPU. Any other error in the thread costs the worker, too, and is an outcome
    with its traceback.

    Args:
        capacity: windows that may wait; one more drops the oldest.
        timeout_s: time for one window.
        may_use_cpu: whether to go on without the device that is asked for.
        wake: called in the supervisor's thread when there is an outcome.
        factory: `module:function` that makes the estimator in the worker.
        nice: how much lower the worker's priority is than the node's.

    Attributes:
        queue: where jobs are put.
        outcomes: what became of the jobs and the worker.
        ready: set once the first worker is warm.
        obstacle: why nothing is estimated at the moment; empty while the worker answers.
    """

    def __init__(
        self,
        *,
        capacity: int,
        timeout_s: float,
        may_use_cpu: bool,
        wake: Callable[[], None],
        factory: str = FACTORY,
        nice: int = 0,
    ) -> None:
        self.queue: DropOldestQueue[Job] = DropOldestQueue(capacity)
        self.outcomes: SimpleQueue[Outcome] = SimpleQueue()
        self.ready = threading.Event()
        self.obstacle = STARTING
        self._timeout_s = timeout_s
        self._may_use_cpu = may_use_cpu
        self._on_cpu = False  # because the device failed
        self._wake = wake
        self._factory = factory
        self._nice = nice
        self._context = multiprocessing.get_context("forkserver")
        own = "emoflow_ros.node.preloaded" if factory == FACTORY else factory.partition(":")[0]
        self._context.set_forkserver_preload([own, serve.__module__, *_NEEDED_TO_WARM_UP])
        self._configured: tuple[Camera, Config] | None = None
        self._epoch = -1
        self._pictures = PictureBudget()
        self._task: Task | None = None
        self._feed = SliceFeed(self._ready_worker, timeout_s, self._tell)
        self._worker: WorkerProcess | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    def start(self) -> None:
        """Start the thread, which starts the worker; `ready` is set when that is warm."""
        self._thread.start()
        self._feed.start()

    @property
    def slices(self) -> DropOldestQueue[Task]:
        """Where slices are put; the next one replaces one that waits."""
        return self._feed.queue

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

    @property
    def pid(self) -> int | None:
        """The worker's process id, None while there is none."""
        worker = self._worker
        return None if worker is None else worker.pid

    @property
    def busy_s(self) -> float:
        """How long the worker has been busy with what it does now, s; 0 if it waits."""
        worker = self._worker
        return 0.0 if worker is None else worker.busy_s

    @property
    def has_ended(self) -> bool:
        """Whether the thread has ended although nobody stopped it."""
        started = self._thread.ident is not None
        return started and not self._thread.is_alive() and not self._stopping.is_set()

    def stop(self) -> None:
        """End the worker at once, also in the middle of a window."""
        self._stopping.set()
        if (worker := self._worker) is not None:
            worker.kill()
        if self._thread.is_alive():
            self._thread.join(timeout=0.5)
        self._feed.stop()
        if not self._thread.is_alive():
            self._end_worker()

    def _run(self) -> None:
        # The server process and its workers inherit this thread's mask: Ctrl-C is for the node.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        pause = 0.0
        try:
            while not self._stopping.is_set():
                try:
                    answered = self._advance()
                except Exception as error:  # the node would go on without this thread
                    if self._stopping.is_set():
                        break
                    self._lose_worker(error)
                    self._stopping.wait(pause)
                    pause = min(max(2 * pause, _IDLE_S), _LONGEST_PAUSE_S)
                else:
                    pause = 0.0 if answered else pause
        finally:
            self._end_worker()

    def _advance(self) -> bool:
        """Start a worker if there is none, and run the oldest job; return whether there was one."""
        if self._worker is None:
            self._start_worker()
        if not self.ready.is_set():  # a replacement has windows waiting
            self._warm_up()
            self.ready.set()
        job = self.queue.get(_IDLE_S)
        if job is None:
            assert self._worker is not None
            self._worker.check()  # a worker that dies between two windows costs none
            return False
        self._task = job.task
        self._serve(job)
        return True

    def _serve(self, job: Job) -> None:
        if (job.camera, job.config) != self._configured:
            self._configure(job.camera, job.config)
        task = job.task
        cold = task.epoch != self._epoch
        self._epoch = task.epoch
        wished = job.wishes.pictures
        drawn = self._pictures.choose(wished, task.received, job.interval_s)
        wishes = asdict(replace(job.wishes, pictures=drawn))
        interval, columns = pack_window(job.thinned().task.window)
        header, arrays = self._request(
            {"kind": "window", **interval, "cold": cold, "wishes": wishes}, columns
        )
        if header.get("fatal"):
            self._fail_over(header)
            raise WorkerDiedError(f"a window failed: {header['error']}")
        outcome: Outcome
        if "error" in header:
            outcome = Loss(f"a window failed: {header['error']}", worker=False, task=task)
        else:
            result = unpack(task, header, arrays)
            self._pictures.note(result, header.get("drawing_s", {}))
            left_out = len(wished) - len(drawn)
            outcome = replace(result, camera=job.camera, left_out=left_out)
        self._task = None
        self._tell(outcome)

    def _configure(self, camera: Camera, config: Config) -> None:
        lost = self._on_cpu and config.device != "cpu"
        used = replace_options(config, {"estimator.device": "cpu"}) if lost else config
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
        self._tell(Notice(f"{answer['error']}; estimating on the CPU until configured anew"))
        return True

    def _start_worker(self) -> None:
        self._worker = WorkerProcess(self._context, self._factory, self._timeout_s, self._nice)
        self._configured = None
        if self._stopping.is_set():
            raise WorkerDiedError("stopped")

    def _warm_up(self) -> None:
        """Warm the worker up; one that had to compile is replaced by one that has not.

        The compiler's memory, more than the estimation takes, would stay with the process. Its
        server has not loaded what was missing, and is replaced, too.
        """
        if self._ask_to_warm_up().get("compiled"):
            configured = self._configured
            worker, self._worker = self._worker, None
            assert worker is not None
            worker.end_with_server()
            self._start_worker()
            self._ask_to_warm_up()
            if configured is not None:  # by `check`
                self._configure(*configured)

    def _ask_to_warm_up(self) -> dict[str, Any]:
        assert self._worker is not None
        answer, _ = self._worker.request({"kind": "warm_up"}, {}, _START_S, self._note_progress)
        self.obstacle = ""
        if "error" in answer:
            raise WorkerDiedError(f"the worker cannot be started: {answer['error']}")
        return answer

    def _note_progress(self, line: str) -> None:
        self.obstacle = f"{STARTING}: {line}"
        self._tell(Progress(line))

    def _request(
        self, header: dict[str, Any], arrays: Arrays, timeout_s: float | None = None
    ) -> tuple[dict[str, Any], Arrays]:
        """Send a request and wait for the answer, for as long as it may take."""
        assert self._worker is not None
        limit = self._timeout_s if timeout_s is None else timeout_s
        answer = self._worker.request(header, arrays, limit)
        self.obstacle = ""
        return answer

    def _lose_worker(self, error: Exception) -> None:
        """End the worker, so that the next one starts from nothing, and tell why."""
        reason, trace = why_lost(error)
        self.obstacle = reason
        self._end_worker()
        task, self._task = self._task, None
        with contextlib.suppress(Exception):  # of `wake`: the outcome is in the queue already
            self._tell(Loss(reason, worker=True, task=task, trace=trace))

    def _tell(self, outcome: Outcome) -> None:
        self.outcomes.put(outcome)
        self._wake()

    def _ready_worker(self) -> WorkerProcess | None:
        return self._worker if self._configured is not None else None

    def _end_worker(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.end()
