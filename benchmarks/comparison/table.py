"""The table of the comparison: our rows, what others have published, and how both are laid out."""

from collections.abc import Sequence
from dataclasses import dataclass

from emoflow_ros.evaluation.benchmark_sequences import PUBLISHED

SEQUENCES = (
    "indoor_flying1", "indoor_flying2", "indoor_flying3", "indoor_flying4",
    "outdoor_day1_segment", "outdoor_day2",
)  # fmt: skip
# EPE in px, dt = 4, as table 1 of arXiv 2510.12753 lists it; the last one is outdoor_day1.
PEERS = {
    "E-RAFT": (2.81, 5.09, 4.46, None, 0.72),
    "EV-MGRFlowNet": (1.50, 2.39, 2.06, None, 1.10),
    "MultiCM": (1.68, 2.49, 2.06, None, 1.25),
    "MultiCM-V2": (1.18, 1.87, 1.38, None, 1.05),
}
_HEADS = ("sequence", "method", "EPE, px", "Out, %", "w, deg/s", "v, deg", "s/window", "windows")


@dataclass(frozen=True)
class Row:
    """One line of the table; None where unknown.

    Attributes:
        sequence, method: which.
        epe_px, out_percent: mean over the windows with a flow.
        w_deg_s: error of w per window (root of the mean square over axes), then the mean.
        v_deg: median angle between the directions of translation, sign included.
        seconds: median per window.
        windows: how many have an estimate, of how many.
    """

    sequence: str
    method: str
    epe_px: float | None = None
    out_percent: float | None = None
    w_deg_s: float | None = None
    v_deg: float | None = None
    seconds: float | None = None
    windows: str = ""


def published(sequence: str) -> list[Row]:
    """What others have published for a sequence; the error of v is not comparable and left out."""
    rows = []
    if sequence in PUBLISHED:
        for name, figures in (
            ("E-MoFlow", PUBLISHED[sequence].figures),
            ("E-MoFlow, early stopping", PUBLISHED[sequence].early_stopping),
        ):
            if figures:
                time_ms = figures.get("runtime_p50_ms")
                rows.append(
                    Row(
                        sequence,
                        name,
                        figures["epe_px"],
                        w_deg_s=figures["paper_angular_rms_deg_s"],
                        seconds=None if time_ms is None else time_ms / 1000,
                    )
                )
    if sequence in SEQUENCES[:-1]:
        at = SEQUENCES.index(sequence)
        rows += [Row(sequence, name, epe[at]) for name, epe in PEERS.items() if epe[at]]
    return rows


def table(rows: Sequence[Row]) -> str:
    """Lay rows out in Markdown."""
    lines = ["| " + " | ".join(_HEADS) + " |", "|" + "---|" * len(_HEADS)]
    for row in rows:
        numbers = (
            (row.epe_px, ".2f"), (row.out_percent, ".1f"), (row.w_deg_s, ".1f"),
            (row.v_deg, ".1f"), (row.seconds, ".3g"),
        )  # fmt: skip
        cells = [format(value, form) if value is not None else "" for value, form in numbers]
        lines.append(f"| {row.sequence} | {row.method} | {' | '.join(cells)} | {row.windows} |")
    return "\n".join(lines)
