"""--window-ms and --stride-ms: which windows come of them, up to the recordings of ECD."""

import json

import pytest

from emoflow_ros.commands import evaluate as evaluate_command
from emoflow_ros.commands import label as label_command
from emoflow_ros.config import load_config
from emoflow_ros.evaluation.recording_options import overrides

MOST = "window.max_displacement_px"


def windows_of(parse, *arguments):
    """Parse a command line and return (duration, stride, bound) of its windows, ms and px."""
    options = parse(["x", *arguments])
    policy = load_config(options.profile, overrides(options)).window
    return policy.duration_ms, policy.stride_ns / 1e6, policy.max_displacement_px


def parse_label(arguments):
    return label_command.parse([*arguments, "--out", "labels"])


@pytest.mark.parametrize("parse", [evaluate_command.parse, parse_label])
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], (135.0, 67.5, 20.0)),
        (["--window-ms", "98"], (98.0, 98.0, 0.0)),
        (["--window-ms", "200"], (200.0, 200.0, 0.0)),
        (["--window-ms", "98", "--stride-ms", "49"], (98.0, 49.0, 0.0)),
        (["--stride-ms", "30"], (135.0, 30.0, 20.0)),
        (["--window-ms", "98", "--set", f"{MOST}=20"], (98.0, 98.0, 20.0)),
        (["--window-ms", "98", "--set", "window.stride_ms=10"], (98.0, 10.0, 0.0)),
        (["--set", "window.duration_ms=98"], (98.0, 67.5, 20.0)),
        (["--window-ms", "98", "--profile", "paper"], (98.0, 98.0, 0.0)),
    ],
)
def test_window_ms_takes_whole_windows_one_after_another(parse, arguments, expected):
    assert windows_of(parse, *arguments) == expected


@pytest.mark.parametrize(("name", "window_ms"), [("shapes_rotation", 98), ("dynamic_rotation", 21)])
def test_axis_of_the_rotation_in_ecd(call, tmp_path, shared_data, name, window_ms):
    """The command that a user types for one short window, on the whole path to the report."""
    folder = shared_data / "ecd" / name
    if not folder.is_dir():
        pytest.skip(f"no recording {folder}")
    options = ("--window-ms", window_ms, "--out", tmp_path)
    assert call(folder, *options) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["configuration"][MOST] == 0
    (window,) = report["windows"]
    assert window["t_end_s"] - window["t_start_s"] == pytest.approx(window_ms / 1e3)
    assert report["summary"]["axis_error_deg"]["value"] <= 4
