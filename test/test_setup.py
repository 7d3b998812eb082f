"""What set-up rests on: the package description, the locks and the executables."""

import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LOCKS = ("requirements", "requirements-ros", "requirements-messages")
LOCK_OF = {name: name for name in LOCKS} | {
    f"requirements-{part}": "requirements" for part in ("offline", "ray", "test", "torch")
}

# Prints exit code and output of each executable's --help.
EXPLAIN_ALL = """
import contextlib, importlib, io, json, sys

explained = {}
for name, (module, function) in json.load(sys.stdin).items():
    main = getattr(importlib.import_module(f"emoflow_ros.{module}"), function)
    sys.argv, code = ["x", "--help"], None
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            code = main()
        except SystemExit as ended:
            code = ended.code
    explained[name] = code, out.getvalue()
print(json.dumps(explained))
"""


def entry_points() -> dict[str, tuple[str, str]]:
    """Module and function of each executable."""
    text = (ROOT / "setup.py").read_text()
    found = re.findall(r'f"(\w+) = \{PACKAGE\}\.([\w.]+):(\w+)"', text)
    return {name: (module, function) for name, module, function in found}


def test_version_is_the_same_everywhere() -> None:
    import emoflow_ros

    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    described = re.search(r'version="([^"]+)"', (ROOT / "setup.py").read_text())
    assert described is not None
    assert manifest.findtext("version") == described[1] == emoflow_ros.__version__


@pytest.mark.parametrize("name", LOCK_OF)
def test_lock_pins_all_requirements_and_names_no_index(name: str) -> None:
    lock = (ROOT / f"{LOCK_OF[name]}.lock").read_text().splitlines()
    pins = dict(line.split("==") for line in lock)
    assert all(re.fullmatch(r"[\w.+!]+", version) for version in pins.values())
    for line in (ROOT / f"{name}.in").read_text().splitlines():
        requirement = re.match(r"[\w-]+", line)
        if requirement:
            assert requirement[0].lower().replace("_", "-") in pins


def test_locks_of_one_environment_agree() -> None:
    first, second = (
        dict(line.split("==") for line in (ROOT / f"{name}.lock").read_text().splitlines())
        for name in LOCKS[:2]
    )
    assert {n: first[n] for n in first.keys() & second} == {
        n: second[n] for n in first.keys() & second
    }


@pytest.mark.parametrize("name", LOCKS[:2])  # the third is of an environment of its own
def test_numpy_is_that_of_ubuntu_24_04(name: str) -> None:
    """Packages of /opt/ros/jazzy are built against it, and fail with NumPy 2."""
    pins = dict(line.split("==") for line in (ROOT / f"{name}.lock").read_text().splitlines())
    assert pins["numpy"].split(".")[:2] == ["1", "26"]


def test_tests_with_a_limit_need_no_plugin_of_pytest() -> None:
    """`colcon test` runs them with the plugins that there are, perhaps none."""
    marked = [p for p in (ROOT / "test").rglob("test_*.py") if "mark.timeout(" in p.read_text()]
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "", *marked]
    environment = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    ran = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert {path.name for path in marked} > {"test_soak.py", "test_random_faults.py"}
    assert all(path.name in ran.stdout for path in marked)


def test_executables_explain_themselves() -> None:
    """In one process for all, because most of their time is that of its start."""
    assert set(entry_points()) >= {"estimator", "replay", "evaluate", "simulate"}
    shown = subprocess.run(
        [sys.executable, "-c", EXPLAIN_ALL],
        input=json.dumps(entry_points()), capture_output=True, text=True, cwd=ROOT, check=False,
    )  # fmt: skip
    assert shown.returncode == 0, shown.stderr
    explained = json.loads(shown.stdout)
    assert explained.keys() == entry_points().keys()
    for executable, (code, text) in explained.items():
        assert code in (0, None), text
        assert f"usage: {executable}" in text
        assert len(text.splitlines()) > 5


def test_node_process_loads_neither_torch_nor_the_estimator() -> None:
    pytest.importorskip("rclpy", reason="no ROS: run `make test`")
    code = (
        "import sys, emoflow_ros.node.estimator_node, msg_adapters; "
        "lattice = ['emoflow_ros.core.lattice.' + name for name in ('estimator', 'kernels')]; "
        "print(sorted({'torch', *lattice} & set(sys.modules)))"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert shown.stdout.strip() == "[]", shown.stderr


def test_maintainer_has_a_valid_address() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    maintainer = manifest.find("maintainer")
    assert maintainer is not None
    assert re.fullmatch(r"[^@\s]+@[^@\s]+\.[^@\s]+", maintainer.get("email", ""))
