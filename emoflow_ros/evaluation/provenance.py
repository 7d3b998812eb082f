"""Where numbers come from: the recording, versions of the software, and the machine."""

import hashlib
import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import emoflow_ros

_HEAD = 1 << 20  # bytes
_LIBRARIES = ("numpy", "numba", "torch", "scipy", "h5py", "rosbags")


def versions() -> dict[str, str]:
    """Versions of this package, Python and the libraries that results depend on."""
    found = {"emoflow_ros": emoflow_ros.__version__, "Python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            continue
    return found


def fingerprint(path: Path) -> dict[str, Any]:
    """Identify a recording without reading all of it.

    Returns:
        Its name, its size in bytes, and the SHA-256 of names, sizes and first MiB of its files.
    """
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(path.parent)} {file.stat().st_size}\n".encode())
        with file.open("rb") as stream:
            digest.update(stream.read(_HEAD))
    size = sum(file.stat().st_size for file in files)
    return {"name": path.name, "bytes": size, "sha256_head": digest.hexdigest()}


def machine() -> dict[str, str]:
    """Processor, cores available to this process, memory and operating system."""
    return {
        "processor": _processor(),
        "cores": str(len(os.sched_getaffinity(0))),
        "memory": f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f} GiB",
        "system": platform.platform(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
