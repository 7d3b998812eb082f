"""The installed commands, and what all of them share: one line for bad input, exit codes."""

import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable
from importlib import import_module
from types import FrameType
from typing import TextIO

from emoflow_ros.compiled_code import choose_folder
from emoflow_ros.errors import InputError

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
EXIT_NO_READER = 141  # as a shell reports SIGPIPE

# Bytes of address space: what is enough for all, and what nothing works with.
_ENOUGH, _LEAST = 2 * 2**30, 512 * 2**20

# ros2 launch passes on a Ctrl-C that the terminal has sent to everybody already.
_SAME_CTRL_C_S = 1.0


def run(command: Callable[[], int | None]) -> int:
    """Run a command and turn what went wrong into an exit code.

    Returns:
        The command's own code (None counts as 0), 2 for an InputError (its line goes to
        standard error), 130 for Ctrl-C, 141 where nobody reads the output any more, as after
        `| head`, 2 for want of memory, too. Anything else is a bug and keeps its traceback.
    """
    no_memory = _want_of_memory()
    if 0 <= resource.getrlimit(resource.RLIMIT_AS)[0] < _LEAST:  # below 0: none
        os.write(2, no_memory)  # libraries may try again for ever instead of failing
        return EXIT_BAD_INPUT
    try:
        _take_ctrl_c_once()
        return _run_and_flush(command)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        # Python's end puts the default action back, and a second Ctrl-C would kill the process.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        unread = [stream for stream in (sys.stdout, sys.stderr) if _has_lost_its_reader(stream)]
        if not unread:  # a pipe of the command's own
            raise
        for stream in unread:  # what is buffered would raise again at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return EXIT_NO_READER
    except (MemoryError, ImportError, OSError) as error:
        # Under a limit of the address space libraries cannot be loaded, and modules not imported.
        if not (isinstance(error, MemoryError) or b"ulimit" in no_memory):
            raise
        os.write(2, no_memory)
        return EXIT_BAD_INPUT


def _want_of_memory() -> bytes:
    """Say that there is too little memory, and why; made before, for then there may be none."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY or limit >= _ENOUGH:
        return b"error: memory: there is not enough; free some\n"
    return (
        f"error: memory: {limit >> 20} MiB of address space (ulimit -v) are not enough; remove the "
        f"limit, or raise it to {_ENOUGH >> 20} MiB\n"
    ).encode()


def _take_ctrl_c_once() -> None:
    """Let a second SIGINT soon after the first not interrupt what the first one started."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return  # ignored, as in background jobs, or somebody else's
    last = -_SAME_CTRL_C_S

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        if last - before >= _SAME_CTRL_C_S:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)


def _run_and_flush(command: Callable[[], int | None]) -> int:
    """Run a command; what it printed is written before Python's exit, which would complain."""
    try:
        code = command() or 0
    except SystemExit:  # argparse has printed its help
        print(end="", flush=True)
        raise
    print(end="", flush=True)
    return code


def _has_lost_its_reader(stream: TextIO | None) -> bool:
    """Tell whether a stream is a pipe (or socket) that is closed at its other end."""
    try:
        descriptor = stream.fileno() if stream else -1
    except (OSError, ValueError):  # not a file: replaced within Python, or closed
        return False
    if descriptor < 0:
        return False
    poll = select.poll()
    poll.register(descriptor, 0)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))


def _command(module: str) -> Callable[[], int]:
    """Make a command that imports its module late, so that Ctrl-C before is one line, too."""

    def command() -> int:
        choose_folder()
        code: int = import_module(f"emoflow_ros.{module}").main()
        return code

    def main() -> int:
        return run(command)

    return main


replay = _command("commands.replay")
evaluate = _command("commands.evaluate")
simulate = _command("commands.simulate")
info = _command("commands.info")
label = _command("commands.label")
