"""What a benchmark found beside its targets: rows, in its JSON file and for people."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Row:
    """One figure with its target.

    Attributes:
        figure: what it is, with its unit.
        result: None where it was not measured.
        at_most, at_least: its target, one of them; neither: it has none.
    """

    figure: str
    result: float | None
    at_most: float | None = None
    at_least: float | None = None

    @property
    def target(self) -> str:
        """The target, for people."""
        if self.at_least is not None:
            return f">= {number(self.at_least)}"
        return "" if self.at_most is None else f"<= {number(self.at_most)}"

    @property
    def verdict(self) -> str:
        """Whether the target is met; empty without one."""
        if self.at_least is not None:
            return verdict(None if self.result is None else -self.result, -self.at_least)
        return verdict(self.result, self.at_most)

    def as_dict(self) -> dict[str, Any]:
        """Return the row for a JSON file, verdict included."""
        return {**asdict(self), "verdict": self.verdict}

    @classmethod
    def from_dict(cls, saved: dict[str, Any]) -> "Row":
        """Read what `as_dict` returned."""
        return cls(**{name: value for name, value in saved.items() if name != "verdict"})


def verdict(value: float | None, at_most: float | None) -> str:
    """Compare a figure with its upper bound; empty without one."""
    if at_most is None:
        return ""
    if value is None:
        return "not measured"
    return "met" if value <= at_most else "missed"


def number(value: float | None) -> str:
    """Write a figure for people: whole numbers as such, others to three digits or more."""
    if value is None:
        return "-"
    if value == int(value):
        return str(int(value))
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def lay_out(rows: Sequence[Row]) -> str:
    """Lay rows out for people: figure, target, result, verdict."""
    width = max((len(row.figure) for row in rows), default=0) + 2
    lines = [f"{'figure':<{width}}{'target':>9}{'result':>10}"]
    lines += [
        f"{row.figure:<{width}}{row.target:>9}{number(row.result):>10}  {row.verdict}".rstrip()
        for row in rows
    ]
    return "\n".join(lines)
