"""Arrays and a stand-in for njit that let no kernel index out of bounds unseen."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np


class CheckedArray(np.ndarray):
    """A one-dimensional array that takes single indices from 0 to N - 1 only.

    NumPy reads negative ones from the end, where compiled code would read out of bounds or, as
    numba wraps them too, another element than was meant.
    """

    def __getitem__(self, index: int) -> Any:
        return super().__getitem__(self._inside(index))

    def __setitem__(self, index: int, value: Any) -> None:
        super().__setitem__(self._inside(index), value)

    def _inside(self, index: int) -> int:
        if not 0 <= index < len(self):
            raise IndexError(f"index {index} of {len(self)} elements")
        return index


def checked_njit(*_: Any, **__: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Take the place of `njit(signature, ...)`: run uncompiled, on checked arrays."""

    def decorate(kernel: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(kernel)
        def run(*arguments: Any) -> Any:
            return kernel(*(_checked(argument) for argument in arguments))

        return run

    return decorate


def _checked(argument: Any) -> Any:
    return argument.view(CheckedArray) if isinstance(argument, np.ndarray) else argument
