"""The one way to compile a function: numba's njit, with a cache that notices every change.

Numba's own cache looks at the file of a function. What the function calls, inlines or reads from
other files is compiled into it, so that it would keep their old versions. Here compiled code lies
in a folder whose name is a hash of all sources that may be in it, below the one that numba
chooses; folders of other versions are removed. Numba writes its index before the code. In a folder
that two versions share, a disk that fills up between the two would leave an index of the new one
with code of the old one. Nor does numba expect two processes to keep versions of one function for
other arguments at once: either would number its file alike. Therefore one waits for the other.
"""

import fcntl
import shutil
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

_PREFIX = "emoflow_ros-"
_LOCK = "lock"
_CORE = Path(__file__).parents[1]


# Takes what `numba.njit` takes, with parentheses always. A compiled function may call functions and
# read constants of `core` and of its own part of the package only: a folder directly in
# `emoflow_ros`, or `msg_adapters`.
# That arithmetic is not fast is said: else a function has that of the caller that it is first
# compiled for.
njit = partial(numba.njit, cache=True, fastmath=False)

# The same for loops whose sums may be taken in any order; NaN and infinity stay what they are.
# Where a compiled function calls such a one it is inlined (inline="always"): else numba compiles it
# again within each caller, rounded in another way, and which copy runs depends on what was compiled
# and loaded before. Nor has it a power, but x * x: numba compiles that once in a process, with the
# flags of the function that needs it first.
fast = partial(njit, fastmath={"reassoc", "contract", "arcp", "nsz"}, nogil=True)


@cache
def _version(part: Path) -> str:
    """Return the hash of all sources of a part of the package and of `core`.

    They are read once in a process, when the first function of the part is decorated.
    """
    folders = dict.fromkeys((_CORE, part))
    return sha256("".join(map(_hash, folders)).encode()).hexdigest()[:16]


@cache
def _hash(folder: Path) -> str:
    found = sha256()
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        found.update(f"{path.relative_to(folder)}:{len(content)}:".encode())
        found.update(content)
    return found.hexdigest()


class _Locator(caching._CacheLocator):
    """Tells numba where the code of one of our functions is: a folder in the one that it chose."""

    def __init__(self, chosen: caching._CacheLocator, file: str, version: str) -> None:
        self._chosen = chosen
        self._py_file = file  # numba's warnings name it
        self._folder = Path(chosen.get_cache_path()) / (_PREFIX + version)

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "_Locator | None":
        """Return a locator, or none for functions of others or without a folder for any."""
        module = function.__module__.split(".")
        if module[0] not in ("emoflow_ros", "msg_adapters"):
            return None
        found = (locator.from_function(function, file) for locator in _NUMBAS)
        chosen = next(filter(None, found), None)
        if chosen is None:
            return None
        below = len(module) - (2 if module[0] == "emoflow_ros" else 1)  # its part of the package
        self = cls(chosen, file, _version(Path(file).parents[max(0, below - 1)]))
        _remove_others(self._folder)
        return self

    def get_cache_path(self) -> str:
        """Return the folder of the function's code."""
        return str(self._folder)

    def get_source_stamp(self) -> Any:
        """Return numba's hash of the function's file."""
        return self._chosen.get_source_stamp()

    def get_disambiguator(self) -> str:
        """Return what tells apart functions of the same name in one file."""
        return str(self._chosen.get_disambiguator())


@cache
def _remove_others(folder: Path) -> None:
    """Remove what other versions of the same sources have left, once in a process."""
    with suppress(OSError):  # not there yet, or not ours to change
        for path in folder.parent.iterdir():
            if path.name.startswith(_PREFIX) and path != folder:
                shutil.rmtree(path, ignore_errors=True)
            elif path.suffix in (".nbi", ".nbc"):  # of versions before there were folders
                path.unlink()


class _CacheFile(caching.IndexDataCacheFile):
    """Keeps one version of a function after the other, whichever process it is from."""

    def save(self, key: Any, data: Any) -> None:
        """Save a new cache entry, as numba does, while no other process does."""
        with (Path(self._cache_path) / _LOCK).open("a") as lock:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX)
            super().save(key, data)


caching.IndexDataCacheFile = _CacheFile  # type: ignore[misc]

# Numba asks one after another.
_locators: list[Any] = caching.CacheImpl._locator_classes
_NUMBAS = tuple(_locators)
_locators.insert(0, _Locator)
