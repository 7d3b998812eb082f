import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.simulation.cameras import LENSES, davis346
from emoflow_ros.simulation.recording import SimulatedRecording
from emoflow_ros.simulation.scenes import SCENES, build_scene
from emoflow_ros.simulation.truth import GroundTruth

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
        rays = cv2.undistortPoints(pixels, k, d, criteria=criteria)
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
