"""The real-time estimator and its node where PyTorch is not installed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Python runs it first, in child processes, too: torch is not found, as where it is not installed.
HIDE = """
from functools import partial
from importlib.machinery import PathFinder


def find_spec(find, name, path=None, target=None):
    return None if name in ("torch", "torchdiffeq") else find(name, path, target)


PathFinder.find_spec = partial(find_spec, PathFinder.find_spec)
"""
NODE_TESTS = ("test_supervisor.py", "test_worker_faults.py", "test_pipeline.py")


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    (tmp_path / "sitecustomize.py").write_text(HIDE)
    path = os.pathsep.join([str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path}


def run(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True, text=True, cwd=ROOT, env=environment, check=False,
    )  # fmt: skip


def test_torch_is_hidden(environment: dict[str, str]) -> None:
    found = run(environment, "-c", "import torch")
    assert "ModuleNotFoundError: No module named 'torch'" in found.stderr


@pytest.mark.parametrize(("arguments", "line"), [
    (("--profile", "paper"),
     "error: profile: paper needs PyTorch; "
     "install it (pip install torch torchdiffeq), or use the profile realtime"),
    (("--set", "estimator.device=cuda"),
     "error: estimator.device: CUDA needs PyTorch; "
     "install it (pip install torch torchdiffeq), or use cpu"),
])  # fmt: skip
def test_what_needs_torch_says_so_in_one_line(
    environment: dict[str, str], tmp_path: Path, arguments: tuple[str, ...], line: str
) -> None:
    command = "import sys; from emoflow_ros.cli import {0}; sys.exit({0}())"
    made = run(
        environment, "-c", command.format("simulate"), "calm", "--duration", "0.3",
        "--format", "rosbag1", "--out", str(tmp_path / "calm"),
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    [bag] = (tmp_path / "calm").glob("*_data.bag")
    found = run(environment, "-c", command.format("evaluate"), str(bag), *arguments)
    assert found.returncode != 0
    assert found.stderr.strip().splitlines()[-1] == line
    assert "Traceback" not in found.stderr


def test_the_node_s_tests_pass(environment: dict[str, str]) -> None:
    pytest.importorskip("rclpy", reason="no ROS: run `make test`")
    files = [f"test/node/{name}" for name in NODE_TESTS]
    found = run(environment, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files)
    assert found.returncode == 0, found.stdout[-3000:]
    assert " passed" in found.stdout.splitlines()[-1]
