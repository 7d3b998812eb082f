"""What comes from outside is data: not unpickled, not evaluated, bounded, and not written to."""

import ast
import multiprocessing
import os
import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emoflow_ros.config import Config, load_config
from emoflow_ros.core.geometry.calibration import load_calibration
from emoflow_ros.core.geometry.camera import MAX_PIXELS, Camera
from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import WindowPolicy
from emoflow_ros.errors import InputError
from emoflow_ros.node.channel import Channel
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_input import EventInput
from emoflow_ros.node.supervisor import Supervisor
from emoflow_ros.simulation.messages import EVENT_ARRAY

ROOT = Path(__file__).resolve().parents[2]
# Checkpoints of an evaluation are read by the machine that wrote them, never by the node.
OWN_PICKLES = ROOT / "emoflow_ros" / "evaluation" / "run_progress.py"
SOURCES = sorted(
    {p for part in ("emoflow_ros", "msg_adapters") for p in (ROOT / part).rglob("*.py")}
    - {OWN_PICKLES}
)
CODE_FROM_DATA = {"pickle", "cPickle", "dill", "marshal", "shelve", "joblib", "cloudpickle"}
CALIBRATION = """\
image_width: {width}
image_height: {height}
camera_matrix: {{data: [50.0, 0, 32.0, 0, 50.0, 24.0, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{data: [0, 0, 0, 0, 0]}}
"""


def imported(node: ast.AST) -> set[str]:
    if isinstance(node, ast.Import):
        return {alias.name.partition(".")[0] for alias in node.names}
    if isinstance(node, ast.ImportFrom) and node.module:
        return {node.module.partition(".")[0]}
    return set()


def called(node: ast.AST) -> str:
    return ast.unparse(node.func) if isinstance(node, ast.Call) else ""


def keywords(node: ast.AST) -> dict[str, str]:
    if not isinstance(node, ast.Call):
        return {}
    return {k.arg: ast.unparse(k.value) for k in node.keywords if k.arg}


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_source_makes_code_of_data(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        assert not imported(node) & CODE_FROM_DATA
        call = called(node)
        assert call not in ("eval", "exec", "yaml.load", "yaml.unsafe_load", "yaml.full_load")
        assert keywords(node).get("allow_pickle", "False") == "False"
        if call == "torch.load":
            assert keywords(node)["weights_only"] == "True"
        # A connection's own `send` and `recv` pickle; `send_bytes` and `recv_bytes` do not.
        assert not call.endswith(("connection.send", "connection.recv"))


class Bomb:
    """Would make a folder if it were unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.target),)


def test_pickle_on_the_channel_is_not_unpickled(tmp_path: Path) -> None:
    ours, theirs = multiprocessing.Pipe()
    theirs.send_bytes(pickle.dumps(Bomb(tmp_path / "exploded")))
    with pytest.raises(ValueError, match=r"codec|Expecting"):
        Channel(ours).receive()
    assert not (tmp_path / "exploded").exists()


def test_objects_do_not_go_through_the_channel() -> None:
    ours, theirs = multiprocessing.Pipe()
    with pytest.raises((TypeError, ValueError)):
        Channel(ours).send({}, {"objects": np.array([{}], object)})
    with pytest.raises(TypeError):
        Channel(theirs).send({"code": print}, {})


class Eavesdropper:
    """Notes what a supervisor sends and answers nothing."""

    def __init__(self) -> None:
        self.headers: list[dict[str, Any]] = []

    def request(self, header: dict[str, Any], *rest: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        self.headers.append(header)
        return {}, {}


def test_worker_is_sent_names_and_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Eavesdropper()
    monkeypatch.setattr("emoflow_ros.node.supervisor.WorkerProcess", lambda *args: wire)
    supervisor = Supervisor(capacity=1, timeout_s=1.0, may_use_cpu=False, wake=lambda: None)
    supervisor.check(Config())
    [header] = wire.headers
    assert header["kind"] == "configure"
    values = [*header["config"].values(), *header["camera"].values()]
    assert {type(v) for v in values} <= {str, int, float, bool, tuple}


def test_message_beyond_the_bound_is_left_out_unread() -> None:
    statistics = Statistics()
    warnings: list[str] = []
    events = EventInput(
        EVENT_ARRAY,
        EventBudget(WindowPolicy(), 30_000),
        timestamps=Timestamps.FUSED,
        frame_id="",
        statistics=statistics,
        warn=warnings.append,
    )
    events.take(bytes(2**24 + 1))
    assert events.cut() == []
    assert statistics.counts["malformed_messages"] == 1
    assert warnings == ["a malformed message is left out: 16777217 bytes, more than 16777216"]


def test_camera_beyond_the_bound_is_refused(tmp_path: Path) -> None:
    Camera(4096, MAX_PIXELS // 4096, 50.0, 50.0, 32.0, 24.0)
    with pytest.raises(InputError, match="size 4097x4096; give the sensor's: at most 16777216"):
        Camera(4097, 4096, 50.0, 50.0, 32.0, 24.0)
    path = tmp_path / "camera.yaml"
    path.write_text(CALIBRATION.format(width=2**31, height=2**31))
    with pytest.raises(InputError, match="size 2147483648x2147483648"):
        load_calibration(path)


_opened: list[tuple[str, int]] | None = None


def _note_open(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _opened is not None:
        _opened.append((str(arguments[0]), arguments[2]))


@pytest.fixture
def opened() -> Iterator[list[tuple[str, int]]]:
    """What is opened, with the flags of open(2)."""
    global _opened
    sys.addaudithook(_note_open)  # stays for ever, and notes nothing after this test
    _opened = []
    yield _opened
    _opened = None


def test_files_from_parameters_are_opened_for_reading_only(
    tmp_path: Path, opened: list[tuple[str, int]]
) -> None:
    calibration, parameters = tmp_path / "camera.yaml", tmp_path / "params.yaml"
    calibration.write_text(CALIBRATION.format(width=64, height=48))
    parameters.write_text("window.duration_ms: 50.0\n")
    opened.clear()
    assert load_calibration(calibration).width == 64
    assert load_config("realtime", params_file=parameters).window.duration_ms == 50.0
    flags = dict(opened)
    assert {str(calibration), str(parameters)} <= set(flags)
    assert not any(f & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC) for f in flags.values())
