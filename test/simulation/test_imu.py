"""The simulated IMU: each of its errors alone, and that it leaves the events alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.gyro_config import GyroConfig
from emoflow_ros.core.gyro_readings import GyroReadings
from emoflow_ros.readers import open_recording
from emoflow_ros.simulation import simulate as executable
from emoflow_ros.simulation.bags import data_topics, write_bag
from emoflow_ros.simulation.imu import PERFECT, ImuModel, measure_rotation, simulate_imu
from emoflow_ros.simulation.messages import MessageEncoder

STILL = np.zeros((200_000, 3))


def model(**changes) -> ImuModel:
    return ImuModel(**{**PERFECT, **changes})


def test_a_perfect_imu_shows_the_truth(mover) -> None:
    imu = simulate_imu(mover.truth, mover.t_start, mover.t_end, model(rate_hz=500.0), 1)
    assert np.array_equal(imu.stamps, mover.t_start + np.arange(30) * 2_000_000)
    for t, angular, force in zip(imu.stamps, imu.angular, imu.force, strict=True):
        np.testing.assert_array_equal(angular, mover.truth.twist(int(t))[1])
        up = mover.truth.pose(int(t))[:3, :3] @ force - mover.truth.acceleration(int(t))
        np.testing.assert_allclose(up, (0, -9.81, 0), atol=1e-12)


def test_noise_has_its_density() -> None:
    readings, bias = measure_rotation(STILL, model(noise=0.05, rate_hz=400.0), 3)
    assert not bias.any()
    np.testing.assert_allclose(np.degrees(readings.std(axis=0)), 0.05 * 20, rtol=0.01)
    means = readings.reshape(-1, 400, 3).mean(axis=1)  # over a second
    np.testing.assert_allclose(np.degrees(means.std(axis=0)), 0.05, rtol=0.15)


def test_bias_and_its_walk() -> None:
    drawn = [measure_rotation(STILL[:1], model(bias=2.0), seed)[1] for seed in range(300)]
    assert np.degrees(np.std(drawn)) == pytest.approx(2.0, rel=0.1)
    readings, bias = measure_rotation(STILL[:3], model(bias=2.0), 7)
    np.testing.assert_array_equal(readings, np.tile(bias, (3, 1)))
    ends = [measure_rotation(STILL[:4000], model(bias_walk=0.1), s)[0][-1] for s in range(150)]
    assert np.degrees(np.std(ends)) == pytest.approx(0.2, rel=0.1)  # of 4 s


def test_scale_range_and_mounting() -> None:
    turning = np.tile([1.0, 2.0, -3.0], (5, 1))
    scaled, _ = measure_rotation(turning, model(scale_error=0.02), 5)
    factors = scaled / turning
    assert np.ptp(factors, axis=0).max() == pytest.approx(0, abs=1e-15)
    assert 0.001 < np.abs(factors[0] - 1).max() < 0.08
    clipped, _ = measure_rotation(turning, model(range=100.0), 5)
    np.testing.assert_allclose(np.degrees(clipped[0]), [57.2958, 100.0, -100.0], rtol=1e-5)
    mounted = model(roll=10.0, pitch=-20.0, yaw=90.0)
    turned, _ = measure_rotation(turning, mounted, 5)
    back = Rotation.from_euler("xyz", (10, -20, 90), degrees=True).apply(turned)
    np.testing.assert_allclose(back, turning, atol=1e-12)


def test_the_estimators_parameters_undo_mounting_and_offset(mover) -> None:
    made = model(yaw=90.0, roll=5.0, offset_ms=12.0)
    imu = simulate_imu(mover.truth, mover.t_start, mover.t_end, made, 1)
    config = GyroConfig(rotation="5,0,90", time_offset_ms=12.0)
    found = GyroReadings.mounted(imu.stamps, imu.angular, config.matrix(), config.time_offset_ns)
    assert found.t[0] == mover.t_start
    expected = [mover.truth.twist(int(t))[1] for t in found.t]
    np.testing.assert_allclose(found.w, expected, atol=1e-12)


def test_gyro_and_accelerometer_have_noise_of_their_own(mover) -> None:
    made = simulate_imu(mover.truth, mover.t_start, mover.t_end, model(), 1)
    noisy = simulate_imu(mover.truth, mover.t_start, mover.t_end, model(force_noise=0.01), 1)
    np.testing.assert_array_equal(noisy.angular, made.angular)
    assert (noisy.force - made.force).std() == pytest.approx(0.01 * 1000**0.5, rel=0.2)


@pytest.mark.parametrize("ros1", [True, False])
def test_bags_hold_it(mover, tmp_path, ros1) -> None:
    made = model(yaw=90.0, offset_ms=8.0, rate_hz=200.0, noise=0.1)
    imu = simulate_imu(mover.truth, mover.t_start, mover.t_end, made, 1)
    encoder = MessageEncoder(ros1=ros1)
    path = tmp_path / ("data.bag" if ros1 else "data")
    write_bag(path, encoder, data_topics(mover, encoder, imu), progress=False)
    with open_recording(path) as recording:
        read = recording.imu()
        events = np.concatenate([chunk.t for chunk in recording.event_chunks()])
    np.testing.assert_array_equal(read.t, mover.t_start - 8_000_000 + np.arange(12) * 5_000_000)
    np.testing.assert_array_equal(read.angular, imu.angular)
    np.testing.assert_array_equal(read.acceleration, imu.force)
    np.testing.assert_array_equal(events, mover.events.t)


def test_executable_takes_the_options(monkeypatch, tmp_path) -> None:
    words = ("simulate", "static", "--out", tmp_path, "--duration", "0.01", "--seed", "4")
    words = (*words, "--imu-perfect", "--imu-rate", "500", "--imu-yaw", "90", "--imu-bias", "2")
    monkeypatch.setattr("sys.argv", [str(word) for word in words])
    assert executable.main() == 0
    with open_recording(tmp_path / "static_data.bag") as recording:
        imu = recording.imu()
    assert len(imu) == 5
    bias = measure_rotation(STILL[:1], model(bias=2.0), 4)[1]
    np.testing.assert_array_equal(imu.angular, np.tile(bias, (5, 1)))
    np.testing.assert_allclose(imu.acceleration, np.tile([-9.81, 0, 0], (5, 1)), atol=0.6)
