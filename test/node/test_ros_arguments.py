"""Bad ROS arguments: one line that says what, what is wrong and what to do."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.errors import InputError
from emoflow_ros.node.ros_arguments import own_arguments, refused_in_one_line, refused_values

FILE_FIX = "give a YAML file of ROS parameters, as `ros2 param dump` writes it"
REMAP = "not of the form FROM:=TO with two ROS names; write -r FROM:=TO, as in -r events:="


def refusal(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> str:
    monkeypatch.setattr(sys, "argv", ["estimator", "--ros-args", *arguments])
    with pytest.raises(InputError) as caught:
        own_arguments("estimator")
    line = str(caught.value)
    assert "\n" not in line
    assert ".c:" not in line  # no places in the source of rcl
    return line


def test_own_arguments_are_those_before_the_ones_for_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["replay", "bag", "--wait", "--ros-args", "-r", "a:=b", "--", "--clock"]
    monkeypatch.setattr(sys, "argv", given)
    assert own_arguments("estimator") == ["bag", "--wait", "--clock"]


@pytest.mark.parametrize(
    ("arguments", "start"),
    [
        (("-p", "nocolon"), "-p nocolon: not of the form NAME:=VALUE; write -p NAME:=VALUE"),
        (("-r", "bad"), f"-r bad: {REMAP}"),
        (("-r", "events:=a//b"), f"-r events:=a//b: {REMAP}"),
        (("--log-level", "nope"), "--log-level nope: not a log level; use debug, info, warn"),
        (("--nosuchflag",), "--ros-args: unknown argument --nosuchflag; correct what follows"),
        (("--params-file",), "--ros-args: Couldn't parse trailing --params-file flag. No file"),
        (
            ("--params-file", "/nope.yaml"),
            f"--params-file /nope.yaml: no such file or directory; {FILE_FIX}",
        ),
    ],
)
def test_bad_argument_is_named(
    monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], start: str
) -> None:
    assert refusal(monkeypatch, *arguments).startswith(start)


@pytest.mark.parametrize("text", ["a: [1\n b: 2\n", "estimator:\n  window: 3\n", "\t- x: {\n"])
def test_file_without_parameters_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str
) -> None:
    path = tmp_path / "my file.yaml"
    path.write_text(text)
    line = refusal(monkeypatch, "--params-file", str(path))
    assert line.startswith(f"--params-file {path}: holds no parameters (")
    assert line.endswith(f"); {FILE_FIX}")


def test_folder_is_no_parameter_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    line = refusal(monkeypatch, "--params-file", str(tmp_path))
    assert line == f"--params-file {tmp_path}: is a directory; {FILE_FIX}"


def test_only_the_known_errors_are_the_users() -> None:
    with pytest.raises(RuntimeError, match=r"^a bug$"), refused_in_one_line():
        raise RuntimeError("a bug")
    with pytest.raises(KeyError), refused_values():
        raise KeyError("a bug")


@pytest.mark.parametrize("text", ["", "# only a comment\n", "estimator:\n  ros__parameters: {}\n"])
def test_file_that_holds_no_parameters_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str
) -> None:
    """rcl takes it without a word."""
    path = tmp_path / "empty.yaml"
    path.write_text(text)
    line = refusal(monkeypatch, "--params-file", str(path))
    assert line == f"--params-file {path}: holds no parameters; {FILE_FIX}"


@pytest.mark.parametrize(
    ("nodes", "others"),
    [
        ("/estimator:", ""),
        ("estimator:", ""),
        ("/**:", ""),
        ("/left/estimator:", ""),
        ("left:\n  estimator:", ""),
        ("/estimator_node:", "/estimator_node"),
        ("left:\n  camera:", "/left/camera"),
    ],
)
def test_file_for_other_nodes_is_named(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    nodes: str,
    others: str,
) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(f"{nodes}\n    ros__parameters:\n      use_sim_time: true\n")
    given = ["estimator", "--ros-args", "--params-file", str(path)]
    monkeypatch.setattr(sys, "argv", given)
    assert own_arguments("estimator") == []
    line = f"warning: --params-file {path}: holds nothing for a node called estimator, only for "
    assert capsys.readouterr().err == (f"{line}{others}\n" if others else "")
    monkeypatch.setattr(sys, "argv", [*given, "-r", "__node:=estimator_node"])
    own_arguments("estimator")
    assert bool(capsys.readouterr().err) is (others != "/estimator_node" and nodes != "/**:")
