"""Truth against derivatives, closed forms and OpenCV; each error of the IMU alone."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.commands import simulate as executable
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.readers import open_recording
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording import (
    LENSES,
    SCENES,
    SimulatedRecording,
    build_scene,
    davis346,
)
from emoflow_ros.simulation.recording_files import data_topics, write_bag
from emoflow_ros.simulation.simulated_truth import (
    PERFECT,
    GroundTruth,
    ImuModel,
    measure_rotation,
    simulate_imu,
)

START = 1_500_000_000_000_000_000
MS = 1_000_000


def truth_of(scene: str, lens: str = "none", seed: int = 0) -> GroundTruth:
    return GroundTruth(davis346(lens), build_scene(scene, 1.0, np.random.default_rng(seed)), START)


def length(flow: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(flow, axis=-1)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("scene", ["mover", "driving"])
def test_flow_is_the_derivative_of_the_displacement(scene: str, lens: str) -> None:
    truth = truth_of(scene, lens)
    t, step = START + 200 * MS, 20_000
    difference = truth.displacement(t, t + step) - truth.displacement(t, t - step)
    flow = truth.flow(t)
    assert np.isfinite(flow).all()
    np.testing.assert_allclose(difference / (2e-9 * step), flow, atol=1e-3, rtol=1e-4)


@pytest.mark.parametrize("scene", ["calm", "forward", "driving"])
def test_flow_is_the_motion_field_of_depth_and_twist(scene: str) -> None:
    """U = A v / Z + B w, written out pixel by pixel for an ideal lens."""
    truth, camera = truth_of(scene), davis346("none")
    t = START + 300 * MS
    (vx, vy, vz), (wx, wy, wz) = truth.twist(t)
    row, column = np.mgrid[: camera.height, : camera.width]
    x, y = (column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy
    z = truth.depth(t)
    u = (x * vz - vx) / z + x * y * wx - (1 + x * x) * wy + y * wz
    v = (y * vz - vy) / z + (1 + y * y) * wx - x * y * wy - x * wz
    np.testing.assert_allclose(
        truth.flow(t), np.stack([u * camera.fx, v * camera.fy], -1), atol=1e-8
    )


@pytest.mark.parametrize(("lens", "scene"), [("plumb_bob", "forward"), ("equidistant", "agile")])
def test_displacement_reprojects_depth_with_opencv(lens: str, scene: str) -> None:
    """Depth and poses moved by hand and projected by OpenCV, at pixels all over the image."""
    truth, camera = truth_of(scene, lens), davis346(lens)
    t0, t1 = START + 100 * MS, START + 190 * MS
    rows, columns = (a.ravel() for a in np.mgrid[5:260:17, 5:346:17])
    pixels = np.stack([columns, rows], -1).astype(np.float64)[:, None]
    k, d = camera.intrinsic_matrix, np.array(camera.distortion)
    fisheye = lens == "equidistant"
    if fisheye:
        rays = cv2.fisheye.undistortPoints(pixels, k, d)
    else:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        rays = cv2.undistortPointsIter(pixels, k, d, np.eye(3), np.eye(3), criteria)
    points = (
        np.append(rays[:, 0], np.ones((len(rays), 1)), 1) * truth.depth(t0)[rows, columns, None]
    )
    world = points @ truth.pose(t0)[:3, :3].T + truth.pose(t0)[:3, 3]
    moved = (world - truth.pose(t1)[:3, 3]) @ truth.pose(t1)[:3, :3]
    zero = np.zeros(3)
    if fisheye:
        expected, _ = cv2.fisheye.projectPoints(moved[:, None], zero, zero, k, d)
    else:
        expected, _ = cv2.projectPoints(moved, zero, zero, k, d)
    displacement = truth.displacement(t0, t1)[rows, columns]
    np.testing.assert_allclose(displacement, (expected - pixels)[:, 0], atol=1e-4)


def test_depth_of_the_room_by_hand() -> None:
    """At rest in the middle the side walls stand at x = +-3.5 m and the ceiling at y = -2 m."""
    truth, camera = truth_of("static"), davis346("none")
    depth = truth.depth(START)
    ceiling = (camera.cy - 0) / camera.fy / 2
    np.testing.assert_allclose(depth[0, 173], 1 / ceiling)
    assert depth.max() <= 5.0 + 1e-9  # the wall in front
    assert np.count_nonzero(np.isclose(depth, 5.0)) > 500


def test_a_point_seen_twice_returns_to_its_pixel() -> None:
    truth = truth_of("calm")
    t0, t1 = START, START + 90 * MS
    there, back = truth.displacement(t0, t1), truth.displacement(t1, t0)
    row, column = np.mgrid[:260, :346]
    landed = np.stack([column, row], -1) + there
    seen = cv2.remap(back.astype(np.float32), *landed.astype(np.float32).transpose(2, 0, 1), 1)
    inside = ((landed > 1) & (landed < (344, 258))).all(-1)
    # Occlusions and depth steps aside, the way back ends where the way there began.
    assert np.quantile(length(there + seen)[inside], 0.9) < 0.05


def test_the_mover_moves_against_the_room(mover) -> None:
    t = mover.t_start
    mask = mover.truth.moving_mask(t)
    assert 0.05 < mask.mean() < 0.2
    linear, _ = mover.truth.twist(t)
    assert np.linalg.norm(linear) > 0.1
    resting = GroundTruth(mover.camera, build_scene("calm", 1.0, np.random.default_rng(0)), t)
    assert not resting.moving_mask(t).any()
    difference = mover.truth.flow(t) - _rigid_flow(mover.truth, mover.camera, t)
    assert length(difference)[~mask].max() < 1e-8
    assert length(difference)[mask].min() > 10


def test_calm_is_the_mover_s_scene_without_the_object(mover) -> None:
    """With the same seed: what the object costs is the difference between the two."""
    calm = GroundTruth(mover.camera, build_scene("calm", *_layout(mover)), mover.t_start)
    for t in (mover.t_start, mover.t_start + 90 * MS):
        for ours, same in zip(calm.twist(t), mover.truth.twist(t), strict=True):
            np.testing.assert_array_equal(ours, same)
        still = ~mover.truth.moving_mask(t)
        np.testing.assert_array_equal(calm.depth(t)[still], mover.truth.depth(t)[still])
        assert (calm.depth(t)[~still] > mover.truth.depth(t)[~still]).all()


def _layout(recording: SimulatedRecording) -> tuple[float, np.random.Generator]:
    """Length and generator that `simulate` lays a recording's scene out with."""
    duration_s = (recording.t_end - recording.t_start) * 1e-9
    return duration_s, np.random.default_rng(recording.seed).spawn(1)[0]


def _rigid_flow(truth: GroundTruth, camera: Camera, t: int) -> NDArray[np.float64]:
    linear, angular = truth.twist(t)
    rays = np.append(camera.undistort(_grid(camera))[0], np.ones((260, 346, 1)), -1)
    points = rays * truth.depth(t)[..., None]
    velocity = -linear - np.cross(angular, points)
    image = (velocity[..., :2] - rays[..., :2] * velocity[..., 2:]) / points[..., 2:]
    return image * (camera.fx, camera.fy)


def _grid(camera: Camera) -> NDArray[np.float64]:
    row, column = np.mgrid[: camera.height, : camera.width]
    return np.stack([column, row], -1).astype(np.float64)


EXPECTED = {  # |w| deg/s, mean displacement in px per 90 ms
    "calm": ((7, 15), (4, 8)),
    "forward": ((7, 13), (3, 9)),
    "agile": ((50, 70), (20, 36)),
    "rotation": ((50, 70), (18, 30)),
    "translation": ((0, 1e-6), (3, 10)),
    "driving": ((3, 5), (16, 33)),
    "mover": ((7, 15), (4, 10)),
    "noisy": ((7, 15), (4, 8)),
    "static": ((0, 0), (0, 1e-12)),  # rounding
    "bystander": ((0, 0), (0.5, 4)),
}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("seed", [0, 1])
def test_scenes_move_as_they_are_named(scene: str, seed: int) -> None:
    truth = truth_of(scene, seed=seed)
    (low, high), (near, far) = EXPECTED[scene]
    for t in (START, START + 700 * MS):
        linear, angular = truth.twist(t)
        assert low <= np.degrees(np.linalg.norm(angular)) <= high
        assert near <= length(truth.displacement(t, t + 90 * MS)).mean() <= far
        assert (np.linalg.norm(linear) == 0) == (scene in ("rotation", "static", "bystander"))


def test_driving_spans_near_road_and_far_hills() -> None:
    depth = truth_of("driving").depth(START)
    assert depth.min() < 3.5
    assert depth.max() > 90


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
    words = (*words, "--imu-perfect", "--imu-rate-hz", "500", "--imu-yaw", "90", "--imu-bias", "2")
    monkeypatch.setattr("sys.argv", [str(word) for word in words])
    assert executable.main() == 0
    with open_recording(tmp_path / "static_data.bag") as recording:
        imu = recording.imu()
    assert len(imu) == 5
    bias = measure_rotation(STILL[:1], model(bias=2.0), 4)[1]
    np.testing.assert_array_equal(imu.angular, np.tile(bias, (5, 1)))
    np.testing.assert_allclose(imu.acceleration, np.tile([-9.81, 0, 0], (5, 1)), atol=0.6)
