"""Functions with fast arithmetic have one machine code each, whatever was compiled before them.

They may round a product and a sum once or twice, and add in any order. So their bits depend on what
the compiler makes of them, and two things must not: numba compiles a function again within each
compiled one that calls it, and of these copies a process uses the one that it has loaded first; and
it compiles its power once in a process, with the flags of the function that needs it first.
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


def compiled_functions() -> set[Dispatcher]:
    """Every compiled function of `core`."""
    return {
        function
        for module in pkgutil.walk_packages(core.__path__, f"{core.__name__}.")
        for function in vars(importlib.import_module(module.name)).values()
        if isinstance(function, Dispatcher)
    }


def is_fast(function: Dispatcher) -> bool:
    return bool(function.targetoptions.get("fastmath"))


def syntax(function: Dispatcher) -> Iterator[ast.AST]:
    return ast.walk(ast.parse(dedent(inspect.getsource(function.py_func))))


def called(function: Dispatcher) -> Iterator[Dispatcher]:
    """The compiled functions that a function names, by themselves or in a module."""
    named = function.py_func.__globals__
    for node in syntax(function):
        found = None
        if isinstance(node, ast.Name):
            found = named.get(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found = getattr(named.get(node.value.id), node.attr, None)
        if isinstance(found, Dispatcher):
            yield found


def test_a_fast_function_is_part_of_each_compiled_one_that_calls_it() -> None:
    calls = [(one, other) for one in compiled_functions() for other in called(one)]
    apart = {
        f"{one.__module__}.{one.__name__} calls {other.__name__}"
        for one, other in calls
        if is_fast(other) and other.targetoptions.get("inline") != "always"
    }
    assert len(calls) > 60 and apart == set()


def test_every_function_states_its_arithmetic() -> None:
    """Else numba gives it that of the caller that it is first compiled for."""
    functions = compiled_functions()
    assert {f.__name__ for f in functions if "fastmath" not in f.targetoptions} == set()


def test_no_power_in_fast_functions() -> None:
    functions = [
        function
        for function in compiled_functions()
        if is_fast(function) or function.targetoptions.get("inline") == "always"
    ]
    powers = {
        f"{function.__module__}.{function.__name__}"
        for function in functions
        for node in syntax(function)
        if isinstance(node, ast.Pow)
    }
    assert len(functions) > 30 and powers == set()


def test_numba_shares_its_power() -> None:
    """Why there is none: should this fail with another numba, the rule may go."""
    first, after = (
        subprocess.run(
            [sys.executable, "-c", SHARED_POWER, order], capture_output=True, text=True, check=True
        ).stdout
        for order in ("fast first", "exact first")
    )
    assert first.count("fmul contract double") == 2 and after.count("fmul contract double") == 1
