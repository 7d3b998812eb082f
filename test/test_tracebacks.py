"""Where the traceback of an error that was survived is found."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from emoflow_ros.errors import keep_traceback
from emoflow_ros.evaluation.window_run import attempt


def fail() -> ValueError:
    try:
        raise ValueError("a bad window")
    except ValueError as error:
        return error


@pytest.mark.parametrize(
    ("variable", "folder"), [("ROS_LOG_DIR", "."), ("ROS_HOME", "log"), ("HOME", ".ros/log")]
)
def test_traceback_is_in_the_folder_of_logs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, folder: str
) -> None:
    for name in ("ROS_LOG_DIR", "ROS_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    path = tmp_path / folder / "emoflow_ros_tracebacks.log"
    assert keep_traceback(fail()) == f"; traceback in {path}"
    assert keep_traceback(fail()) == f"; traceback in {path}"
    text = path.read_text()
    assert text.count("in fail\n") == 2
    assert text.count("ValueError: a bad window\n") == 2


def test_file_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    path = tmp_path / "emoflow_ros_tracebacks.log"
    path.write_text("x" * (1 << 20) + "y")
    keep_traceback(fail())
    assert path.stat().st_size < 2000


def test_folder_that_cannot_be_written_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "file"))
    assert keep_traceback(fail()) == ""


def test_failed_window_of_an_evaluation_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def estimate(window: object) -> None:
        raise ValueError("a bad window")

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    estimator = SimpleNamespace(estimate=estimate, reset=lambda: None)
    path = tmp_path / "emoflow_ros_tracebacks.log"
    _, note = attempt(estimator, SimpleNamespace(t_start=0, t_end=2))
    assert note == f"ValueError: a bad window; traceback in {path}"
    assert "in estimate\n" in path.read_text()
