"""Cholesky factors of band matrices, and solutions, by LAPACK, while other threads can run.

SciPy's own functions for it keep the interpreter's lock, and a window is fitted in two threads.
These are the same routines, from the table of pointers that SciPy has for Cython.
"""

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cython_lapack

Array = NDArray[np.float64]

_INT = ctypes.POINTER(ctypes.c_int)
_CHAR, _ARRAY = ctypes.c_char_p, ctypes.c_void_p


class NotPositiveDefiniteError(np.linalg.LinAlgError):
    """The normal equations have no unique minimum: the fit has diverged."""


def _routine(name: str, *arguments: Any) -> Any:
    """Look a routine of LAPACK up by name; a call of it releases the interpreter's lock."""
    capsule = cython_lapack.__pyx_capi__[name]
    of_name = ctypes.pythonapi.PyCapsule_GetName
    of_name.restype, of_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    of_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    of_pointer.restype = ctypes.c_void_p
    of_pointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return ctypes.CFUNCTYPE(None, *arguments)(of_pointer(capsule, of_name(capsule)))


_dpbsv = _routine("dpbsv", _CHAR, _INT, _INT, _INT, _ARRAY, _INT, _ARRAY, _INT, _INT)
_dpbtrf = _routine("dpbtrf", _CHAR, _INT, _INT, _ARRAY, _INT, _INT)
_dtbtrs = _routine(
    "dtbtrs", _CHAR, _CHAR, _CHAR, _INT, _INT, _INT, _ARRAY, _INT, _ARRAY, _INT, _INT
)


def solve_banded(band: Array, right: Array) -> Array:
    """Solve A x = b, in one call.

    Args:
        band: of A, as BandFactor takes it; not changed.
        right: (n,) b, not changed.

    Raises:
        NotPositiveDefiniteError: there is none.
    """
    assert band.dtype == np.float64 and band.flags.c_contiguous
    assert right.shape == (len(band),) and right.dtype == np.float64
    factor, result = band.copy(), right.copy()
    size, rows = band.shape
    info = ctypes.c_int()
    _dpbsv(
        b"L", *_ints(size, rows - 1, 1), factor.ctypes.data, *_ints(rows), result.ctypes.data,
        *_ints(size), info,
    )  # fmt: skip
    if info.value != 0:
        raise NotPositiveDefiniteError
    return result


class BandFactor:
    """The Cholesky factor L of a symmetric positive definite band matrix L L^T.

    Args:
        band: (n, width + 1) float64, C-contiguous, lower band storage: band[j, i - j] is entry
            (i, j). It is not changed.

    Raises:
        NotPositiveDefiniteError: there is none.
    """

    def __init__(self, band: Array) -> None:
        assert band.dtype == np.float64 and band.flags.c_contiguous
        self._factor = band.copy()
        size, rows = band.shape
        info = ctypes.c_int()
        _dpbtrf(b"L", *_ints(size, rows - 1), self._factor.ctypes.data, *_ints(rows), info)
        if info.value != 0:
            raise NotPositiveDefiniteError

    def forward(self, right: Array) -> None:
        """Replace b by the solution of L x = b, for each column of `right` (n, k), in place.

        Args:
            right: float64, Fortran-contiguous.
        """
        self._solve(b"N", right)

    def backward(self, right: Array) -> None:
        """Replace b by the solution of L^T x = b, as `forward`."""
        self._solve(b"T", right)

    def _solve(self, transposed: bytes, right: Array) -> None:
        size, rows = self._factor.shape
        assert right.shape[0] == size and right.dtype == np.float64 and right.flags.f_contiguous
        columns = right.shape[1]
        info = ctypes.c_int()
        _dtbtrs(
            b"L", transposed, b"N", *_ints(size, rows - 1, columns), self._factor.ctypes.data,
            *_ints(rows), right.ctypes.data, *_ints(size), info,
        )  # fmt: skip
        if info.value != 0:
            raise NotPositiveDefiniteError


def _ints(*values: int) -> list[ctypes.c_int]:
    return [ctypes.c_int(value) for value in values]
