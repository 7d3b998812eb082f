"""What others build and contribute with: files that parse and name what exists.

Containers and workflow are not run here.
"""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

import emoflow_ros

ROOT = Path(__file__).resolve().parents[1]
DOCKERFILE = ROOT / "docker" / "Dockerfile"
COMPOSE = ROOT / "docker" / "compose.yaml"
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
CITATION = ROOT / "CITATION.cff"
GUIDE = ROOT / "CONTRIBUTING.md"
ALL = [DOCKERFILE, COMPOSE, WORKFLOW, *FORMS, CITATION, GUIDE, ROOT / "docker" / "entrypoint.sh"]


def load(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def instructions() -> list[tuple[str, list[str]]]:
    """The Dockerfile's instructions, continued lines joined: keyword and words."""
    lines = [x for x in DOCKERFILE.read_text().splitlines() if x and not x.startswith("#")]
    text = "\n".join(lines).replace("\\\n", " ")
    return [(words[0], words[1:]) for line in text.splitlines() if (words := line.split())]


def make_targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):(?!=)", (ROOT / "Makefile").read_text(), re.MULTILINE))


def make_calls(text: str) -> list[str]:
    return re.findall(r"^(?:\w+=\w+ )*make ([a-z-]+)", text, re.MULTILINE)


def copied() -> list[str]:
    return [
        source for keyword, words in instructions() if keyword == "COPY" for source in words[:-1]
    ]


def stages() -> dict[str, str]:
    """Base image of each stage of the Dockerfile."""
    return {words[2]: words[0] for keyword, words in instructions() if keyword == "FROM"}


def test_dockerfile_has_its_stages_and_copies_what_exists() -> None:
    assert stages() == {"cpu": "ros:jazzy-ros-base", "cuda": "cpu"}
    assert len(copied()) > 10
    for source in copied():
        assert (ROOT / source).exists(), source
    entry = next(words for keyword, words in instructions() if keyword == "ENTRYPOINT")
    path = entry[0].strip('[]"').removeprefix("/opt/emoflow_ros/")
    assert (ROOT / path).stat().st_mode & 0o100
    known = {"FROM", "SHELL", "WORKDIR", "COPY", "RUN", "ENTRYPOINT", "CMD", "ENV"}
    assert {keyword for keyword, _ in instructions()} <= known


def test_dockerfile_copies_everything_that_the_set_up_reads() -> None:
    files = {path.name for path in ROOT.glob("requirements*")} | {"package.xml", "setup.py"}
    files |= {"setup.cfg", "Makefile", "scripts", "config", "launch", "resource"}
    assert files | {"emoflow_ros", "msg_adapters"} <= set(copied())


def test_build_context_holds_what_the_dockerfile_copies() -> None:
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    assert "*" in lines
    kept = [line.removeprefix("!") for line in lines if line.startswith("!")]
    for source in copied():
        parents = [str(path) for path in (Path(source), *Path(source).parents)]
        assert any(Path(parent).match(pattern) for parent in parents for pattern in kept), source


def test_compose_runs_a_node_and_a_replay_of_what_it_simulates() -> None:
    services = load(COMPOSE)["services"]
    assert set(services) == {"simulate", "node", "replay"}
    for service in services.values():
        build = service["build"]
        assert build["target"] in stages()
        context = (COMPOSE.parent / build["context"]).resolve()
        assert (context, context / build["dockerfile"]) == (ROOT, DOCKERFILE)
        assert set(service.get("depends_on", {})) < set(services)
    commands = {name: service["command"].split() for name, service in services.items()}
    executables = re.findall(r'f"(\w+) = \{PACKAGE\}', (ROOT / "setup.py").read_text())
    for name in ("simulate", "replay"):
        assert commands[name][:3] == ["ros2", "run", "emoflow_ros"]
        assert commands[name][3] in executables
    assert commands["node"][:3] == ["ros2", "launch", "emoflow_ros"]
    assert (ROOT / "launch" / commands["node"][3]).is_file()


def test_workflow_runs_lint_tests_and_demo_in_the_container() -> None:
    workflow = load(WORKFLOW)
    job = workflow["jobs"]["test"]
    assert (job["runs-on"], job["container"]) == ("ubuntu-24.04", "ros:jazzy")
    steps = "\n".join(step.get("run", "") for step in job["steps"])
    assert {"lint", "test", "demo"} <= set(make_calls(steps)) <= make_targets()
    assert all(("run" in step) != ("uses" in step) for step in job["steps"])


def test_make_targets_of_dockerfile_and_guide_exist() -> None:
    commands = "\n".join(" ".join(words) for _, words in instructions())
    guide = "\n".join(re.findall(r"```\n(.*?)```", GUIDE.read_text(), re.DOTALL))
    assert make_calls(commands) and make_calls(guide)
    assert set(make_calls(commands) + make_calls(guide)) <= make_targets()


def test_guide_names_folders_and_files_that_exist() -> None:
    text = GUIDE.read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:[\w.-]+/)+[\w.-]*)`", text))
    named |= set(re.findall(r"\]\(([^)#:]+)\)", text))
    assert len(named) > 15
    for path in named:
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_issue_forms_have_what_github_wants(path: Path) -> None:
    form = load(path)
    assert form["name"] and form["description"]
    fields = [part for part in form["body"] if part["type"] != "markdown"]
    assert {part["type"] for part in fields} <= {"input", "textarea", "dropdown", "checkboxes"}
    names = [part["id"] for part in fields]
    assert len(names) == len(set(names)) > 3
    assert all(part["attributes"]["label"] for part in fields)


def test_there_is_a_form_for_bugs_and_one_for_accuracy() -> None:
    assert [path.stem for path in FORMS] == ["accuracy", "bug"]


def test_citation_is_of_this_version_and_names_the_paper() -> None:
    citation = load(CITATION)
    assert set(citation) >= {"cff-version", "message", "title", "authors"}
    assert citation["title"] == "emoflow_ros"
    assert str(citation["version"]) == emoflow_ros.__version__
    assert citation["authors"] == [{"name": "emoflow_ros maintainers"}]
    (paper,) = citation["references"]
    assert paper["title"].startswith("E-MoFlow: ")
    assert paper["year"] == 2025 and "NeurIPS" in paper["collection-title"]
    assert paper["identifiers"] == [{"type": "other", "value": "arXiv:2510.12753"}]


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_no_package_index_is_named(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"index-url|find-links|pypi\.|/simple\b|https?://", text)
