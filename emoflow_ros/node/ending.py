"""SIGINT and SIGTERM, from before the imports, which take seconds, to the last line of the node."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing import resource_tracker
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_GRACE_S = 5.0


class Ending:
    """Takes the signals that end the process, from when it is made; make one, in the main thread.

    They are blocked in all threads and taken by one of its own, so that none interrupts an import
    or an end in order. Processes that are started inherit the block: they end with this one.

    The first signal is said in one line. It ends the process at once, with code 0, until
    `imported` is called, and afterwards calls what `in_order` was given; where the process is
    still there after 5 s, its children are killed and it ends. Further signals change nothing.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._importing = True
        self._asked = False
        self._end: Callable[[], None] | None = None
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        self._thread = threading.Thread(target=self._take, name="signals", daemon=True)
        self._thread.start()
        for number in _SIGNALS:
            signal.signal(number, self._pass_on)
        # multiprocessing unblocks both in the thread that starts this one: a worker would have
        # them, too.
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)

    def imported(self) -> None:
        """End in order from now on."""
        with self._lock:
            self._importing = False

    def in_order(self, end: Callable[[], None]) -> None:
        """Let `end` be called, once: by a signal in the thread of signals, or now after one."""
        with self._lock:
            self._end = end
            if self._asked:
                end()

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        """Give a signal of a thread that has unblocked it to the thread that takes it."""
        assert self._thread.ident is not None
        signal.pthread_kill(self._thread.ident, number)

    def _take(self) -> None:
        name = signal.Signals(signal.sigwait(_SIGNALS)).name
        print(f"{name}: the node ends", file=sys.stderr, flush=True)
        with self._lock:
            if self._importing:
                os._exit(0)
            self._asked = True
            if self._end is not None:
                self._end()
        time.sleep(_GRACE_S)
        for child in multiprocessing.active_children():
            child.kill()
        os._exit(0)
