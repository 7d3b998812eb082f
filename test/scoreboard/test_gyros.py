"""The gyros of the scoreboard's recordings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.scoreboard import observe as observing
from benchmarks.scoreboard.gyros import (
    CONSUMER,
    gyro_of_poses,
    gyro_of_simulation,
    own_gyro,
    without_bias,
)
from benchmarks.scoreboard.observe import observe
from benchmarks.scoreboard.subjects import Material, shared_subjects
from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Events
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.readers.reader_base import Imu
from emoflow_ros.simulation.recording import build_scene
from emoflow_ros.simulation.simulated_truth import GroundTruth
from emoflow_ros.truth import Truth
from emoflow_ros.truth.ground_truth import PoseTrack

S = 1_000_000_000
START = 1_500_000_000 * S
CAMERA = Camera(96, 72, 80.0, 80.0, 48.0, 36.0)


@pytest.fixture(scope="module")
def agile() -> GroundTruth:
    return GroundTruth(CAMERA, build_scene("agile", 2.0, np.random.default_rng(0)), START)


def test_a_simulation_has_a_consumer_gyro(agile):
    gyro = gyro_of_simulation(agile, START, START + S, "random/0001")
    assert (int(gyro.t[0]), len(gyro)) == (START, 1001)
    errors = np.degrees(gyro.w - [agile.twist(int(t))[1] for t in gyro.t])
    assert 0.1 < np.abs(errors.mean(axis=0)).max() < 4  # a bias
    assert np.diff(errors, axis=0).std() == pytest.approx(0.01 * 1000**0.5 * 2**0.5, rel=0.05)
    again = gyro_of_simulation(agile, START, START + S, "random/0001")
    np.testing.assert_array_equal(gyro.w, again.w)
    other = gyro_of_simulation(agile, START, START + S, "random/0002")
    assert np.degrees(np.abs((other.w - gyro.w).mean(axis=0))).max() > 0.2


def test_poses_give_the_same_as_the_simulation(agile):
    stamps = START + np.arange(201) * 5_000_000
    poses = [agile.pose(int(t)) for t in stamps]
    quaternions = Rotation.from_matrix([pose[:3, :3] for pose in poses]).as_quat()
    track = PoseTrack(stamps, np.array([pose[:3, 3] for pose in poses]), quaternions)
    made, exact = gyro_of_poses(track, "a"), gyro_of_simulation(agile, START, START + S, "a")
    np.testing.assert_array_equal(made.t, exact.t)
    inside = slice(5, -5)
    assert np.degrees(np.abs(made.w - exact.w)[inside]).max() < 0.05


def test_a_recordings_own_gyro_is_taken_as_it_is():
    imu = Imu("imu.txt", np.array([1, 2, 3]), np.arange(9.0).reshape(3, 3), None)
    gyro = own_gyro(imu)
    np.testing.assert_array_equal(gyro.w, imu.angular)
    assert own_gyro(None) is None


@pytest.mark.parametrize(("use", "readings"), [("off", None), ("auto", 62)])
def test_windows_carry_readings_where_they_are_wanted(monkeypatch, agile, use, readings):
    seen = []

    class Noting:
        def estimate(self, window):
            seen.append(None if window.gyro is None else len(window.gyro))
            quality = Quality(events=1)
            return Estimate(window.t_start, window.t_end, 0, Status.NO_MOTION, quality)

    monkeypatch.setattr(observing, "make_estimator", lambda camera, config: Noting())
    t = START + np.arange(200) * 1_000_000
    still = np.zeros(200, np.uint16)
    events = Events(still, still, t, still > 0)
    gyro = gyro_of_simulation(agile, START, START + S, "a")
    material = Material(events, CAMERA, CAMERA, Truth(None, None), gyro=gyro)
    options = {"imu.use": use, "window.duration_ms": 60.0, "window.stride_ms": 60.0}
    observe(material, load_config(overrides=options))
    assert set(seen[:3]) == {readings and readings - 1}
    seen.clear()
    observe(replace(material, gyro=None), load_config(overrides=options))
    assert set(seen) == {None}


def test_recordings_that_are_here_have_gyros(shared_data):
    subjects = {s.name: s for s in shared_subjects(shared_data)}
    calm = subjects["independent/calm"].load()
    assert calm.gyro is not None
    w = calm.truth.twists.twist(int(calm.events.t[len(calm.events) // 2])).angular
    near = calm.gyro.w[np.abs(calm.gyro.t - calm.events.t[len(calm.events) // 2]).argmin()]
    assert np.degrees(np.abs(w - near)).max() < 5
    assert CONSUMER.rate_hz == 1000
    pan = subjects["real/shapes_rotation_start"].load()
    assert pan.gyro is not None
    bias = pan.gyro.w[pan.gyro.t < pan.gyro.t[0] + 600_000_000].mean(axis=0)
    assert np.degrees(bias) == pytest.approx([3.3, 0.2, 0.1], abs=0.2)
    later = int(pan.gyro.t[1000])
    raw = pan.gyro.w[np.abs(pan.gyro.t - later) <= 5_000_000].mean(axis=0)
    assert pan.truth.twists.twist(later).angular == pytest.approx(raw - bias, abs=0.01)
    assert subjects["real/slider_depth"].load().gyro is None


def test_a_gyro_as_the_truth_does_without_the_bias_that_it_shows_at_rest():
    t = np.arange(1000) * 1_000_000
    bias, turn = np.array([0.05, -0.02, 0.01]), np.array([0.0, 0.7, 0.0])
    readings = bias + np.outer(t >= 600_000_000, turn)
    truth = without_bias(GyroReadings(t, readings), 0.6)
    assert truth.twist(300_000_000).angular == pytest.approx(np.zeros(3), abs=1e-12)
    assert truth.twist(800_000_000).angular == pytest.approx(turn, abs=1e-12)
