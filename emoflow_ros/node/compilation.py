"""Compilation, watched or refused: what a worker says at the first start. It imports numba."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core import event

from emoflow_ros import compiled_code

_REPORT_S = 5.0


class Compilation(event.Listener):
    """Counts the functions that are compiled, and not found on disk.

    Args:
        tell: gets a line when the first one begins, and every few seconds then.
        begin: is called when the first one begins.
        clock: monotonic time in s.

    Attributes:
        count: functions so far.
    """

    def __init__(
        self,
        tell: Callable[[str], None],
        begin: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.count = 0
        self._tell = tell
        self._begin = begin
        self._clock = clock
        self._began: float | None = None
        self._told = 0.0

    def on_start(self, event: event.Event) -> None:
        """Note that a function is compiled now."""
        if self._began is None:
            self._began = self._told = self._clock()
            self._tell(
                "the estimator is compiled, as at the first start on a machine: it takes about a "
                f"minute, and is kept in {compiled_code.folder()}"
            )
            self._begin()

    def on_end(self, event: event.Event) -> None:
        """Note that a function is compiled."""
        self.count += 1
        if self._clock() - self._told >= _REPORT_S:
            self._told = self._clock()
            self._tell(f"the estimator is compiled: {self._so_far()}")

    def end(self) -> None:
        """Say what it took, if anything was compiled."""
        if self.count:
            self._tell(f"the estimator is compiled now: {self._so_far()}")

    def _so_far(self) -> str:
        assert self._began is not None
        return f"{self.count} functions in {self._clock() - self._began:.0f} s"


@contextmanager
def watched(tell: Callable[[str], None], begin: Callable[[], None]) -> Iterator[Compilation]:
    """Watch what is compiled within the context; arguments as of `Compilation`."""
    with event.install_listener("numba:compile", Compilation(tell, begin)) as compilation:
        yield compilation
        compilation.end()


class CompilationRefusedError(Exception):
    """Something would have to be compiled."""


class _Refusal(event.Listener):
    def on_start(self, event: event.Event) -> None:
        raise CompilationRefusedError

    def on_end(self, event: event.Event) -> None:
        pass


@contextmanager
def refused() -> Iterator[None]:
    """Let nothing be compiled within the context; what is found on disk is loaded.

    Raises:
        CompilationRefusedError: from within, before anything is compiled.
    """
    with event.install_listener("numba:compile", _Refusal()):
        yield
