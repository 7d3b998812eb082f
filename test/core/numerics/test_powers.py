"""No power stands in functions that are compiled with fast arithmetic.

Numba compiles its power once in a process, with the flags of whichever function needs it first. In
others it keeps them: whether a product and a sum are rounded once or twice would depend on what was
compiled before, and the bits of an estimate on how the cache was filled.
"""

import ast
import importlib
import inspect
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from textwrap import dedent

from numba.core.dispatcher import Dispatcher

from emoflow_ros import core

SHARED_POWER = """
import sys
import numba

@numba.njit
def exact(x):
    return x**2

@numba.njit(fastmath={"contract"})
def fast(x, y):
    return (x * y) ** 2 + y

if sys.argv[1] == "exact first":
    exact(2.0)
fast(1.5, 2.0)
print(*(line for line in fast.inspect_llvm(fast.signatures[0]).splitlines() if " = fmul " in line))
"""


def fast_functions() -> Iterator[Dispatcher]:
    """Every function of `core` that is compiled with fast arithmetic, once."""
    found = {
        function
        for module in pkgutil.walk_packages(core.__path__, f"{core.__name__}.")
        for function in vars(importlib.import_module(module.name)).values()
        if isinstance(function, Dispatcher) and function.targetoptions.get("fastmath")
    }
    yield from found


def test_no_power_in_fast_functions() -> None:
    functions = list(fast_functions())
    powers = {
        f"{function.__module__}.{function.__name__}"
        for function in functions
        for node in ast.walk(ast.parse(dedent(inspect.getsource(function.py_func))))
        if isinstance(node, ast.Pow)
    }
    assert len(functions) > 40 and powers == set()


def test_numba_shares_its_power() -> None:
    """Why: should this fail with another numba, the rule may go."""
    first, after = (
        subprocess.run(
            [sys.executable, "-c", SHARED_POWER, order], capture_output=True, text=True, check=True
        ).stdout
        for order in ("fast first", "exact first")
    )
    assert first.count("fmul contract double") == 2 and after.count("fmul contract double") == 1
