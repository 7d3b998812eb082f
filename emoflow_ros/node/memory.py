"""How much memory a process holds."""

import os
from pathlib import Path

_PAGE = os.sysconf("SC_PAGESIZE")


def resident_mb(pid: int) -> float:
    """Resident memory of a process in MiB, 0 if it is gone (Linux's proc(5), statm)."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text().split()[1]
    except (OSError, IndexError):
        return 0.0
    return int(pages) * _PAGE / 2**20
