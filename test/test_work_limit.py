"""What bounds a test: its work, in processor time, and not the time that it takes."""

import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

import pytest
from hypothesis import settings

type Bound = Callable[[float], AbstractContextManager[None]]


@pytest.fixture
def bounded_work(request: pytest.FixtureRequest) -> Bound:
    """What conftest.py puts around every test."""
    plugins = request.config.pluginmanager.get_plugins()
    [found] = [plugin.bounded_work for plugin in plugins if hasattr(plugin, "bounded_work")]
    return found


def work(seconds: float) -> None:
    until = time.process_time() + seconds
    while time.process_time() < until:
        pass


def test_examples_of_hypothesis_have_no_limit_of_time() -> None:
    assert settings.default is not None
    assert settings.default.deadline is None
    assert settings(max_examples=3).deadline is None


def test_waiting_is_no_work(bounded_work: Bound) -> None:
    with bounded_work(0.1):
        time.sleep(0.3)


def test_work_beyond_the_limit_fails(bounded_work: Bound) -> None:
    with (
        pytest.raises(pytest.fail.Exception, match=r"s of processor time, at most 0\.1 s are all"),
        bounded_work(0.1),
    ):
        work(0.2)


def test_work_of_children_counts(bounded_work: Bound) -> None:
    busy = "import time\nwhile time.process_time() < 0.5: pass"
    with pytest.raises(pytest.fail.Exception, match="processor time"), bounded_work(0.3):
        subprocess.run([sys.executable, "-c", busy], check=True)
