"""The folder in which numba keeps the package's compiled code from one start to the next.

Below it each version of the sources has a folder of its own; see `core.numerics.jit`.
Numba is not imported here: the choice must be made before.
"""

import os
import stat
import sys
import tempfile
from pathlib import Path

from emoflow_ros.errors import InputError

VARIABLE = "NUMBA_CACHE_DIR"

# Numba keeps code beside each source; most of it, as much as counts here, is the lattice's.
_BESIDE_THE_SOURCES = Path(__file__).parent / "core" / "lattice" / "__pycache__"
_ROOM = 32 * 2**20  # bytes: more than all of the compiled code
_FIX = f"set {VARIABLE} to a folder that can be written and has {_ROOM >> 20} MiB"


def folder() -> Path:
    """Return the folder in use."""
    return Path(os.environ.get(VARIABLE) or _BESIDE_THE_SOURCES)


def choose_folder() -> None:
    """Choose the first folder that can be written: for this process and those that it starts.

    That is the one of the environment variable NUMBA_CACHE_DIR, or the folder of the sources, then
    one in the user's cache, then one in the folder of temporary files. Any but the first is named
    in a line on standard error.

    Raises:
        InputError: none of them can be written.
    """
    refused: list[str] = []
    for find in (folder, _of_the_user, _temporary):
        try:
            found = find()
            _require_room(found)
        except (OSError, RuntimeError) as error:
            refused.append(_reason(error))
            continue
        if refused:
            os.environ[VARIABLE] = str(found)
            line = f"compiled code is kept in {found}, because of {'; '.join(refused)}"
            print(line, file=sys.stderr, flush=True)
        return
    raise InputError("compiled code", f"no folder to keep it in ({'; '.join(refused)})", _FIX)


def not_kept(error: OSError) -> InputError:
    """Say that compiled code could not be written, as when a disk is full by now, and where."""
    wrong = f"it cannot be kept in {folder()} ({_reason(error)})"
    return InputError("compiled code", wrong, f"make room there, or {_FIX}")


def _of_the_user() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "emoflow_ros"


def _temporary() -> Path:
    """Return a folder that nobody else can write: what is found there is executed."""
    path = Path(tempfile.gettempdir()) / f"emoflow_ros_{os.getuid()}"
    path.mkdir(mode=0o700, exist_ok=True)
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise PermissionError(0, "others can write it", str(path))
    return path


def _require_room(path: Path) -> None:
    """Write to the folder and take that away again; one that holds compiled code may be full.

    Raises:
        OSError: that is not possible; with the folder's name.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path) as probe:
            if next(path.rglob("*.nbi"), None) is None:
                os.posix_fallocate(probe.fileno(), 0, _ROOM)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _reason(error: OSError | RuntimeError) -> str:
    if not isinstance(error, OSError):
        return str(error)
    why = (error.strerror or str(error)).lower()
    return f"{error.filename}: {why}" if error.filename else why
