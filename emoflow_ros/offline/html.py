"""Self-contained pages: templates, numbers and pictures inside the page."""

import base64
import io
import math
from importlib import resources
from typing import Any

import jinja2
from matplotlib.figure import Figure

_PNG_DPI = 130


def render(template: str, **values: Any) -> str:
    """Fill a template of `templates/`; a value that it misses is an error."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_source), autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.filters |= {
        "number": format_number,
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
    return "data:image/svg+xml;base64," + _encode(figure, format="svg", metadata={"Date": None})


def png_uri(figure: Figure) -> str:
    """Draw a figure as PNG in a data URI."""
    return "data:image/png;base64," + _encode(figure, format="png", dpi=_PNG_DPI)


def _encode(figure: Figure, **options: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, **options)
    return base64.b64encode(buffer.getvalue()).decode()


def _source(name: str) -> str:
    path = resources.files("emoflow_ros.offline").joinpath("templates", name)
    return path.read_text(encoding="utf-8")
