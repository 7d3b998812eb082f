"""Write docs/parameters.md from the typed table: `python -m emoflow_ros.node.parameter_docs`."""

import argparse
from collections.abc import Iterable
from pathlib import Path

from emoflow_ros.cli import run
from emoflow_ros.core.config import load_config
from emoflow_ros.core.options import OptionInfo
from emoflow_ros.node.parameters import changes
from emoflow_ros.node.settings import NodeOptions, Settings, table

_HEAD = """\
# Parameters of the node

Generated from the table that the node declares them from; write it anew with
`python -m emoflow_ros.node.parameter_docs`. `evaluate --set NAME=VALUE` takes those of
`window.*`, `estimator.*` and `imu.*`, too.

A name that does not exist, or a value out of range, is refused with the reason. A dump of the
node (`ros2 param dump`) can be loaded again: what cannot change may be in it unchanged. Parameters
change at `any time` and count from the next window, while the node is `unconfigured`, or only
`at start`. What to choose: [operations](operations.md#parameters),
[method](method.md#parameters).
"""
_COLUMNS = ("name", "type", "default", "unit", "range", "may change", "meaning")


def render() -> str:
    """Render the page: all parameters, then the estimator's with the published method."""
    usual = list(table(Settings(NodeOptions(), load_config("realtime"))))
    published = table(Settings(NodeOptions(), load_config("paper")))
    own = (info for info in published if info.name.startswith("estimator."))
    parts = [
        _HEAD,
        "## With the profile `realtime`\n",
        _render_table(usual),
        "## The estimator's with the profile `paper`\n",
        "They take the place of those above with `paper`, `paper_early_stop` and `paper_dsec`.\n",
        _render_table(own),
    ]
    return "\n".join(parts)


def _render_table(infos: Iterable[OptionInfo]) -> str:
    rows = [_COLUMNS, ("---",) * len(_COLUMNS), *map(_row, infos)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _row(info: OptionInfo) -> tuple[str, ...]:
    value = info.value
    default = str(value).lower() if isinstance(value, bool) else str(value)
    return (
        f"`{info.name}`",
        type(value).__name__,
        f"`{default}`" if default else "empty",
        info.unit,
        _range(info),
        str(changes(info.name)),
        info.description,
    )


def _range(info: OptionInfo) -> str:
    if info.choices:
        return ", ".join(f"`{choice}`" for choice in info.choices)
    match info.minimum, info.maximum:
        case None, None:
            return ""
        case low, None:
            return f"from {low:g}"
        case None, high:
            return f"up to {high:g}"
        case low, high:
            return f"{low:g} to {high:g}"


def main() -> int:
    """Write the page."""
    return run(_main)


def _main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, epilog="Example: python -m emoflow_ros.node.parameter_docs"
    )
    parser.add_argument(
        "path", nargs="?", type=Path, default=Path("docs/parameters.md"), help="page to write"
    )
    path: Path = parser.parse_args().path
    path.write_text(render())
    print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
