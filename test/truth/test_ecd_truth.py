"""ECD's files of truth: what each says, and of poses and gyroscope which is which."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.truth import load_truth
from emoflow_ros.truth.text_truth import load_gyro, load_motion, load_poses

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
RATE = np.array([0.2, -0.4, 0.1])
BIAS = np.array([0.01, 0.02, -0.03])


@pytest.fixture
def folder(tmp_path):
    """A camera that turns at a constant rate and moves along the world's x axis; 1 kHz gyro."""
    (tmp_path / "events.txt").write_text("0.5 1 1 1\n")
    (tmp_path / "calib.txt").write_text("60 60 31.5 23.5 0 0 0 0 0")
    t = np.arange(0, 1, 0.005)
    turned = Rotation.from_rotvec(np.outer(t, RATE)).as_quat()
    np.savetxt(tmp_path / "groundtruth.txt", np.column_stack([t, 0.3 * t, 0 * t, 0 * t, turned]))
    t = np.arange(0, 1, 0.001)
    readings = np.column_stack([t, np.zeros((len(t), 3)), np.tile(RATE + BIAS, (len(t), 1))])
    np.savetxt(tmp_path / "imu.txt", readings)
    return tmp_path


def test_poses_count_and_the_gyro_stands_beside_them(folder):
    with open_recording(folder) as recording:
        truth = load_truth(recording)
    t = NS_PER_S // 2
    twist = truth.twists.twist(t)
    np.testing.assert_allclose(twist.angular, RATE, atol=1e-6)
    world = Rotation.from_rotvec(RATE * 0.5)
    np.testing.assert_allclose(twist.linear, world.inv().apply([0.3, 0, 0]), atol=1e-6)
    [gyro] = truth.other_twists
    np.testing.assert_allclose(gyro.twist(t).angular, RATE + BIAS)
    assert gyro.twist(t).linear is None
    assert [truth.twists.name, gyro.name] == ["groundtruth.txt", "imu.txt"]
    np.testing.assert_allclose(truth.poses.transform(t)[:3, 3], [0.15, 0, 0])
    assert "cubic least-squares fit" in truth.description[0]
    assert "mean of the gyroscope within 10 ms, bias not removed" in truth.description[1]


def test_gyro_is_the_mean_of_the_readings_around(tmp_path):
    """Readings that grow by 1 rad/s per 5 ms: those from t - 10 ms to t + 10 ms, both included."""
    path = tmp_path / "imu.txt"
    path.write_text("\n".join(f"{0.005 * k:.3f} 0 0 9.8 {k} 0 {k * k}" for k in range(21)))
    gyro = load_gyro(path, CAMERA).twists
    at_50_ms = gyro.twist(50 * NS_PER_MS).angular
    np.testing.assert_allclose(at_50_ms, [10, 0, (64 + 81 + 100 + 121 + 144) / 5])
    np.testing.assert_allclose(gyro.twist(0).angular, [1, 0, (0 + 1 + 4) / 3])
    assert gyro.twist(200 * NS_PER_MS) is None


def test_motion_is_a_constant_rotation(tmp_path):
    path = tmp_path / "motion.txt"
    path.write_text("0.1 -0.2 0.3\n")
    truth = load_motion(path, CAMERA)
    np.testing.assert_allclose(truth.twists.twist(0).angular, [0.1, -0.2, 0.3])
    assert truth.twists.twist(0).linear is None
    assert truth.flows.displacement(0, 1000).valid.all()


def test_velocity_is_the_slope_of_the_poses(tmp_path):
    path = tmp_path / "groundtruth.txt"
    rows = [f"{k * 0.01} {k * 0.02} 0 0 0 0 0 1" for k in range(100)]
    path.write_text("\n".join(rows))
    twist = load_poses(path, CAMERA).twists.twist(NS_PER_S // 2)
    np.testing.assert_allclose(twist.linear, [2, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("load", "text", "words"),
    [
        (load_motion, "1 2", "lines of 2 numbers"),
        (load_motion, "1 2 3\n1 2 3\n", "holds 2 lines"),
        (load_motion, "a b c", "not a table"),
        (load_poses, "0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", "all 2 stamps are 0.000000 s"),
        (load_gyro, "0 0 0 0 1 2", "lines of 6 numbers; give lines 't ax ay az gx gy gz'"),
        (load_gyro, "1 0 0 0 0 0 0\n0.9 0 0 0 0 0 0", "not increasing"),
    ],
)
def test_bad_files(tmp_path, load, text, words):
    path = tmp_path / "truth.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        load(path, CAMERA)
