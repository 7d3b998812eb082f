"""A diagnosis, of the node or of a window, and how bad it is."""

from dataclasses import dataclass
from enum import IntEnum


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Report:
    """One diagnosis: how bad, why and what to do, and the numbers behind it."""

    level: Level
    message: str
    values: dict[str, str]
