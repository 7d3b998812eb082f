"""Makes the helpers of these tests importable; the command `evaluate`."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from emoflow_ros.commands import evaluate as evaluate_command

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Call `evaluate` with these arguments; its exit code."""

    def run(*arguments: object) -> int:
        monkeypatch.setattr("sys.argv", ["evaluate", *map(str, arguments)])
        return evaluate_command.main()

    return run
