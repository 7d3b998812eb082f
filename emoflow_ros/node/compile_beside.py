"""The memory of positions is compiled in a process of its own, while the worker compiles the rest.

Numba compiles on one core, and keeps on disk what it has compiled. What one of the two processes
has compiled, the other one loads. `python -m emoflow_ros.node.compile_beside` is that process; it
ends early when its standard input is closed.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

from emoflow_ros.node.warm_up import warm_up_memory

_END_S = 5.0


@contextmanager
def compiled_beside() -> Iterator[Callable[[], None]]:
    """Yield what starts the process, if there is a core for it; it ends with the context.

    It ends with this process, too, however that ends: the kernel closes its input then. Where it
    cannot be started, or fails, this process compiles everything itself.
    """
    with ExitStack() as running:

        def start() -> None:
            if len(os.sched_getaffinity(0)) < 2:
                return
            with suppress(OSError):
                running.callback(_end, _started())

        yield start


def _started() -> subprocess.Popen[bytes]:
    path = os.pathsep.join(filter(None, sys.path))  # as multiprocessing hands it on
    return subprocess.Popen(
        [sys.executable, "-P", "-m", __name__],  # not from the current folder
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": path},
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    process.stdin.close()
    process.kill()  # what it is at is compiled here by now
    with suppress(subprocess.TimeoutExpired):
        process.wait(_END_S)


def _end_with_input() -> None:
    os.read(sys.stdin.fileno(), 1)  # not by Python's buffer, whose lock the interpreter's end needs
    os._exit(0)  # numba renames a file when it is whole


if __name__ == "__main__":
    threading.Thread(target=_end_with_input, daemon=True).start()
    warm_up_memory()
