"""The run as pages: scores and figures of all recordings, rates, the worst recordings over time."""

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2

from benchmarks.scoreboard.figures import Figures
from benchmarks.scoreboard.plots import motion_figure
from benchmarks.scoreboard.run import Outcome, file_name, severity
from benchmarks.scoreboard.score_summary import SCORES
from benchmarks.scoreboard.table import number
from benchmarks.scoreboard.verdicts import ACCURATE, CONSISTENT, CRITERIA
from emoflow_ros.report.documents import png_uri

WORST = 10
_PAGES = "pages"


def write_report(folder: Path, outcomes: Sequence[Outcome], document: Mapping[str, Any]) -> Path:
    """Write report.html and the pages of the ten worst recordings, which it links to.

    Args:
        folder: of the run.
        outcomes: all recordings.
        document: the run's summary.
    """
    ranked = sorted(outcomes, key=severity, reverse=True)
    worst = [outcome for outcome in ranked if outcome.verdict.missed][:WORST]
    (folder / _PAGES).mkdir(parents=True, exist_ok=True)
    links = {o.name: f"{_PAGES}/{file_name(o.name)}.html" for o in worst}
    for outcome in worst:
        page = _render(
            "recording.html.j2",
            outcome=outcome,
            lines=_figure_lines(outcome.figures),
            plot=png_uri(motion_figure(outcome.windows)),
        )
        (folder / links[outcome.name]).write_text(page, encoding="utf-8")
    path = folder / "report.html"
    page = _render(
        "scoreboard.html.j2",
        outcomes=outcomes,
        document=document,
        worst=worst,
        links=links,
        pictures={o.name: _uri(o.picture) for o in outcomes},
        heads=["accurate", *ACCURATE, "consistent", *CONSISTENT],
    )
    path.write_text(page, encoding="utf-8")
    return path


def _figure_lines(figures: Figures) -> list[tuple[str, str]]:
    return [
        (name, str(value) if isinstance(value, int) else number(value, 2))
        for name, value in vars(figures).items()
    ]


def _uri(picture: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(picture).decode()


def _render(template: str, **values: Any) -> str:
    folders = [
        str(Path(__file__).parent / "templates"),
        str(resources.files("emoflow_ros.report") / "templates"),  # the base of all pages
    ]
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    environment.globals |= {"CRITERIA": CRITERIA, "SCORES": SCORES}
    return environment.get_template(template).render(**values)
