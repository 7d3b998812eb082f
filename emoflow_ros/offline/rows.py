"""The table of windows: one flat row each, for report.json and windows.csv."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.offline.columns import quality_values
from emoflow_ros.offline.document import without_nan
from emoflow_ros.offline.results import Vector, WindowResult
from emoflow_ros.truth import TrueTwist


def window_row(window: WindowResult) -> dict[str, Any]:
    """One window as flat values with their units in the names; None where unknown.

    The record of its quality has the names and meanings that it has in `estimates.h5`.
    The second and further sources of true velocity have columns `truth2_*` and so on.
    """
    flow, static, tracks = window.flow, window.static_flow, window.tracks
    row: dict[str, Any] = {
        "index": window.index,
        "t_start_s": window.t_start / NS_PER_S,
        "t_end_s": window.t_end / NS_PER_S,
        "status": window.status,
        "model": window.model,
        **_axes("angular_{}_rad_s", window.angular),
        **_axes("linear_{}", window.linear),
        **_axes("sigma_linear_{}", window.sigma[:3]),
        **_axes("sigma_angular_{}_rad_s", window.sigma[3:]),
        **_true_velocity("true", window.truth),
    }
    for number, truth in enumerate(window.other_truths, start=2):
        row |= _true_velocity(f"truth{number}", truth)
    row |= {
        "angular_error_deg_s": float(np.degrees(np.linalg.norm(window.angular_error))),
        "axis_error_deg": window.axis_error_deg,
        "rate_ratio": window.rate_ratio,
        "direction_error_deg": window.direction_error_deg,
        "epe_px": flow and flow.epe_px,
        "static_epe_px": static and static.epe_px,
        "pe1_percent": flow and flow.pe1,
        "pe2_percent": flow and flow.pe2,
        "out_percent": flow and flow.pe3,
        "ae_deg": flow and flow.ae_deg,
        "true_displacement_px": flow and flow.truth_px,
        "compared_pixels": flow and flow.pixels,
        "track_error_px": tracks and tracks.end_px,
        "track_true_px": tracks and tracks.true_px,
        "track_age_s": tracks and tracks.age_s,
        "compared_tracks": tracks and tracks.points,
        **quality_values(window.quality, window.events, window.translation_observable),
        "gyro": window.gyro,
        "note": window.note,
    }
    return {name: without_nan(value) for name, value in row.items()}


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of equal columns, at least one, with a head line."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, fieldnames=list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def _true_velocity(source: str, truth: TrueTwist | None) -> dict[str, float]:
    nothing = np.full(3, np.nan)
    angular = nothing if truth is None else truth.angular
    linear = nothing if truth is None or truth.linear is None else truth.linear
    return _axes(source + "_angular_{}_rad_s", angular) | _axes(source + "_linear_{}_m_s", linear)


def _axes(name: str, values: Vector) -> dict[str, float]:
    return {name.format(axis): float(v) for axis, v in zip("xyz", values, strict=True)}
