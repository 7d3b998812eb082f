"""What every executable shares: one clear line for bad input, honest exit codes."""

import sys
from collections.abc import Callable

from emoflow_ros.errors import InputError

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def run(command: Callable[[], int | None]) -> int:
    """Run a command and turn what went wrong into an exit code.

    Returns:
        The command's own code (None counts as 0), 2 for an InputError (its line goes to
        standard error), 130 for Ctrl-C. Anything else is a bug and keeps its traceback.
    """
    try:
        return command() or 0
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
