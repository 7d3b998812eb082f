from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.config import load_config
from emoflow_ros.node.parameters import render
from emoflow_ros.node.settings import NodeOptions, Settings, table

PAGE = Path(__file__).resolve().parents[2] / "docs" / "parameters.md"


def test_page_is_up_to_date() -> None:
    assert PAGE.read_text() == render(), "run `python -m emoflow_ros.node.parameters`"


@pytest.mark.parametrize("profile", ["realtime", "rigid", "paper", "paper_early_stop"])
def test_every_parameter_of_every_profile_is_there(profile: str) -> None:
    page = render()
    for info in table(Settings(NodeOptions(), load_config(profile))):
        assert f"| `{info.name}` |" in page


def test_row_holds_type_default_unit_range_and_change() -> None:
    rows = [line for line in render().splitlines() if line.startswith("| `window.duration_ms`")]
    assert rows == [
        "| `window.duration_ms` | float | `135.0` | ms | 1 to 10000 | any time "
        "| length of a window by time |"
    ]
