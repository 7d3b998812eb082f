"""The executable: exit codes and the one line for bad input."""

import pytest

from emoflow_ros.commands import evaluate as evaluate_command
from emoflow_ros.evaluation.recording_options import overrides


def ecd(path, events, calibration="20 20 16 12 0 0 0 0 0"):
    path.mkdir()
    (path / "events.txt").write_text(events)
    if calibration:
        (path / "calib.txt").write_text(calibration)
    return path


def assert_line(capsys, code, *words):
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith("error: ")]
    assert code == 2
    assert len(lines) == 1, error
    for word in words:
        assert word in lines[0]


def test_help_explains_itself(call, capsys):
    with pytest.raises(SystemExit) as done:
        call("--help")
    assert done.value.code == 0
    text = capsys.readouterr().out
    for word in ("--gt", "--window-ms", "estimates.h5", "examples:", "exit codes"):
        assert word in text


def test_missing_input(call, capsys, tmp_path):
    code = call(tmp_path / "none.bag")
    assert_line(capsys, code, "none.bag: no such file")


def test_no_calibration(call, capsys, tmp_path):
    code = call(ecd(tmp_path / "e", "0.1 1 1 1\n", calibration=None))
    assert_line(capsys, code, "no camera calibration", "--calib FILE")


def test_missing_truth(call, capsys, tmp_path):
    folder = ecd(tmp_path / "e", "0.1 1 1 1\n")
    code = call(folder, "--gt", tmp_path / "gt.bag", "--out", tmp_path / "out")
    assert_line(capsys, code, "gt.bag: no such file", "--gt")


def test_unknown_truth(call, capsys, tmp_path):
    folder = ecd(tmp_path / "e", "0.1 1 1 1\n")
    (tmp_path / "gt.xml").touch()
    code = call(folder, "--gt", tmp_path / "gt.xml", "--out", tmp_path / "out")
    assert_line(capsys, code, "gt.xml: not ground truth of a known format")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "window.duration_ms"], "--set window.duration_ms: not of the form NAME=VALUE"),
        (["--set", "no.such=1"], "no.such: no such option"),
        (["--window-ms", "-5"], "window.duration_ms"),
        (["--stride-ms", "20000"], "window.stride_ms"),
        (["--profile", "fast"], "unknown profile 'fast'"),
    ],
)
def test_bad_options(call, capsys, tmp_path, arguments, words):
    folder = ecd(tmp_path / "e", "0.1 1 1 1\n")
    assert_line(capsys, call(folder, *arguments), words)


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf", "fast"])
def test_speed_is_a_number_above_0(call, capsys, tmp_path, speed):
    with pytest.raises(SystemExit) as done:
        call(tmp_path, f"--speed={speed}")
    assert done.value.code == 2
    assert f"{speed} is not a number above 0" in capsys.readouterr().err


def test_out_that_is_a_file(call, capsys, tmp_path):
    folder = ecd(tmp_path / "e", "0.1 1 1 1\n")
    (tmp_path / "file").touch()
    code = call(folder, "--out", tmp_path / "file" / "out")
    assert_line(capsys, code, "cannot be made", "--out")


def test_stride_and_overrides_reach_the_configuration():
    options = evaluate_command.parse(
        ["x", "--window-ms", "50", "--stride-ms", "25", "--set", "estimator.max_events=2000"]
    )
    assert overrides(options) == {
        "window.duration_ms": 50.0,
        "window.stride_ms": 25.0,
        "window.max_displacement_px": 0.0,
        "estimator.max_events": 2000,
    }
