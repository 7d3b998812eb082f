"""The node's handle of its worker process, and the thread that has slices estimated in it."""

import contextlib
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from multiprocessing.context import ForkServerContext
from typing import Any

import psutil

from emoflow_ros.node.channel import Channel, pack_window, unpack_present
from emoflow_ros.node.tasks import Arrays, DropOldestQueue, Loss, Present, Task
from emoflow_ros.node.worker import serve

_IDLE_S = 0.1


class WorkerDiedError(Exception):
    """The worker ended, or was ended, before it answered."""


def why_lost(error: Exception) -> tuple[str, str]:
    """Say why a worker is given up, while the exception is handled; the traceback if it is ours."""
    if isinstance(error, WorkerDiedError):
        return f"{error}; it is started again", ""
    name = type(error).__name__
    reason = f"an error in the node ({name}: {error}); the worker is started again"
    return reason, traceback.format_exc()


class WorkerProcess:
    """A worker, started; one thread uses it, another one has slices estimated, any may kill it.

    Args:
        context: how processes are started.
        factory: `module:function` that makes the estimator.
        stall_s: time for a transfer that has begun.
        nice: how much lower its priority is than the node's.

    Attributes:
        pid: its process id.

    Raises:
        WorkerDiedError: it cannot be started.
    """

    def __init__(
        self, context: ForkServerContext, factory: str, stall_s: float, nice: int = 0
    ) -> None:
        mine, its = context.Pipe()
        my_slices, its_slices = context.Pipe()
        self._process = context.Process(
            target=serve,
            args=(its, its_slices, factory, nice),
            name="estimator_worker",
            daemon=True,
        )
        try:
            self._process.start()
        except (OSError, EOFError) as error:
            mine.close()
            my_slices.close()
            raise WorkerDiedError(f"the worker cannot be started ({error})") from None
        finally:
            its.close()
            its_slices.close()
        self.pid: int | None = self._process.pid
        self._killed_because = ""
        self._asked_at: float | None = None
        self._channel = Channel(mine, stall_s)
        self._slices = Channel(my_slices, stall_s)

    def request(
        self,
        header: Mapping[str, Any],
        arrays: Arrays,
        limit: float,
        note: Callable[[str], None] = lambda progress: None,
    ) -> tuple[dict[str, Any], Arrays]:
        """Send a request and wait for the answer.

        Args:
            header, arrays: the request.
            limit: how long the worker may be silent, s.
            note: gets what the worker says of its progress before it answers.

        Raises:
            WorkerDiedError: the worker is silent for longer, or dies.
        """
        self._asked_at = time.monotonic()
        try:
            return self._ask(self._channel, header, arrays, limit, note)
        finally:
            self._asked_at = None

    @property
    def busy_s(self) -> float:
        """How long a request, other than a slice, has been without an answer, s; 0 without one."""
        asked_at = self._asked_at
        return 0.0 if asked_at is None else time.monotonic() - asked_at

    def estimate_slice(
        self, header: Mapping[str, Any], arrays: Arrays, limit: float
    ) -> tuple[dict[str, Any], Arrays]:
        """Have the motion at the end of a slice estimated, beside the windows.

        Raises:
            WorkerDiedError: there is no answer in `limit` seconds.
        """
        return self._ask(self._slices, header, arrays, limit)

    def _ask(
        self,
        channel: Channel,
        header: Mapping[str, Any],
        arrays: Arrays,
        limit: float,
        note: Callable[[str], None] = lambda progress: None,
    ) -> tuple[dict[str, Any], Arrays]:
        try:
            channel.send(header, arrays)
            answer = channel.receive(limit)
            while "progress" in answer[0]:
                note(answer[0]["progress"])
                answer = channel.receive(limit)
            return answer
        except TimeoutError:
            reason = f"the worker gave no answer in {limit:g} s and was ended"
            raise WorkerDiedError(reason) from None
        except (EOFError, OSError):
            raise WorkerDiedError(self._cause_of_death()) from None

    def check(self) -> None:
        """Notice a death between two requests.

        Raises:
            WorkerDiedError: it is dead.
        """
        if not self._process.is_alive():
            raise WorkerDiedError(self._cause_of_death())

    def kill(self, reason: str = "") -> None:
        """End it at once, and say why, if not on request. Any thread may call this at any time."""
        self._killed_because = self._killed_because or reason
        with contextlib.suppress(ValueError, OSError):
            self._process.kill()

    def end(self) -> None:
        """End it, and close its files now rather than when the garbage collector does."""
        self.kill()
        self._channel.close()
        self._slices.close()
        self._process.join(1.0)
        with contextlib.suppress(ValueError):  # it has not ended yet
            self._process.close()

    def end_with_server(self) -> None:
        """End it and the process that it was forked from: the next start makes another one.

        That one then loads what has been compiled meanwhile.
        """
        server = None
        with contextlib.suppress(psutil.Error):  # the worker has died
            server = psutil.Process(self.pid).parent()
        self.end()
        with contextlib.suppress(psutil.Error, OSError):  # it has died, too
            if server is not None and server.ppid() == os.getpid():
                os.kill(server.pid, signal.SIGKILL)
                # Not reaped here: multiprocessing looks for its end before the next start.
                os.waitid(os.P_PID, server.pid, os.WEXITED | os.WNOWAIT)

    def _cause_of_death(self) -> str:
        if self._killed_because:
            return self._killed_because
        try:
            self._process.join(1.0)
            code = self._process.exitcode
        except ValueError:  # closed by another thread
            code = None
        cause = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
        return f"the worker died ({cause})"


class SliceFeed:
    """Has the newest slices estimated beside the windows, in a thread of its own.

    A slice that nobody has time for gives way to the next one. A worker that does not answer is
    ended here; the supervisor notices, and starts another one.

    Args:
        worker: the present worker; None while it is not ready.
        timeout_s: time for one slice.
        tell: gets what comes of slices, in the feed's thread.
    """

    def __init__(
        self,
        worker: Callable[[], WorkerProcess | None],
        timeout_s: float,
        tell: Callable[[Present | Loss], None],
    ) -> None:
        self.queue: DropOldestQueue[Task] = DropOldestQueue(1)
        self._worker = worker
        self._timeout_s = timeout_s
        self._tell = tell
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="slices", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; end the worker before."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=0.5)

    def _run(self) -> None:
        while not self._stopping.is_set():
            task = self.queue.get(_IDLE_S)
            worker = self._worker()
            if task is None or worker is None:
                continue
            outcome: Present | Loss | None = None
            try:
                outcome = self._estimate(worker, task)
            except WorkerDiedError as error:
                worker.kill(str(error))
            except Exception as error:  # the node would go on without this thread
                if self._stopping.is_set():
                    break
                reason = f"an error in the node ({type(error).__name__}: {error})"
                worker.kill(reason)  # it may still answer: that would be taken for the next answer
                outcome = Loss(reason, worker=False, trace=traceback.format_exc())
            if outcome is not None:
                with contextlib.suppress(Exception):  # of `wake`: the outcome is in the queue
                    self._tell(outcome)

    def _estimate(self, worker: WorkerProcess, task: Task) -> Present | Loss | None:
        request = pack_window(task.window)
        header, arrays = worker.estimate_slice(*request, self._timeout_s)
        if "error" in header:
            reason = f"a slice failed: {header['error']}"
            if header.get("fatal"):
                worker.kill(reason)
            return Loss(reason, worker=False)
        return unpack_present(task, header, arrays)
