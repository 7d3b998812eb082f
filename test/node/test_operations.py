"""The tables in docs/operations.md, against the tests that they name and the node's help."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("node", "integration", "core", "readers", "truth", "evaluation", "labels", "commands")
COLUMNS = ["fault", "what the node does", "what is lost", "test"]


def cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip("|").split("|")]


def table() -> list[list[str]]:
    """The rows of the table, without its head."""
    section = (ROOT / "docs" / "operations.md").read_text().partition("## When something goes")[2]
    rows = [line for line in section.partition("\n## ")[0].splitlines() if line.startswith("|")]
    assert cells(rows[0]) == COLUMNS
    return [cells(row) for row in rows[2:]]


@cache
def existing() -> set[str]:
    """Names of all tests of the node, alone and over DDS, of the core and of recordings."""
    files = [path for name in FOLDERS for path in (ROOT / "test" / name).glob("test_*.py")]
    bodies = [ast.parse(path.read_text()).body for path in files]
    return {node.name for body in bodies for node in body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("row", table(), ids=lambda row: row[0])
def test_every_fault_names_tests_that_exist(row: list[str]) -> None:
    assert len(row) == len(COLUMNS)
    assert all(row)
    named = re.findall(r"`(test_\w+)`", row[3])
    assert named
    assert set(named) <= existing()


def test_table_lists_the_faults_that_were_asked_for() -> None:
    faults = " ".join(row[0] for row in table())
    for word in (
        "killed", "hangs", "not finite", "out of memory", "CUDA missing", "CUDA lost",
        "no calibration", "calibration changes", "zeros", "malformed", "never reads",
        "more events", "no events", "QoS", "SIGTERM",
    ):  # fmt: skip
        assert word in faults


def test_help_lists_the_topics_and_what_must_be_given() -> None:
    pytest.importorskip("rclpy", reason="no ROS: run `make test`")
    from emoflow_ros.node.executable import parser

    said = parser().format_help()
    section = (ROOT / "docs" / "operations.md").read_text().partition("## Topics")[2]
    rows = [cells(row) for row in section.partition("\n## ")[0].splitlines() if row[:3] == "| `"]
    directions = {row[0].strip("`"): row[2] for row in rows}
    assert set(directions.values()) == {"in", "out"}
    received, published = said.split("topics out:")
    for topic, direction in directions.items():
        assert re.search(rf"(?m)(^|, |  ){topic}\b", received if direction == "in" else published)
    assert "Nothing is estimated without a calibration" in published
    assert "camera.calibration_file" in published
    assert "nothing needs to be given" not in said
