"""What a script of faults measures of a node: time until it is right again, and memory."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

RIGHT_AGAIN_S = 0.5  # target, from the end of a fault to the first twist of later events


@dataclass(frozen=True)
class Use:
    """What the node holds at a moment.

    Attributes:
        threads, files: of the node.
        below: processes.
        segments: of shared memory.
        node_mb, worker_mb: resident memory.
    """

    threads: int
    files: int
    below: int
    segments: int
    node_mb: float
    worker_mb: float


@dataclass
class Figures:
    """Figures of one run.

    Attributes:
        right_again: seconds after each fault, by its name.
        uses: at every account.
    """

    right_again: defaultdict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    uses: list[Use] = field(default_factory=list)

    def quarters(self, name: str) -> tuple[float, float]:
        """Medians of a number of `Use` over the first and the last quarter of the run."""
        values = [float(getattr(use, name)) for use in self.uses]
        quarter = -(-len(values) // 4)
        return float(np.median(values[:quarter])), float(np.median(values[-quarter:]))

    def table(self, seconds: float, load: float, windows: Mapping[str, int]) -> str:
        """Lay the figures out as they stand in docs/operations.md.

        Args:
            seconds: length of the run.
            load: load average of the machine; above its cores times wait for other processes.
            windows: how many there were, by what became of them.
        """
        fates = ", ".join(f"{count} {name}" for name, count in windows.items() if count)
        lines = [
            f"{seconds:.0f} s, load {load:.1f}; {sum(windows.values())} windows, each accounted "
            f"for once: {fates}.",
            "",
            f"| fault | times | right again after, ms: median, 95 %, longest | over "
            f"{1e3 * RIGHT_AGAIN_S:.0f} ms |",
            "|---|---|---|---|",
        ]
        everything = [s for found in self.right_again.values() for s in found]
        for name, found in [*sorted(self.right_again.items()), ("all", everything)]:
            lines.append(_row(name.replace("_", " "), found))
        lines += ["", "| memory, MB | first quarter | last quarter | most |", "|---|---|---|---|"]
        for part in ("node", "worker"):
            first, last = self.quarters(f"{part}_mb")
            most = max(getattr(use, f"{part}_mb") for use in self.uses)
            lines.append(f"| {part} | {first:.0f} | {last:.0f} | {most:.0f} |")
        return "\n".join(lines)


def _row(name: str, found: Sequence[float]) -> str:
    median, most, longest = 1e3 * np.percentile(found, [50, 95, 100])
    late = sum(s > RIGHT_AGAIN_S for s in found)
    return f"| {name} | {len(found)} | {median:.0f}, {most:.0f}, {longest:.0f} | {late} |"
