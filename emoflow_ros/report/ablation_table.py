"""An ablation as a table of text."""

from emoflow_ros.evaluation.ablation import Ablation
from emoflow_ros.report.documents import format_number


def table_of(ablation: Ablation) -> str:
    """Lay the rows out as text, for the terminal."""
    heads = ("EPE px", "out %", "RMS w deg/s", "v deg", "s/window")
    lines = [f"{'ablation: ' + ablation.name:<36}" + "".join(f"{head:>13}" for head in heads)]
    for row in ablation.rows:
        values = (
            format_number(row.epe_px),
            format_number(row.out_percent),
            format_number(row.angular_rms_deg_s),
            format_number(row.direction_error_deg, 1),
            format_number(row.seconds_per_window, 3),
        )
        lines.append(f"  {row.name:<34}" + "".join(f"{value:>13}" for value in values))
    return "\n".join(lines)
