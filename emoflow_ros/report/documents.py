"""The formats of a report's files: JSON and CSV for programs, self-contained HTML for people.

Every reader accepts the JSON: it has no NaN.
"""

import base64
import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imsave

from emoflow_ros.core.products.pictures import Image
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.evaluation.estimates_columns import quality_values
from emoflow_ros.evaluation.window_results import Vector, WindowResult
from emoflow_ros.truth import TrueTwist

_PNG_DPI = 130
_PNG_LEVEL = 3  # a fifth larger than with the usual 6, in half of the time


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document, with null where a number is not finite."""
    text = json.dumps(without_nan(document), indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text, encoding="utf-8")


def without_nan(value: Any) -> Any:
    """Replace numbers that are not finite by None, at any depth."""
    if isinstance(value, Mapping):
        return {name: without_nan(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


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
        "relative_speed": window.relative_speed,
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


def render(template: str, **values: Any) -> str:
    """Fill a template of `templates/`; a missing value is an error."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_source), autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.filters |= {
        "number": format_number,
        "short": "{:.3g}".format,
        "count": format_count,
        "degrees": math.degrees,
    }
    return environment.get_template(template).render(**values)


def format_number(value: float | None, digits: int = 2) -> str:
    """Format with a fixed number of digits; a dash where there is no value."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    rounded = round(value, digits) + 0.0  # no negative zero
    return f"{rounded:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def format_count(value: int) -> str:
    """Format a whole number in groups of three digits."""
    return f"{value:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def svg_uri(figure: Figure) -> str:
    """Draw a figure as SVG in a data URI."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()


def png_uri(picture: Figure | Image) -> str:
    """Write a figure, or an image (H, W, 3) uint8 RGB pixel by pixel, as PNG in a data URI."""
    buffer = io.BytesIO()
    if isinstance(picture, Figure):
        picture.savefig(buffer, format="png", dpi=_PNG_DPI)
    else:
        imsave(
            buffer, picture, format="png", origin="upper", pil_kwargs={"compress_level": _PNG_LEVEL}
        )
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _source(name: str) -> str:
    path = resources.files("emoflow_ros.report").joinpath("templates", name)
    return path.read_text(encoding="utf-8")
