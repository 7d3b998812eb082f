"""Which part of the package imports which, and the page that tells newcomers."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
WALKS = ("Where is a twist computed?", "Where is it published?", "Where is it evaluated?")
LONGEST_WALK = 8  # files

# Folders of core: each imports earlier ones only. "" is core itself, where the memory's step is.
CORE = (
    "numerics", "geometry", "types", "stream", "gyro", "lattice", "front_end", "back_end", "",
    "products",
)  # fmt: skip

# A part is a folder or a file directly in emoflow_ros, or msg_adapters. What it may import:
_ESTIMATION = {"core", "config", "errors", "factory"}
_RECORDINGS = {"evaluation", "readers", "truth", *_ESTIMATION}
ALLOWED = {
    "core": {"errors"},
    "msg_adapters": {"core", "errors"},
    "published": {"core", "errors"},
    "config": {"core", "published", "errors"},
    "factory": {"core", "published", "config", "errors"},
    "readers": {"core", "errors", "msg_adapters"},
    "truth": {"core", "errors", "readers"},
    "evaluation": _RECORDINGS - {"evaluation"},
    "report": {"core", "errors", "evaluation", "truth"},
    "labels": _RECORDINGS - {"truth"},
    "simulation": {"core", "errors"},
    "node": {"cli", "compiled_code", "msg_adapters", *_ESTIMATION},
    "commands": {"cli", "labels", "msg_adapters", "node", "report", "simulation", *_RECORDINGS},
    "cli": {"compiled_code", "errors"},
    "compiled_code": {"errors"},
    "errors": set(),
    "__init__": set(),
}


def part_of(path: Path) -> str:
    top = path.relative_to(ROOT).parts
    return top[0] if top[0] == "msg_adapters" else top[1].removesuffix(".py")


def imports(path: Path) -> Iterator[list[str]]:
    """Names of the modules that a file imports, anywhere in it, in parts."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            if node.module == "emoflow_ros":
                yield from (["emoflow_ros", alias.name] for alias in node.names)
            else:
                yield str(node.module).split(".")


def imported_parts() -> dict[str, set[str]]:
    """Parts by the part that imports them."""
    found: dict[str, set[str]] = {}
    for folder in ("emoflow_ros", "msg_adapters"):
        for path in (ROOT / folder).rglob("*.py"):
            own = part_of(path)
            named = {
                "msg_adapters" if name[0] == "msg_adapters" else name[1]
                for name in imports(path)
                if name[0] == "msg_adapters" or (name[0] == "emoflow_ros" and len(name) > 1)
            }
            found.setdefault(own, set()).update(named - {own})
    return found


FOUND = imported_parts()


def test_every_part_has_a_place() -> None:
    assert FOUND.keys() == ALLOWED.keys()


@pytest.mark.parametrize("part", ALLOWED)
def test_a_part_imports_only_what_it_may(part: str) -> None:
    assert FOUND[part] <= ALLOWED[part]


def test_folders_of_core_import_earlier_ones_only() -> None:
    core = ROOT / "emoflow_ros" / "core"
    assert {path.parent.name for path in core.glob("*/__init__.py")} == {*CORE} - {""}
    seen = 0
    for path in core.rglob("*.py"):
        own = path.relative_to(core).parts[0] if path.parent != core else ""
        for name in (dotted.split(".") for dotted in names(path)):
            if name[:2] == ["emoflow_ros", "core"] and len(name) > 2:
                of = name[2] if name[2] in CORE else ""
                assert CORE.index(of) <= CORE.index(own), f"{path.relative_to(core)}: {of}"
                seen += 1
    assert seen > 200


def test_evaluation_and_report_do_not_import_each_other() -> None:
    assert "evaluation" in FOUND["report"]
    assert "report" not in FOUND["evaluation"]


def test_only_node_replay_and_demo_import_ros() -> None:
    users = {
        str(path.relative_to(ROOT / "emoflow_ros"))
        for folder in ("emoflow_ros", "msg_adapters")
        for path in (ROOT / folder).rglob("*.py")
        if any(name[0] == "rclpy" for name in imports(path)) and part_of(path) != "node"
    }
    assert users == {"commands/replay.py", "commands/demo.py"}


def walk(title: str) -> list[Path]:
    """Files of the numbered list below a heading of the page."""
    text = PAGE.read_text().split(f"## {title}\n")[1].split("\n## ")[0]
    steps = re.findall(r"^\d+\. \[[\w/.]+\]\(([\w/.]+\.py)\)", text, re.MULTILINE)
    assert len(steps) == len(re.findall(r"^\d+\. ", text, re.MULTILINE))
    return [(PAGE.parent / step).resolve() for step in steps]


def module(path: Path) -> list[str]:
    return list(path.relative_to(ROOT).with_suffix("").parts)


def names(path: Path) -> set[str]:
    """Modules that a file imports, also as `from package import module`."""
    tree = ast.parse(path.read_text())
    froms = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    members = {f"{n.module}.{alias.name}" for n in froms for alias in n.names}
    return members | {".".join(name) for name in imports(path)}


@pytest.mark.parametrize("title", WALKS)
def test_a_newcomer_walks_along_imports_past_few_files(title: str) -> None:
    files = walk(title)
    assert 1 < len(files) <= LONGEST_WALK
    for number, path in enumerate(files[1:], start=1):
        assert any(
            ".".join(module(path)) in names(before) or ".".join(module(before)) in names(path)
            for before in files[:number]
        ), path


def test_the_page_names_what_its_files_define() -> None:
    """A step names functions and classes; each stands in one of the files that the step links."""
    steps = re.findall(r"^\d+\. .*(?:\n(?!\d+\. |\n).*)*", PAGE.read_text(), re.MULTILINE)
    assert len(steps) > 25
    for step in steps:
        linked = re.findall(r"\((\.\./[\w/]+\.py)\)", step)
        text = "".join((PAGE.parent / path).read_text() for path in linked)
        for name in re.findall(r"`(?:\w+\.)?(\w+)`", step):
            assert re.search(rf"\b(def|class) {name}\b", text), f"{name} in {linked}"


def test_the_page_names_what_exists_and_every_folder() -> None:
    linked = {
        (PAGE.parent / target).resolve()
        for target in re.findall(r"\]\(([^)#:]+)[)#]", PAGE.read_text())
    }
    assert len(linked) > 40
    assert [path for path in sorted(linked) if not path.exists()] == []
    folders = {path.parent for path in (ROOT / "emoflow_ros").glob("*/__init__.py")}
    assert folders <= linked


def test_the_table_of_folders_stands_once() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
    assert [page for page in pages if "| folder |" in page.read_text()] == [PAGE]
