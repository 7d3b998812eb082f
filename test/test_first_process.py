"""The first process of a run of the tests compiles; only tests that need nothing of it go on."""

import fcntl
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
WAIT_S = 600.0


@pytest.fixture
def conftest(request: pytest.FixtureRequest) -> Any:
    plugins = request.config.pluginmanager.get_plugins()
    [found] = [plugin for plugin in plugins if hasattr(plugin, "FIRST_PROCESS")]
    return found


def item(path: str) -> SimpleNamespace:
    return SimpleNamespace(path=ROOT / "test" / path)


def test_tests_that_compile_nothing_come_first_and_then_those_that_wait(conftest: Any) -> None:
    names = ["core/a.py", "integration/b.py", "msg_adapters/c.py", "test_d.py", "msg_adapters/e.py"]
    items = [item(name) for name in names]
    conftest.pytest_collection_modifyitems(items)
    found = [str(one.path.relative_to(ROOT / "test")) for one in items]
    assert found == ["msg_adapters/c.py", "msg_adapters/e.py", names[1], names[0], names[3]]


def test_a_test_waits_until_the_first_process_has_ended(
    conftest: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(conftest.FIRST_PROCESS, str(tmp_path))
    over = threading.Event()

    def begin() -> None:
        conftest.wait_until_compiled(item("core/a.py"))
        over.set()

    with (tmp_path / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        conftest.wait_until_compiled(item("msg_adapters/c.py"))
        waiting = threading.Thread(target=begin)
        waiting.start()
        assert not over.wait(0.2)
    assert over.wait(WAIT_S)
    waiting.join()
