"""Bags whose recorder was stopped before it wrote the index: read as if it had just done so.

What is whole is found by walking over the records, and an index of it is put behind them, in
memory: the file itself stays as it is.
"""

import sqlite3
from pathlib import Path
from shutil import copyfile

from emoflow_ros.offline.readers.unfinished_mcap import finish_mcap
from emoflow_ros.offline.readers.unfinished_ros1 import finish_ros1

_JOURNALS = ("-wal", "-journal")
_FINISH = {".bag": finish_ros1, ".mcap": finish_mcap}


def finished(file: Path, folder: Path) -> Path | None:
    """Make an unfinished storage file readable.

    Args:
        file: a .bag, .mcap or .db3 file.
        folder: for the copy of a database, which its journal is worked into.

    Returns:
        What to read in its place; None where it was finished or holds nothing that is whole.
    """
    if file.suffix == ".db3":
        return _finished_database(file, folder)
    finish = _FINISH.get(file.suffix)
    if finish is None or not file.is_file():
        return None
    try:
        with file.open("rb") as stream:
            return finish(file, stream)
    except Exception:  # damaged in other ways, as any of the libraries may say
        return None


def _finished_database(file: Path, folder: Path) -> Path | None:
    journals = [Path(f"{file}{suffix}") for suffix in _JOURNALS]
    there = [j for j in journals if j.is_file() and j.stat().st_size]
    if not there:
        return None
    for source in (file, *there):
        copyfile(source, folder / source.name)
    try:
        database = sqlite3.connect(folder / file.name)
        database.execute("PRAGMA journal_mode=DELETE").fetchall()
        database.close()
    except sqlite3.Error:
        return None
    return folder / file.name
