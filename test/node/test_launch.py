"""The launch files' arguments, as parameters of the node and what is started beside it.

The packages launch and launch_ros are replaced whole, because the wheels have none. So these tests
cannot see whether launch accepts the calls and their keywords, how it substitutes and overrides
arguments, whether an included file gets them, and whether the processes start and end.
"""

import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.config import load_config
from emoflow_ros.errors import InputError
from emoflow_ros.node.settings import NodeOptions, Settings

ROOT = Path(__file__).resolve().parents[2]
CALIBRATION = ROOT / "config" / "calibration" / "mvsec_indoor_flying.yaml"

type Start = Callable[..., list[Any]]


class Argument:
    """Stands for launch's LaunchConfiguration, with a dict for the context."""

    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: dict[str, str]) -> str:
        return context[self.name]


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], dict[str, Any]]:
    """Run a launch file without the launch packages."""
    stand_ins = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": lambda name, **kwargs: name,
            "ExecuteProcess": SimpleNamespace,
            "IncludeLaunchDescription": lambda source: source,
            "OpaqueFunction": lambda function: function,
        },
        "launch.launch_description_sources": {"PythonLaunchDescriptionSource": Path},
        "launch.substitutions": {"LaunchConfiguration": Argument},
        "launch_ros": {},
        "launch_ros.actions": {"Node": SimpleNamespace},
    }
    for module, names in stand_ins.items():
        fake: Any = ModuleType(module)
        for name, stand_in in names.items():
            setattr(fake, name, stand_in)
        monkeypatch.setitem(sys.modules, module, fake)
    return lambda file: runpy.run_path(str(ROOT / "launch" / file))


@pytest.fixture
def start(launched: Callable[[str], dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> Start:
    """Start the estimator with these arguments and return the nodes."""
    namespace = launched("estimator.launch.py")
    # DeclareLaunchArgument takes its name by position.
    defaults = {name: default for name, (default, _) in namespace["ARGUMENTS"].items()}
    return lambda **arguments: namespace["_start"](defaults | arguments)


@pytest.fixture
def replay(launched: Callable[[str], dict[str, Any]]) -> Start:
    namespace = launched("replay.launch.py")
    defaults = {name: default for name, (default, _) in namespace["ARGUMENTS"].items()}
    defaults |= {"use_sim_time": "false", "namespace": "", "bag": "my.bag"}
    return lambda **arguments: namespace["_start"](defaults | arguments)


def test_speed_is_a_scale_only_when_it_is_given(start: Start) -> None:
    [node] = start()
    assert not {name for name in node.parameters[0] if name.startswith("scale.")}
    [node] = start(speed="2.5")
    given = node.parameters[0]
    assert (given["scale.source"], given["scale.speed"]) == ("parameter", 2.5)


def test_twist_rate_is_passed_as_a_number(start: Start) -> None:
    assert start()[0].parameters[0]["output.twist_rate"] == 60.0
    assert start(twist_rate="200")[0].parameters[0]["output.twist_rate"] == 200.0


def test_topics_are_remapped_only_when_they_are_given(start: Start) -> None:
    assert start()[0].remappings == []
    started = start(events="/cam/events", camera_info="/cam/info", imu="/imu/data")[0]
    assert started.remappings == [
        ("events", "/cam/events"),
        ("camera_info", "/cam/info"),
        ("imu", "/imu/data"),
    ]
    assert started.parameters[0]["imu.use"] == "auto"


def test_arguments_become_parameters_that_the_node_has(start: Start) -> None:
    [node] = start(speed="2.0", twist_rate="100", frame="cam", calibration_file=str(CALIBRATION))
    given = {name: value for source in node.parameters for name, value in source.items()}
    assert given.pop("use_sim_time") is False
    settings = Settings(NodeOptions(), load_config(given["profile"])).changed(given)
    assert settings.node.scale.speed == 2.0
    assert settings.node.camera.frame_id == "cam"


def test_executables_are_those_of_the_package(start: Start, replay: Start) -> None:
    described = (ROOT / "setup.py").read_text()
    for node in (*start(), *replay()):
        assert node.package == "emoflow_ros"
        assert f'f"{node.executable} = {{PACKAGE}}.' in described


def test_simulated_time_and_profile(start: Start) -> None:
    given = start(use_sim_time="true", profile="rigid")[0].parameters[0]
    assert (given["use_sim_time"], given["profile"]) == (True, "rigid")


def test_camera_counts_before_the_parameter_file_and_that_before_the_rest(
    start: Start, tmp_path: Path
) -> None:
    own = tmp_path / "my.yaml"
    own.touch()
    [node] = start(params_file=str(own), calibration_file=str(CALIBRATION), frame="cam")
    assert node.parameters[1:] == [
        str(own),
        {"camera.calibration_file": str(CALIBRATION), "camera.frame_id": "cam"},
    ]


@pytest.mark.parametrize("sensor", ["mvsec", "dsec", "davis240", "evk4"])
def test_sensors_are_parameter_files_by_name(start: Start, sensor: str) -> None:
    [node] = start(params_file=sensor)
    assert node.parameters[1:] == [str(ROOT / "config" / "sensors" / f"{sensor}.yaml")]
    assert Path(node.parameters[1]).is_file()


def test_two_instances_differ_by_their_namespace(start: Start) -> None:
    left, right = (start(namespace=name)[0] for name in ("left", "right"))
    assert (left.namespace, right.namespace) == ("left", "right")
    assert left.executable == right.executable == "estimator"


@pytest.mark.parametrize(
    ("argument", "text", "line"),
    [
        ("rviz", "true", "the package rviz2 is not installed; install ros-jazzy-rviz2 or leave"),
        ("rviz", "1", "'1' is neither true nor false; use one of the two"),
        ("use_sim_time", "yes", "'yes' is neither true nor false; use one of the two"),
        ("twist_rate", "abc", "'abc' is not a number; give one, as in 10.0"),
        ("speed", "fast", "'fast' is not a number; give one, as in 10.0"),
        ("speed", "nan", "'nan' is not a number; give one, as in 10.0"),
        ("profile", "fast", "unknown profile 'fast'; use one of paper, paper_dsec"),
        (
            "params_file",
            "mvsek",
            "no file 'mvsek'; give a path or one of davis240, dsec, evk4, mvsec",
        ),
    ],
)
def test_bad_argument_starts_nothing(
    start: Start, monkeypatch: pytest.MonkeyPatch, argument: str, text: str, line: str
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/nowhere")
    with pytest.raises(InputError) as caught:
        start(**{argument: text})
    assert str(caught.value).startswith(f"{argument}: {line}")


@pytest.mark.parametrize("text", ["no.yaml", "file:///no.yaml"])
def test_calibration_that_cannot_be_read_starts_nothing(start: Start, text: str) -> None:
    with pytest.raises(InputError, match=r"no\.yaml: no such file or directory; give a calib"):
        start(calibration_file=text)


def test_bag_that_is_not_there_is_refused_before_the_estimator_starts(
    launched: Callable[[str], dict[str, Any]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    namespace = launched("replay.launch.py")
    description = namespace["generate_launch_description"]()
    include = ROOT / "launch" / "estimator.launch.py"
    [check] = [p for p in description[: description.index(include)] if callable(p)]
    with pytest.raises(InputError, match=r"^bag: no file or folder 'no\.bag'; check the path$"):
        check({"bag": "no.bag"})
    check({"bag": str(tmp_path)})


def test_replay_that_fails_ends_the_estimator(replay: Start) -> None:
    [node] = replay()
    with pytest.raises(InputError, match=r"^replay: ended with exit code 2; what it said last te"):
        node.on_exit(SimpleNamespace(returncode=2), None)
    node.on_exit(SimpleNamespace(returncode=0), None)


@pytest.mark.parametrize("file", ["estimator.launch.py", "replay.launch.py", "robot.launch.py"])
def test_estimator_that_fails_ends_its_own_launch_and_no_other(
    start: Start, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    [node] = start()
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", f"/opt/share/launch/{file}"])
    node.on_exit(SimpleNamespace(returncode=0), None)
    if file == "robot.launch.py":
        node.on_exit(SimpleNamespace(returncode=2), None)
        return
    with pytest.raises(InputError, match=r"^estimator: ended with exit code 2; what it said"):
        node.on_exit(SimpleNamespace(returncode=2), None)


@pytest.mark.parametrize(
    ("file", "name", "nearest"),
    [
        ("estimator.launch.py", "evnts", "events"),
        ("estimator.launch.py", "bag", "rviz"),
        ("replay.launch.py", "baag", "bag"),
        ("replay.launch.py", "twistrate", "twist_rate"),
    ],
)
def test_unknown_argument_is_refused_with_the_nearest(
    launched: Callable[[str], dict[str, Any]],
    start: Start,
    monkeypatch: pytest.MonkeyPatch,
    file: str,
    name: str,
    nearest: str,
) -> None:
    check = launched("replay.launch.py")["_check"]
    begin = {"estimator.launch.py": start, "replay.launch.py": lambda: check({"bag": "/"})}[file]
    known = ["ros2", "launch", "emoflow_ros", file, "events:=/a", "frame:=b"]
    monkeypatch.setattr(sys, "argv", known)
    begin()
    monkeypatch.setattr(sys, "argv", [*known, f"{name}:=/cam"])
    with pytest.raises(InputError, match=f"^{name}: no such option(, the nearest is {nearest})?;"):
        begin()
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_robot", "all.py", f"{name}:=/cam"])
    begin()  # it is that file's


def test_rviz_is_started_with_the_layout_when_it_is_wanted(
    start: Start, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "rviz2").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert len(start()) == 1
    _, rviz = start(rviz="true", frame="cam", namespace="left", use_sim_time="true")
    assert (rviz.package, rviz.executable, rviz.namespace) == ("rviz2", "rviz2", "left")
    flag, layout, *frame = rviz.arguments
    assert flag == "-d"
    assert frame == ["-f", "cam"]
    assert rviz.parameters == [{"use_sim_time": True}]
    displays = yaml.safe_load(Path(layout).read_text())["Visualization Manager"]["Displays"]
    shown = {display["Topic"]["Value"] for display in displays}
    assert {topic for topic, _ in rviz.remappings} == shown
    assert all(topic == f"/{relative}" for topic, relative in rviz.remappings)


def test_replay_plays_the_bag_and_is_the_clock_where_time_is_simulated(replay: Start) -> None:
    [node] = replay(rate="0.5")
    assert node.executable == "replay"
    assert node.arguments == ["my.bag", "--rate", "0.5", "--wait", "60"]
    [node] = replay(use_sim_time="true")
    assert node.arguments[-1] == "--clock"
    known = (ROOT / "emoflow_ros" / "commands" / "replay.py").read_text()
    assert all(f'"{flag}"' in known for flag in node.arguments if flag.startswith("--"))


@pytest.mark.parametrize("namespace", ["", "left", "/left"])
def test_replay_records_what_the_estimator_says(replay: Start, namespace: str) -> None:
    _, recorder = replay(record="answers", namespace=namespace)
    prefix = "/left" if namespace else ""
    assert recorder.cmd == [
        *("ros2", "bag", "record", "--output", "answers"),
        f"{prefix}/egomotion/twist",
        f"{prefix}/egomotion/twist_now",
        f"{prefix}/egomotion/twist_with_covariance",
        f"{prefix}/egomotion/status",
        "/diagnostics",
    ]


def test_replay_includes_the_estimator_of_the_same_folder(
    launched: Callable[[str], dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    declared: list[str] = []
    actions: Any = sys.modules["launch.actions"]
    monkeypatch.setattr(
        actions, "DeclareLaunchArgument", lambda name, **kwargs: declared.append(name)
    )
    monkeypatch.setattr(sys.modules["launch"], "LaunchDescription", lambda parts: parts)
    description = launched("replay.launch.py")["generate_launch_description"]()
    assert ROOT / "launch" / "estimator.launch.py" in description
    assert declared == ["bag", "rate", "wait", "record"]
