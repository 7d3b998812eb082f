"""The parameter files of sensors, against the table of parameters; what is installed."""

import runpy
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.calibration import load_calibration
from emoflow_ros.errors import InputError
from emoflow_ros.node import calibration_url as module
from emoflow_ros.node.calibration_url import calibration_path
from emoflow_ros.node.settings import NodeOptions, Settings

ROOT = Path(__file__).resolve().parents[2]
SENSORS = ("mvsec", "dsec", "davis240", "evk4")


def flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            found |= flat(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found


def parameters(sensor: str) -> dict[str, Any]:
    document = yaml.safe_load((ROOT / "config" / "sensors" / f"{sensor}.yaml").read_text())
    assert list(document) == ["/**"]
    assert list(document["/**"]) == ["ros__parameters"]
    return flat(document["/**"]["ros__parameters"])


def settings(given: dict[str, Any]) -> Settings:
    """What the node makes of them."""
    return Settings(NodeOptions(), load_config(given["profile"])).changed(given)


@pytest.mark.parametrize("sensor", SENSORS)
def test_sensor_file_leaves_the_estimator_as_it_was_measured(sensor: str) -> None:
    """Its pixels are those of the working image, whatever the sensor."""
    config, profile = settings(parameters(sensor)).config, load_config("realtime")
    assert (config.window, config.estimator) == (profile.window, profile.estimator)


@pytest.mark.parametrize("sensor", SENSORS)
def test_name_that_no_parameter_has_is_refused(sensor: str) -> None:
    with pytest.raises(InputError, match=r"estimator\.spacing: no such option"):
        settings(parameters(sensor) | {"estimator.spacing": 10.0})


def test_there_is_no_other_sensor_file() -> None:
    assert {p.stem for p in (ROOT / "config" / "sensors").iterdir()} == set(SENSORS)


@pytest.mark.parametrize(
    ("name", "fx", "k4"),
    [
        ("mvsec_indoor_flying", 226.38018519795807, 0.021500973881459395),
        ("mvsec_outdoor_day", 223.9940010790056, 0.0069204143687187645),
    ],
)
def test_calibrations_hold_what_was_published(name: str, fx: float, k4: float) -> None:
    camera = load_calibration(ROOT / "config" / "calibration" / f"{name}.yaml")
    assert (camera.width, camera.height, camera.model) == (346, 260, "equidistant")
    assert (camera.fx, camera.distortion[3]) == (fx, k4)


def test_calibration_of_the_sensor_file_is_found_in_the_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shares = {"emoflow_ros": str(ROOT)}
    monkeypatch.setattr(module, "get_package_share_directory", shares.__getitem__)
    path = calibration_path(settings(parameters("mvsec")).node.camera.calibration_file)
    assert path == ROOT / "config" / "calibration" / "mvsec_indoor_flying.yaml"
    assert path.is_file()


def test_calibrations_may_be_paths_and_urls_of_files() -> None:
    assert calibration_path("camera.yaml") == Path("camera.yaml")
    assert calibration_path("file:///etc/camera.yaml") == Path("/etc/camera.yaml")


def test_url_of_a_package_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match="the package odd_pkg is not installed"):
        calibration_path("package://odd_pkg/camera.yaml")


def test_url_does_not_leave_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "get_package_share_directory", lambda name: "/share")
    with pytest.raises(InputError, match="leaves the package's folder"):
        calibration_path("package://emoflow_ros/../../etc/passwd")


def test_everything_in_config_and_launch_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    described: dict[str, Any] = {}
    monkeypatch.setattr("setuptools.setup", lambda **kwargs: described.update(kwargs))
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py")
    installed = {
        (folder.removeprefix("share/emoflow_ros/"), file)
        for folder, files in described["data_files"]
        for file in files
    }
    wanted = {p for part in ("config", "launch") for p in Path(part).rglob("*") if p.is_file()}
    wanted = {p for p in wanted if "__pycache__" not in p.parts}
    assert {(str(p.parent), str(p)) for p in wanted} <= installed
