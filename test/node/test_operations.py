"""The table of topics in docs/operations.md, against the node's help."""

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.node.executable import parser

ROOT = Path(__file__).resolve().parents[2]


def cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip("|").split("|")]


def test_help_lists_the_topics() -> None:
    said = parser().format_help()
    section = (ROOT / "docs" / "operations.md").read_text().partition("## Topics")[2]
    rows = [cells(row) for row in section.partition("\n## ")[0].splitlines() if row[:3] == "| `"]
    directions = {row[0].strip("`"): row[2] for row in rows}
    assert set(directions.values()) == {"in", "out"}
    received, published = said.split("topics out:")
    for topic, direction in directions.items():
        assert re.search(rf"(?m)(^|, |  ){topic}\b", received if direction == "in" else published)


def test_each_known_case_says_what_happens_what_is_said_and_what_to_do() -> None:
    section = (ROOT / "docs" / "operations.md").read_text().partition("## When something goes w")[2]
    rows = [cells(row) for row in section.partition("\n## ")[0].splitlines() if row[:2] == "| "]
    assert rows[0] == [
        "what happens",
        "what the node does and says",
        "what is lost",
        "what to do",
    ]
    assert len(rows) > 80
    assert [row for row in rows if len(row) != 4 or not all(row)] == []
    assert len({row[0] for row in rows}) == len(rows)
