"""The options --layout and --time-unit of commands over recordings."""

import argparse

from emoflow_ros.readers.column_layout import SKIPPED, ColumnOptions, is_layout
from emoflow_ros.readers.time_units import TIME_UNITS


def add_column_options(parser: argparse.ArgumentParser) -> None:
    """Add --layout and --time-unit."""
    parser.add_argument(
        "--layout",
        type=_layout,
        default=None,
        metavar="xytp",
        help=f"of text lines and tables: a letter of each column, x, y, t, p, and {SKIPPED} for "
        "others (default: told by the first 1000 rows)",
    )
    parser.add_argument(
        "--time-unit",
        choices=TIME_UNITS,
        default=None,
        help="of text lines, arrays and HDF5 columns (default: told by the values and their rate)",
    )


def column_options(options: argparse.Namespace) -> ColumnOptions:
    """Return what the two options say."""
    return ColumnOptions(options.layout or "", options.time_unit or "")


def _layout(text: str) -> str:
    """Parse `x,y,t,p`, `x y t p` or `xytp`."""
    letters = text.lower().replace(",", "").replace(" ", "")
    if not is_layout(letters):
        raise argparse.ArgumentTypeError(
            f"'{text}' does not name x, y, t and p once each, and {SKIPPED} for other columns"
        )
    return letters
