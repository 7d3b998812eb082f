"""What goes wrong or is assumed: the one exception for bad input, notes, tracebacks of the rest."""

import os
import sys
import time
import traceback
from functools import cache
from pathlib import Path

_TRACEBACKS = "emoflow_ros_tracebacks.log"
_MOST_BYTES = 1 << 20


class InputError(Exception):
    """Input that cannot be used.

    Args:
        where: the file, topic or parameter at fault.
        wrong: what is wrong with it.
        fix: what the user can do.
    """

    def __init__(self, where: object, wrong: str, fix: str) -> None:
        super().__init__(f"{where}: {wrong}; {fix}")
        self.where, self.wrong, self.fix = str(where), wrong, fix

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str]]:
        """Let it cross from one process to another."""
        return type(self), (self.where, self.wrong, self.fix)


@cache
def say(where: object, what: str) -> None:
    """Say on standard error, once per process, what was assumed of an input or left out of it."""
    print(f"{where}: {what}", file=sys.stderr)


def keep_traceback(error: BaseException) -> str:
    """Write down where an exception came from, behind those before.

    The file is `emoflow_ros_tracebacks.log` in ROS's folder of logs (ROS_LOG_DIR, ROS_HOME/log or
    ~/.ros/log); one that has grown beyond 1 MiB is begun anew.

    Returns:
        `; traceback in FILE` for the line that reports the error; empty where nothing could be
        written.
    """
    home = os.environ.get("ROS_HOME") or Path.home() / ".ros"
    path = Path(os.environ.get("ROS_LOG_DIR") or Path(home) / "log") / _TRACEBACKS
    text = "".join(traceback.format_exception(error))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        is_full = path.exists() and path.stat().st_size > _MOST_BYTES
        with path.open("w" if is_full else "a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} process {os.getpid()}\n{text}\n")
    except OSError:
        return ""
    return f"; traceback in {path}"
