"""A run as tables on the screen: the scores, then the other figures and the rates."""

import math
from collections.abc import Mapping
from typing import Any

from benchmarks.scoreboard.score_summary import SCORES
from benchmarks.scoreboard.verdicts import ACCURATE, CONSISTENT, CRITERIA

# Column's head, figure, digits.
COLUMNS = (
    ("est %", "covered_moving", 0),
    ("still %", "covered_still", 0),
    ("flow %", "flow_moving", 0),
    ("EPE px", "epe_px", 2),
    ("of px", "truth_px", 1),
    ("w deg/s", "w_rms", 2),
    ("of", "w_true_rms", 1),
    ("v deg", "v_median", 1),
    ("90 %", "v_90", 0),
    ("rev %", "v_reversed", 0),
    ("NEES w", "nees_w", 1),
    ("NEES v", "nees_v", 1),
    ("conf %", "confident_wrong", 1),
    ("lost %", "lost", 1),
    ("after s", "settled_s", 2),
)
_WIDTH = 8
_SCORE_WIDTH = 23
_COUNT_WIDTH = 5
_RATE_WIDTH = 12


def table(document: Mapping[str, Any]) -> str:
    """Lay a run's document out: tables of one line per recording, what is over all below."""
    names = [recording["name"] for recording in document["recordings"]]
    name_width = max([10, *(len(name) for name in names)])
    lines = [*_score_lines(document, name_width), "", *_figure_lines(document, name_width)]
    lines += ["", *_rate_lines(document["rates"])]
    lines += [f"missing: {name}" for name in document["missing"]]
    return "\n".join(lines)


def _score_lines(document: Mapping[str, Any], name_width: int) -> list[str]:
    rows = _score_rows(document)
    width = max(name_width, *(len(name) for name, *_ in rows))
    heads = "".join(f"{score.label:>{_SCORE_WIDTH}}{'of':>{_COUNT_WIDTH}}" for score in SCORES)
    lines = [f"{'recording':<{width}}{heads}"]
    for name, values, counts in rows:
        columns = "".join(
            f"{number(value, score.digits):>{_SCORE_WIDTH}}{count:>{_COUNT_WIDTH}}"
            for score, value, count in zip(SCORES, values, counts, strict=True)
        )
        lines.append(f"{name:<{width}}{columns}")
    return [*lines, "mean of EPE: the geometric one; of: windows, of groups recordings"]


def _score_rows(document: Mapping[str, Any]) -> list[tuple[str, list[float], list[int]]]:
    """List names, scores and what they are over: each recording, then each group twice."""
    rows = []
    for recording in document["recordings"]:
        found = recording["figures"]
        values = [found[score.figure] for score in SCORES]
        rows.append((recording["name"], values, [found[score.windows] for score in SCORES]))
    for group, found in document["scores"].items():
        counts = [found[score.figure]["recordings"] for score in SCORES]
        medians = [found[score.figure]["median"] for score in SCORES]
        means = [found[score.figure][score.mean_name] for score in SCORES]
        rows += [(f"{group}, median", medians, counts), (f"{group}, mean", means, counts)]
    return rows


def _figure_lines(document: Mapping[str, Any], name_width: int) -> list[str]:
    heads = "".join(f"{head:>{_WIDTH}}" for head, *_ in COLUMNS)
    lines = [f"{'recording':<{name_width}}{heads}  verdict"]
    for recording in document["recordings"]:
        figures = recording["figures"]
        numbers = "".join(f"{number(figures[key], n):>{_WIDTH}}" for _, key, n in COLUMNS)
        lines.append(f"{recording['name']:<{name_width}}{numbers}  {_verdict(recording)}")
    return lines


def number(value: float | None, digits: int) -> str:
    """Format a figure; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.{digits}f}" if abs(value) < 1e4 else f"{value:.1e}"


def _verdict(recording: Mapping[str, Any]) -> str:
    words = [word for word in ("accurate", "consistent") if recording[word]]
    missed = [name for name in CRITERIA if recording["criteria"][name] is False]
    return ", ".join(words) + (f" (missed: {' '.join(missed)})" if missed else "")


def _rate_lines(rates: Mapping[str, Mapping[str, Any]]) -> list[str]:
    heads = ["accurate", *ACCURATE, "consistent", *CONSISTENT]
    lines = [f"{'rates, %':<12}{'count':>6}" + "".join(f"{head:>{_RATE_WIDTH}}" for head in heads)]
    for group, found in rates.items():
        numbers = "".join(f"{number(found[head], 0):>{_RATE_WIDTH}}" for head in heads)
        lines.append(f"{group:<12}{found['recordings']:>6}{numbers}")
    return lines
