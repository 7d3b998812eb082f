"""Run a command several times for the price of one start of Python and one import.

    python repeated.py MODULE:FUNCTION < list of argument lists, JSON

The exit code and the output of each time are written, in order, as a JSON list of pairs.
"""

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path


def results(command: str, argument_lists: Sequence[Sequence[str]]) -> list[tuple[int, list[str]]]:
    """Return the exit codes and the lines of standard output and error.

    Args:
        command: `module:function`, which returns the exit code.
        argument_lists: what the command is given, each time.
    """
    ran = subprocess.run(
        [sys.executable, __file__, command],
        input=json.dumps(argument_lists),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [(code, text.splitlines()) for code, text in json.loads(ran.stdout)]


def _result(main: Callable[[], int], arguments: Sequence[str]) -> tuple[int, str]:
    sys.argv[1:] = arguments
    kept = [os.dup(stream) for stream in (1, 2)]
    with tempfile.TemporaryFile() as output:
        for stream in (1, 2):
            os.dup2(output.fileno(), stream)
        try:
            code = main()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for stream, before in zip((1, 2), kept, strict=True):
                os.dup2(before, stream)
                os.close(before)
        output.seek(0)
        return code, output.read().decode()


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))
    module, _, function = sys.argv[1].partition(":")
    main = getattr(importlib.import_module(module), function)
    print(json.dumps([_result(main, arguments) for arguments in json.load(sys.stdin)]))
