"""The page and the document of a comparison of runs."""

from collections.abc import Sequence
from pathlib import Path

from emoflow_ros.evaluation.run_comparison import ERRORS, Run, compare
from emoflow_ros.report.documents import render, svg_uri, write_json
from emoflow_ros.report.figures import runs_over_time

_TEMPLATE = "comparison.html.j2"
_CHARTS = ("epe_px", "angular_error_deg_s", "direction_error_deg")


def write_comparison(runs: Sequence[Run], folder: Path) -> Path:
    """Write comparison.json and comparison.html; all other runs are compared with the first one.

    Raises:
        InputError: a run that has no window in common with the first one.
    """
    differences = [d for run in runs[1:] for d in compare(runs[0], run)]
    names = list(dict.fromkeys(key for run in runs for key in run.report["configuration"]))
    settings = {name: [run.report["configuration"].get(name) for run in runs] for name in names}
    changed = {name: values for name, values in settings.items() if len(set(map(str, values))) > 1}
    measures = {
        key: [run.report["summary"].get(key) for run in runs]
        for key in dict.fromkeys(key for run in runs for key in run.report["summary"])
    }
    charts = [
        (label, runs_over_time([(run.name, run.series(key)) for run in runs], label, unit))
        for key, label, unit in ERRORS
        if key in _CHARTS
    ]
    write_json(
        folder / "comparison.json",
        {
            "runs": [run.name for run in runs],
            "differences": [vars(d) | {"significant": d.significant} for d in differences],
            "changed_options": changed,
        },
    )
    page = folder / "comparison.html"
    text = render(
        _TEMPLATE,
        runs=runs,
        measures=measures,
        differences=differences,
        changed=changed,
        charts=[(title, svg_uri(chart)) for title, chart in charts if chart],
    )
    page.write_text(text, encoding="utf-8")
    return page
