"""evaluate with an IMU: which one is read, and what windows and results carry of it."""

import csv
import json
from typing import ClassVar

import numpy as np
import pytest
from known import Known

from emoflow_ros.commands import evaluate as evaluate_command
from emoflow_ros.commands import label as label_command
from emoflow_ros.config import load_config
from emoflow_ros.core.gyro.gyro import Gyro
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.recording_options import read_gyro, shares, with_choice
from emoflow_ros.readers import open_recording

S = 1_000_000_000


class WithGyro(Known):
    """The known answers, beside a gyro that is noted."""

    seen: ClassVar[list] = []

    def __init__(self, camera, config=None):
        super().__init__(camera, config)
        self._gyro = Gyro(config.imu)

    def estimate(self, window):
        measured = self._gyro.measure(window.t_start, window.t_end, window.gyro)
        self.seen.append((window, measured))
        estimate = super().estimate(window)
        return type(estimate)(**{**vars(estimate), "gyro": self._gyro.status})


@pytest.fixture
def folder(tmp_path):
    """An ECD folder of a second with a gyro of constant rotation but for its noise."""
    t = 100 + np.arange(0, 1, 1e-3)
    k = np.arange(1000)
    events = "".join(f"{a:.6f} {b % 240} {b % 180} {b % 2}\n" for a, b in zip(t, k, strict=True))
    (tmp_path / "events.txt").write_text(events)
    (tmp_path / "calib.txt").write_text("200 200 119.5 89.5 0 0 0 0 0")
    rng = np.random.default_rng(0)
    rows = np.column_stack(
        [
            t,
            np.zeros((1000, 2)),
            np.full(1000, 9.8),
            rng.normal([0.1, -0.2, 0.3], 1e-3, (1000, 3)),
        ]
    )
    np.savetxt(tmp_path / "imu.txt", rows, fmt="%.9f")
    WithGyro.seen = []
    return tmp_path


@pytest.fixture
def call(monkeypatch, capsys, folder):
    monkeypatch.setattr(evaluate_command, "make_estimator", WithGyro)

    def run(*arguments):
        words = ["evaluate", folder, "--window-ms", 100, "--out", folder / "out", *arguments]
        monkeypatch.setattr("sys.argv", [str(word) for word in words])
        code = evaluate_command.main()
        out, err = capsys.readouterr()
        return code, out, [line for line in err.splitlines() if line.startswith("error: ")]

    return run


def test_windows_carry_the_readings_that_are_asked_for(call, folder):
    code, out, _ = call("--set", "imu.use=auto", "--set", "imu.rotation=0,0,90")
    assert code == 0
    assert "IMU: imu.txt, 1000 readings at 1000 Hz; gyro used 100 %" in out
    assert len(WithGyro.seen) == 9
    for window, measured in WithGyro.seen:
        assert len(window.gyro) == 101
        np.testing.assert_allclose(measured.w, [0.2, 0.1, 0.3], atol=1e-3)
    document = json.loads((folder / "out" / "report.json").read_text())
    assert document["imu"] == "imu.txt, 1000 readings at 1000 Hz"
    assert document["configuration"]["imu.rotation"] == "0,0,90"
    with (folder / "out" / "windows.csv").open() as file:
        assert {row["gyro"] for row in csv.DictReader(file)} == {"used"}


@pytest.mark.usefixtures("without_page")
@pytest.mark.parametrize("arguments", [(), ("--set", "imu.use=auto", "--imu", "off")])
def test_without_wish_there_is_no_gyro(call, folder, arguments):
    code, out, _ = call(*arguments)
    assert (code, {window.gyro for window, _ in WithGyro.seen}) == (0, {None})
    assert "IMU" not in out
    assert json.loads((folder / "out" / "report.json").read_text())["imu"] is None


@pytest.mark.usefixtures("without_page")
def test_a_file_takes_the_place_of_the_recordings_own(call, folder, tmp_path):
    other = tmp_path / "gyro.txt"
    rows = np.loadtxt(folder / "imu.txt")
    rows[:, 4:] *= 2
    np.savetxt(other, rows[:500], fmt="%.9f")
    code, out, _ = call("--imu", other)
    assert code == 0
    assert "IMU: gyro.txt, 500 readings" in out
    assert "used 56 %" in out
    assert "rejected (no readings) 33 %" in out
    np.testing.assert_allclose(WithGyro.seen[0][1].w, [0.2, -0.4, 0.6], atol=2e-3)


@pytest.mark.usefixtures("without_page")
def test_what_cannot_be_used_is_refused_in_one_line(call, folder):
    assert "not a bag: no IMU topic '/camera/imu'" in call("--imu", "/camera/imu")[2][0]
    assert "--imu none.txt: no such file; check" in call("--imu", "none.txt")[2][0]
    rows = np.loadtxt(folder / "imu.txt")
    rows[:, 0] += 500
    np.savetxt(folder / "imu.txt", rows, fmt="%.9f")
    code, _, errors = call("--set", "imu.use=auto")
    assert code == 2
    assert "imu.txt: its times, 600.000 to 600.999 s, are not those of the events" in errors[0]
    (folder / "imu.txt").unlink()
    assert call("--set", "imu.use=auto")[0] == 0
    code, _, errors = call("--set", "imu.use=require")
    assert code == 2
    assert "has no IMU; give a file with --imu FILE" in errors[0]
    assert "only the node has tf" in call("--set", "imu.use=auto", "--set", "imu.rotation=tf")[2][0]
    assert "nothing to check with --imu off" in call("--check-imu", "--imu", "off")[2][0]


@pytest.mark.usefixtures("without_page")
def test_a_check_reports_and_leaves_the_gyro_out(call):
    code, out, _ = call("--check-imu", "--stride-ms", 20)
    assert code == 0
    assert {window.gyro for window, _ in WithGyro.seen} == {None}
    assert "IMU against events: imu.txt, 1000 readings at 1000 Hz" in out
    assert "cannot tell: the camera rotates about less than two axes" in out


def test_a_topic_of_a_bag_is_read(calm_bag):
    config = with_choice(load_config(), "/davis/left/imu")
    with open_recording(calm_bag.data) as recording:
        found = read_gyro(recording, config.imu, "/davis/left/imu")
        assert found.description == "/davis/left/imu, 400 readings at 1000 Hz"
        with pytest.raises(InputError, match="'/imu'"):
            read_gyro(recording, config.imu, "/imu")
        assert read_gyro(recording, load_config().imu, None) is None


def test_shares_are_counted():
    assert shares(["used"] * 3 + ["none"]) == "used 75 %, none 25 %"
    assert shares([]) == ""
    disagree = [f"rejected (gyro and events disagree: {n} % of windows, axis x?)" for n in (70, 80)]
    assert shares(disagree) == "rejected (gyro and events disagree, axis x?) 100 %"


def test_labels_have_no_gyro(monkeypatch, capsys, folder):
    words = ["label", folder, "--out", folder / "labels", "--set", "imu.use=auto"]
    monkeypatch.setattr("sys.argv", [str(word) for word in words])
    assert label_command.main() == 2
    assert "imu.use: labels are made without a gyro" in capsys.readouterr().err
