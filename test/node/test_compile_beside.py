"""The process that compiles the memory of positions while the worker compiles the rest."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from test_warm_up import WARM_UP, run

from emoflow_ros.node import compile_beside

NEEDED = """
import sys

from numba.core.dispatcher import Dispatcher

from emoflow_ros.factory import make_estimator
from emoflow_ros.node.warm_up import warm_up, warm_up_memory

def of_memory():
    return {
        f"{module}.{name}": len(value.signatures)
        for module in list(sys.modules) if ".front_end." in module or ".back_end." in module
        for name, value in vars(sys.modules[module]).items()
        if isinstance(value, Dispatcher) and value.py_func.__module__ == module
    }

warm_up_memory()
beside = of_memory()
warm_up(make_estimator)
print(sum(map(bool, beside.values())), of_memory() == beside)
"""


def test_it_compiles_all_that_the_worker_needs_of_the_memory() -> None:
    run(WARM_UP)  # to find it on disk
    count, same = run(NEEDED).split()
    assert int(count) >= 15  # entered from Python; what these call is compiled into them
    assert same == "True"


def files(folder: Path, of: str) -> list[Path]:
    return list(folder.rglob(f"{of}*.nbc"))


def test_it_keeps_what_it_compiles_and_ends_with_its_input(tmp_path: Path) -> None:
    """As when the worker is killed: the kernel closes the pipe."""
    process = subprocess.Popen(
        [sys.executable, "-m", compile_beside.__name__],
        stdin=subprocess.PIPE,
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
    )
    try:
        while not files(tmp_path, "patch_kernels."):
            assert process.poll() is None
            time.sleep(0.05)
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0
    assert not files(tmp_path, "descent.descend")  # one of the last


def test_it_ends_by_itself_when_all_is_compiled() -> None:
    run(WARM_UP)
    command = [sys.executable, "-m", compile_beside.__name__]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None and process.stderr.read() == b""
        assert process.wait() == 0


class Started:
    """Stands for `subprocess.Popen`."""

    def __init__(self) -> None:
        self.commands: list[list[str]] = []
        self.ended, self.closed = 0, False

    def __call__(self, command: list[str], **options: Any) -> "Started":
        self.commands.append(command)
        return self

    @property
    def stdin(self) -> "Started":
        return self

    def close(self) -> None:
        self.closed = True

    def kill(self) -> None:
        self.ended += 1

    def wait(self, seconds: float) -> None:
        assert self.closed and self.ended


@pytest.mark.parametrize(("cores", "started"), [({0}, 0), ({0, 1}, 1)])
def test_it_is_started_where_a_core_is_free_and_ended(
    monkeypatch: pytest.MonkeyPatch, cores: set[int], started: int
) -> None:
    popen = Started()
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: cores)
    monkeypatch.setattr(subprocess, "Popen", popen)
    with compile_beside.compiled_beside():
        pass
    assert not popen.commands
    with compile_beside.compiled_beside() as begin:
        begin()
        assert len(popen.commands) == started and not popen.ended
        assert all("-P" in command for command in popen.commands)
    assert popen.ended == started


def test_a_process_that_cannot_be_started_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with compile_beside.compiled_beside() as begin:
        begin()
