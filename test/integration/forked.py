"""Run a command several times for the price of one import.

    python forked.py MODULE:FUNCTION [MODULE...] < list of argument lists, JSON

The modules are imported once. Each list of arguments then has a process of its own, forked, whose
exit code and output are written, in order, as a JSON list of pairs.
"""

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path


def results(
    command: str, argument_lists: Sequence[Sequence[str]], *late: str
) -> list[tuple[int, list[str]]]:
    """Return the exit codes and the lines of standard output and error.

    Args:
        command: `module:function`, which returns the exit code.
        argument_lists: what the command is given, each time.
        *late: modules that the function imports.
    """
    ran = subprocess.run(
        [sys.executable, __file__, command, *late],
        input=json.dumps(argument_lists),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [(code, text.splitlines()) for code, text in json.loads(ran.stdout)]


def _result(main: Callable[[], int], arguments: Sequence[str]) -> tuple[int, str]:
    with tempfile.TemporaryFile() as output:
        child = os.fork()
        if child == 0:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
            sys.argv[1:] = arguments
            sys.exit(main())
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        output.seek(0)
        return code, output.read().decode()


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))
    module, _, function = sys.argv[1].partition(":")
    for late in sys.argv[2:]:
        importlib.import_module(late)
    main = getattr(importlib.import_module(module), function)
    print(json.dumps([_result(main, arguments) for arguments in json.load(sys.stdin)]))
