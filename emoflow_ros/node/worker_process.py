"""The worker as its supervisor has it: a process, and a pipe to it."""

import contextlib
from collections.abc import Mapping
from multiprocessing.context import ForkServerContext
from typing import Any

from emoflow_ros.node.channel import Arrays, Channel
from emoflow_ros.node.worker import serve


class WorkerDiedError(Exception):
    """The worker ended, or was ended, before it answered."""


class WorkerProcess:
    """Starts a worker, which is used by one thread and may be killed by others.

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
        """End it at once; any thread may do that, at any time."""
        with contextlib.suppress(ValueError, OSError):
            self._process.kill()

    def end(self) -> None:
        """End it, and close its files now: the garbage collector would do that some day."""
        self.kill()
        self._channel.close()
        self._process.join(1.0)
        with contextlib.suppress(ValueError):  # it has not ended yet
            self._process.close()

    def _exit_reason(self) -> str:
        self._process.join(1.0)
        code = self._process.exitcode
        return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
