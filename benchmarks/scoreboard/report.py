"""The run as pages."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.scoreboard.run import Outcome


def write_report(folder: Path, outcomes: Sequence[Outcome], document: Mapping[str, Any]) -> Path:
    """Write report.html."""
    return folder / "report.html"
