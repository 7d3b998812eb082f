"""Write an evaluation's results: report.json, windows.csv and one self-contained report.html."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.evaluation.ablation import Ablation
from emoflow_ros.evaluation.provenance import machine, versions
from emoflow_ros.evaluation.summary import Measure, summarise, summarise_by_truth
from emoflow_ros.evaluation.trajectory_errors import (
    RELATIVE_SPAN_S,
    Trajectory,
    local_path,
    longest,
    trajectories,
)
from emoflow_ros.evaluation.window_results import MIN_TRUE_RATE, MIN_TRUE_SPEED, WindowResult
from emoflow_ros.evaluation.window_run import Evaluation
from emoflow_ros.report import figures
from emoflow_ros.report.documents import png_uri, render, svg_uri, window_row, write_csv, write_json
from emoflow_ros.report.window_pictures import (
    error_legend,
    flow_legend,
    track_panels,
    window_pictures,
)

_TEMPLATE = "report.html.j2"
_MAX_TABLE_ROWS = 400
_MAX_CHART_WINDOWS = 2000
DEFINITIONS = (
    "Flow errors compare the displacement over the window at pixels that hold an event of the "
    "window and whose truth is finite with |u| > 0 and |v| > 0 (DSEC's protocol: at all pixels "
    "with truth); they are averaged over the pixels of a window first and over windows second. "
    "1/2/3PE is the share of pixels that are off by more than 1, 2 and 3 px.",
    "Angular flow error is the angle between (u, v, 1) and the true (u, v, 1), in pixels over "
    "the window.",
    "Tracks are carried from window to window until they leave the image; their error is the "
    "distance from the true position at a window's end, which was carried along the true flow "
    "from the same start.",
    "RMS is the root of the mean square over windows and the three axes. Figures marked 'paper' "
    "are counted as in the published tables: the root per window, then the mean over windows.",
    f"The axis of ω is compared where the true |ω| exceeds {np.degrees(MIN_TRUE_RATE):.0f} deg/s, "
    f"the direction of v where the true speed exceeds {MIN_TRUE_SPEED} m/s. The direction error "
    "keeps the sign: opposite directions are 180 degrees apart. Nothing is taken from the truth.",
    "Oracle figures take the scale of v from the truth, the paper's error of v also the sign of "
    "every axis; they are no property of the estimate, and only serve comparison with tables that "
    "do the same.",
    "The trajectory adds up the velocities at the windows' middles over unbroken runs of windows, "
    "with a screw motion by the mean of two neighbours; no translation where it is not "
    f"observable. RPE is the RMS error of the motion between two windows, or over "
    f"{RELATIVE_SPAN_S:g} s; ATE the RMS distance of the longest run's positions after the "
    "rotation and translation that fit them best to the truth (no scaling).",
    "Aligned by a similarity, the longest run takes nothing else from the truth: its speeds are "
    "those that a memory of positions tells up to one factor, else one speed, and rotation, "
    "translation and scale are fitted once for the whole run (Umeyama). Its drift is the error of "
    f"the motion over {RELATIVE_SPAN_S:g} s over the true way in that time.",
    "The real-time factor is recorded time over the estimator's time; above 1 is faster than real "
    "time. The estimator's time is taken while the window before is compared with the truth, which "
    "makes it about a fifth longer on two cores.",
    "Intervals are 95 % percentile bootstrap intervals over windows. Neighbouring windows are not "
    "independent, so that they are rather too narrow than too wide.",
)


@dataclass(frozen=True)
class Report:
    """What was written, and the figures in it."""

    html: Path
    json: Path
    measures: tuple[Measure, ...]


def write_report(
    run: Evaluation,
    configuration: Mapping[str, Any],
    folder: Path,
    ablation: Ablation | None = None,
) -> Report:
    """Write report.json, windows.csv and report.html into an existing folder.

    Args:
        run: with at least one window.
        configuration: option values by dotted name.
        folder: where to.
        ablation: of the run, if there was one.
    """
    measures = tuple(summarise(run.windows, run.speed))
    by_truth = summarise_by_truth(run.windows, run.truth)
    rows = [window_row(w) for w in run.windows]
    facts = _facts(run)
    document = {
        **facts,
        "configuration": dict(configuration),
        "definitions": DEFINITIONS,
        "summary": _entries(measures),
        "velocity_by_truth": {name: _entries(of) for name, of in by_truth.items()},
        "worst_windows": [w.index for w in run.gallery.worst()],
        "ablation": dataclasses.asdict(ablation) if ablation else None,
        "windows": rows,
    }
    report = Report(folder / "report.html", folder / "report.json", measures)
    write_json(report.json, document)
    write_csv(folder / "windows.csv", rows)
    page = render_page(run, measures, by_truth, facts, configuration, ablation)
    report.html.write_text(page, encoding="utf-8")
    return report


def _facts(run: Evaluation) -> dict[str, Any]:
    first, last = run.windows[0], run.windows[-1]
    camera = run.camera
    recorded = (last.t_end - first.t_start) / NS_PER_S
    return {
        "source": str(run.source),
        "topic": run.topic,
        "camera": f"{camera.width}x{camera.height}, {camera.model}, fx {camera.fx:.2f}, "
        f"fy {camera.fy:.2f}, cx {camera.cx:.2f}, cy {camera.cy:.2f} px",
        "truth": run.truth.description,
        "imu": run.imu or None,
        "protocol": run.protocol,
        "published": dataclasses.asdict(run.published) if run.published else None,
        "speed_m_s": run.speed,
        "interrupted": run.interrupted,
        "windows_total": len(run.windows),
        "windows_ok": sum(w.ok for w in run.windows),
        "windows_with_exception": sum(bool(w.note) for w in run.windows),
        "events": run.events,
        "events_unordered": run.unordered,
        "recorded_s": recorded,
        "wall_s": run.wall_s,
        "wall_real_time_factor": recorded / run.wall_s if run.wall_s else None,
        "versions": versions(),
        "machine": machine(),
    }


def render_page(
    run: Evaluation,
    measures: Sequence[Measure],
    by_truth: Mapping[str, Sequence[Measure]],
    facts: Mapping[str, Any],
    configuration: Mapping[str, Any],
    ablation: Ablation | None,
) -> str:
    """Write the page `report.html`, with its pictures in it."""
    examples = run.gallery.examples()
    with_tracks = [example for example in examples if example.tracks]
    tracked = max(with_tracks, key=lambda example: len(example.tracks), default=None)
    return render(
        _TEMPLATE,
        name=run.source.name,
        facts=facts,
        measures=measures,
        by_truth=by_truth,
        other_truths=list(by_truth)[1:],
        against={(name, m.key): m for name, of in by_truth.items() for m in of},
        truth_measures=list({m.key: m for of in by_truth.values() for m in of}.values()),
        charts=_charts(run),
        examples=[(e, window_pictures(e, run.camera, run.truth)) for e in examples],
        png_uri=png_uri,
        flow_legend=png_uri(flow_legend()),
        error_legend=png_uri(error_legend()),
        pictured={example.result.index for example in examples},
        worst=run.gallery.worst(),
        tracked=tracked,
        tracks_image=png_uri(track_panels(tracked, run.camera)) if tracked else None,
        ablation=ablation,
        windows=_thinned(run.windows, _MAX_TABLE_ROWS),
        start=run.windows[0].t_start,
        ns_per_s=NS_PER_S,
        definitions=DEFINITIONS,
        configuration=configuration,
    )


def _charts(run: Evaluation) -> list[tuple[str, str, str]]:
    """Titles, images and captions of the charts that the run has data for."""
    windows = _thinned(run.windows, _MAX_CHART_WINDOWS)
    thinned = "" if windows == run.windows else "An even selection of the windows. "
    names = [source.name for source in (run.truth.twists, *run.truth.other_twists) if source]
    path = _path(run)
    drawn = (
        (
            "Egomotion over time",
            figures.twist_over_time(windows, names),
            thinned + "Bands are ± 2 standard deviations as the estimator states them.",
        ),
        (
            "Trajectory",
            figures.trajectory(path) if path else None,
            _caption(path, run.speed) if path else "",
        ),
        ("Errors over time", figures.errors_over_time(windows), thinned),
        (
            "Distribution of the errors",
            figures.error_histograms(run.windows),
            "Numbers of windows by their error.",
        ),
    )
    return [(title, svg_uri(figure), caption) for title, figure, caption in drawn if figure]


def _path(run: Evaluation) -> Trajectory | None:
    """Return the path that is drawn: nothing in it but a similarity is taken from the truth."""
    if run.speed is None:
        return local_path(run.windows)
    path = longest(trajectories(run.windows, run.speed))
    return path if path is not None and path.has_translation else None


def _caption(path: Trajectory, speed: float | None) -> str:
    how = (
        "up to scale, and aligned with the truth as a whole by rotation, translation and scale"
        if speed is None
        else f"at {speed:g} m/s as given, and aligned with the truth by rotation and translation"
    )
    return (
        f"The longest unbroken run, {path.length:.2f} m long: the estimated velocities integrated "
        f"{how}."
    )


def _thinned(windows: Sequence[WindowResult], most: int) -> list[WindowResult]:
    """Take an even selection of a long run."""
    step = math.ceil(len(windows) / most)
    return list(windows[::step])


def _entries(measures: Sequence[Measure]) -> dict[str, dict[str, Any]]:
    return {
        measure.key: {
            "label": measure.label,
            "value": measure.value,
            "unit": measure.unit,
            "interval_95": [measure.low, measure.high],
            "windows": measure.windows,
        }
        for measure in measures
    }
