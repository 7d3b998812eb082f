"""Write an evaluation's results: report.json, windows.csv and one self-contained report.html."""

import csv
import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.offline import figures
from emoflow_ros.offline.ablation import Ablation
from emoflow_ros.offline.document import without_nan, write_json
from emoflow_ros.offline.evaluation import Evaluation
from emoflow_ros.offline.html import png_uri, render, svg_uri
from emoflow_ros.offline.panels import window_panels
from emoflow_ros.offline.provenance import machine, versions
from emoflow_ros.offline.results import MIN_TRUE_RATE, MIN_TRUE_SPEED, WindowResult
from emoflow_ros.offline.summary import Measure, summarise
from emoflow_ros.offline.track_panels import track_panels

_TEMPLATE = "report.html.j2"
_MAX_TABLE_ROWS = 400

DEFINITIONS = (
    "Flow errors compare the displacement over the window at pixels that hold an event of the "
    "window and whose truth is finite with |u| > 0 and |v| > 0; they are averaged over the "
    "pixels of a window first and over windows second.",
    "Angular flow error is the angle between (u, v, 1) and the true (u, v, 1), in pixels over "
    "the window.",
    "Tracks are carried from window to window until they leave the image; their error is the "
    "distance from the true position at a window's end, which was carried along the true flow "
    "from the same start.",
    "RMS is the root of the mean square over windows and the three axes.",
    f"The axis of ω is compared where the true |ω| exceeds {np.degrees(MIN_TRUE_RATE):.0f} deg/s, "
    f"the direction of v where the true speed exceeds {MIN_TRUE_SPEED} m/s. The direction error "
    "keeps the sign: opposite directions are 180 degrees apart. Nothing is taken from the truth.",
    "Oracle figures take the scale of v, or its scale and sign, from the truth; they are no "
    "property of the estimate, and only serve comparison with tables that do the same.",
    "Intervals are 95 % percentile bootstrap intervals over windows.",
)


def write_report(
    run: Evaluation,
    configuration: Mapping[str, Any],
    folder: Path,
    ablation: Ablation | None = None,
) -> tuple[Path, Path]:
    """Write report.json, windows.csv and report.html into an existing folder.

    Args:
        run: with at least one window.
        configuration: option values by dotted name.
        folder: where to.
        ablation: of the run, if there was one.

    Returns:
        The paths of report.html and report.json.
    """
    measures = summarise(run.windows)
    rows = [window_row(w) for w in run.windows]
    facts = _facts(run)
    document = {
        **facts,
        "configuration": dict(configuration),
        "definitions": DEFINITIONS,
        "summary": {m.key: _measure_entry(m) for m in measures},
        "ablation": dataclasses.asdict(ablation) if ablation else None,
        "windows": rows,
    }
    json_path, html_path = folder / "report.json", folder / "report.html"
    write_json(json_path, document)
    _write_csv(folder / "windows.csv", rows)
    html_path.write_text(_html(run, measures, facts, configuration, ablation), encoding="utf-8")
    return html_path, json_path


def window_row(window: WindowResult) -> dict[str, Any]:
    """One window as flat values with their units in the names; None where unknown."""
    row: dict[str, Any] = {
        "index": window.index,
        "t_start_s": window.t_start / NS_PER_S,
        "t_end_s": window.t_end / NS_PER_S,
        "events": window.events,
        "status": window.status,
        "model": window.model,
        **_axes("angular_{}_rad_s", window.angular),
        **_axes("linear_{}", window.linear),
        **_axes("sigma_linear_{}", window.sigma[:3]),
        **_axes("sigma_angular_{}_rad_s", window.sigma[3:]),
    }
    nothing = np.full(3, np.nan)
    true_linear = window.truth.linear if window.truth else None
    row |= _axes("true_angular_{}_rad_s", window.truth.angular if window.truth else nothing)
    row |= _axes("true_linear_{}_m_s", nothing if true_linear is None else true_linear)
    row |= {
        "angular_error_deg_s": float(np.degrees(np.linalg.norm(window.angular_error))),
        "axis_error_deg": window.axis_error_deg,
        "rate_ratio": window.rate_ratio,
        "direction_error_deg": window.direction_error_deg,
        "epe_px": window.flow.epe_px if window.flow else None,
        "static_epe_px": window.static_flow.epe_px if window.static_flow else None,
        "out_percent": window.flow.pe3 if window.flow else None,
        "ae_deg": window.flow.ae_deg if window.flow else None,
        "true_displacement_px": window.flow.truth_px if window.flow else None,
        "compared_pixels": window.flow.pixels if window.flow else None,
        "track_error_px": window.tracks.end_px if window.tracks else None,
        "track_true_px": window.tracks.true_px if window.tracks else None,
        "track_age_s": window.tracks.age_s if window.tracks else None,
        "compared_tracks": window.tracks.points if window.tracks else None,
        "contrast_gain": window.quality.contrast_gain,
        "residual_px": window.quality.residual_px,
        "inlier_fraction": window.quality.inlier_fraction,
        "iterations": window.quality.iterations,
        "stop_reason": window.quality.stop_reason,
        "warm": window.quality.warm,
        "runtime_s": window.quality.runtime_s,
        "note": window.note,
    }
    return {name: without_nan(value) for name, value in row.items()}


def _facts(run: Evaluation) -> dict[str, Any]:
    first, last = run.windows[0], run.windows[-1]
    camera = run.camera
    return {
        "source": str(run.source),
        "topic": run.topic,
        "camera": f"{camera.width}x{camera.height}, {camera.model}, fx {camera.fx:.2f}, "
        f"fy {camera.fy:.2f}, cx {camera.cx:.2f}, cy {camera.cy:.2f} px",
        "truth": run.truth.description,
        "protocol": run.protocol,
        "published": dataclasses.asdict(run.published) if run.published else None,
        "interrupted": run.interrupted,
        "windows_total": len(run.windows),
        "windows_ok": sum(w.ok for w in run.windows),
        "windows_with_exception": sum(bool(w.note) for w in run.windows),
        "events": sum(w.events for w in run.windows),
        "recorded_s": (last.t_end - first.t_start) / NS_PER_S,
        "versions": versions(),
        "machine": machine(),
    }


def _html(
    run: Evaluation,
    measures: Sequence[Measure],
    facts: Mapping[str, Any],
    configuration: Mapping[str, Any],
    ablation: Ablation | None,
) -> str:
    charts = [
        ("Egomotion over time", figures.twist_over_time(run.windows)),
        ("Errors over time", figures.errors_over_time(run.windows)),
        ("Distribution of the errors over windows", figures.error_histograms(run.windows)),
    ]
    examples = run.gallery.examples()
    with_tracks = [example for example in examples if example.tracks]
    tracked = max(with_tracks, key=lambda example: len(example.tracks), default=None)
    return render(
        _TEMPLATE,
        name=run.source.name,
        facts=facts,
        measures=measures,
        charts=[(title, svg_uri(figure)) for title, figure in charts if figure],
        examples=[(e, png_uri(window_panels(e, run.camera, run.truth))) for e in examples],
        tracked=tracked,
        tracks_image=png_uri(track_panels(tracked, run.camera)) if tracked else None,
        ablation=ablation,
        windows=_table(run.windows),
        windows_left_out=max(0, len(run.windows) - _MAX_TABLE_ROWS),
        start=run.windows[0].t_start,
        ns_per_s=NS_PER_S,
        definitions=DEFINITIONS,
        configuration=configuration,
    )


def _table(windows: Sequence[WindowResult]) -> list[WindowResult]:
    """The rows that are shown: an even selection of a long run."""
    step = math.ceil(len(windows) / _MAX_TABLE_ROWS)
    return list(windows[::step])


def _measure_entry(measure: Measure) -> dict[str, Any]:
    return {
        "label": measure.label,
        "value": measure.value,
        "unit": measure.unit,
        "interval_95": [measure.low, measure.high],
        "windows": measure.windows,
    }


def _axes(name: str, values: np.ndarray) -> dict[str, float]:
    return {name.format(axis): float(v) for axis, v in zip("xyz", values, strict=True)}


def _write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, fieldnames=list(rows[0]))
        table.writeheader()
        table.writerows(rows)
