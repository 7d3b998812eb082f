import dataclasses
import sys
from functools import cache

import numpy as np
import pytest

from emoflow_ros.errors import InputError
from emoflow_ros.simulation.factors import MOTION_KINDS, SCENE_KINDS, Factors, draw_factors
from emoflow_ros.simulation.random_layout import quad_distance
from emoflow_ros.simulation.random_recording import (
    RandomRecording,
    frame_times,
    random_truth,
    simulate_random,
)
from emoflow_ros.simulation.random_scene import (
    CLEARANCE,
    GRID,
    coarse_truth,
    given_camera,
    image_motion,
    random_camera,
    random_scene,
)
from emoflow_ros.simulation.scene import MOVING, STATIC, Scene
from emoflow_ros.simulation.textures import BLANK, PAINTED, SIZE, TextureSet, random_textures

MS = 1_000_000
SMALL = {"sensor": "240x180"}


def scene_of(factors: Factors, duration_s: float = 3.0) -> Scene:
    return random_scene(factors, random_camera(factors), duration_s)


def cheap(_: Factors) -> TextureSet:
    return noise()


@cache
def noise() -> TextureSet:
    """Textures that cost no time to paint: the same noise for all."""
    rng = np.random.default_rng(0)
    length = sum((SIZE >> level) ** 2 for level in range(9))
    start = np.cumsum([0, *((SIZE >> level) ** 2 for level in range(8))])
    texel = rng.normal(0, 0.5, length).astype(np.float32)
    return TextureSet(np.stack([texel] * (PAINTED + 1)), start)


@pytest.fixture(scope="module")
def recording() -> RandomRecording:
    fixed = {"movers": "3", "mover_share": "0.3", "motion": "hover"}
    fixed |= {"calibration_error": "0.02", "lens": "plumb_bob", "image_motion": "10", "lost": "0"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("emoflow_ros.simulation.random_recording.random_textures", cheap)
        return simulate_random(draw_factors(2, SMALL | fixed), duration_s=0.06, start_ns=5 * MS)


def test_the_same_factors_give_bitwise_the_same_events(recording, monkeypatch) -> None:
    monkeypatch.setattr("emoflow_ros.simulation.random_recording.random_textures", cheap)
    again = simulate_random(recording.factors, duration_s=0.06, start_ns=5 * MS)
    assert len(again.events) > 1000
    for name in ("x", "y", "t", "p"):
        expected = getattr(recording.events, name)
        np.testing.assert_array_equal(getattr(again.events, name), expected)


def test_events_are_sorted_and_inside(recording) -> None:
    events = recording.events
    assert (np.diff(events.t) >= 0).all()
    assert (recording.t_start, recording.t_end) == (5 * MS, 65 * MS)
    assert events.t[0] >= recording.t_start
    assert events.t[-1] < recording.t_end
    assert events.inside(240, 180).all()
    assert 0.2 < events.p.mean() < 0.8


def test_truth_is_rebuilt_from_the_factors_alone(recording) -> None:
    truth = random_truth(recording.factors, duration_s=0.06, start_ns=5 * MS)
    t = recording.t_start + 31 * MS
    np.testing.assert_array_equal(truth.pose(t), recording.truth.pose(t))
    np.testing.assert_array_equal(truth.flow(t), recording.truth.flow(t))
    np.testing.assert_array_equal(truth.depth(t), recording.truth.depth(t))


def test_flow_of_three_movers_is_the_derivative_of_the_displacement(recording) -> None:
    truth, t, step = recording.truth, recording.t_start + 30 * MS, 20_000
    difference = truth.displacement(t, t + step) - truth.displacement(t, t - step)
    flow = truth.flow(t)
    moving = truth.moving_mask(t)
    assert 0.05 < moving.mean() < 0.45
    np.testing.assert_allclose(difference / (2e-9 * step), flow, atol=2e-3, rtol=1e-4)
    scene = scene_of(recording.factors, 0.06)
    assert len(scene.movers) == 3
    assert {quad.body for quad in scene.quads} == {STATIC, MOVING, MOVING + 1, MOVING + 2}
    still = dataclasses.replace(scene, movers=tuple(scene.movers[:0]))
    assert len(still.poses(0.0)[1]) == 1


def test_events_follow_the_true_flow(recording) -> None:
    """Warped back along the true flow, events line up: the image of warped events sharpens."""
    events = recording.events
    flow = recording.truth.flow((recording.t_start + recording.t_end) // 2)
    u = flow[events.y, events.x] * ((events.t - recording.t_start) * 1e-9)[:, None]
    edges = (np.arange(181) - 0.5, np.arange(241) - 0.5)
    still = np.histogram2d(events.y, events.x, edges)[0].var()
    warped = np.histogram2d(events.y - u[:, 1], events.x - u[:, 0], edges)[0].var()
    assert warped > 1.3 * still


def test_given_calibration_is_wrong_as_the_factor_says(recording) -> None:
    true, given = recording.camera, recording.calibration
    assert abs(given.fx / true.fx - 1) == pytest.approx(0.02)
    assert abs(given.cx - true.cx) <= 0.02 * 120
    assert given.distortion != true.distortion
    assert recording.as_given().camera == given
    right = dataclasses.replace(recording.factors, calibration_error=0.0)
    assert given_camera(right, true) == true


@pytest.mark.parametrize("motion", MOTION_KINDS)
def test_image_moves_as_wanted_and_physically(motion: str) -> None:
    fixed = SMALL | {"motion": motion, "scene": "room", "image_motion": "8", "movers": "0"}
    factors = draw_factors(12, fixed)
    camera = random_camera(factors)
    scene = random_scene(factors, camera, 2.0)
    wanted = 0.0 if motion == "still" else 8.0
    assert image_motion(camera, scene, 2.0) == pytest.approx(wanted, rel=0.15)
    times = np.linspace(0, 2, 101)
    turns = [np.linalg.norm(scene.camera.angular_acceleration(t)) for t in times]
    assert max(turns) <= 1.02 * np.radians(3000)
    linear, angular = (np.array(part) for part in zip(*map(scene.camera.twist, times), strict=True))
    if motion == "slider":
        assert np.abs(angular).max() == 0
        np.testing.assert_allclose(np.linalg.matrix_rank(linear, tol=1e-9), 1)
    if motion == "rotation":
        assert np.abs(linear).max() == 0
    if motion == "pan_tilt":
        assert 0.001 < np.linalg.norm(linear, axis=1).max() < 1.0
    if motion == "stop_and_go":
        speed = np.linalg.norm(angular, axis=1)
        assert 0.1 < (speed < 1e-9).mean() < 0.8


@pytest.mark.parametrize("kind", SCENE_KINDS)
def test_camera_keeps_clear_of_everything_and_sees_the_scene(kind: str) -> None:
    motion = {"street": "driving", "corridor": "walking", "plane": "drone"}.get(kind, "hover")
    fixed = SMALL | {"scene": kind, "motion": motion, "image_motion": "20", "clutter": "20"}
    factors = draw_factors(0, fixed)
    scene = scene_of(factors)
    static = tuple(quad for quad in scene.quads if quad.body == STATIC)
    way = np.stack([scene.camera.pose(t)[1] for t in np.linspace(0, 3, 200)])
    start = quad_distance(static, way[:1])[0]
    assert quad_distance(static, way).min() >= 0.95 * min(CLEARANCE, 0.7 * start)
    assert start > 0.25
    truth = coarse_truth(random_camera(factors), scene)
    for t in (0, 1500 * MS, 3000 * MS):
        assert np.isfinite(truth.depth(t)).mean() > 0.99


def test_depth_ratio_sets_the_range_of_depths() -> None:
    ratios = []
    for wanted in ("2", "20"):
        factors = draw_factors(4, SMALL | {"scene": "room", "depth_ratio": wanted})
        depth = coarse_truth(random_camera(factors), scene_of(factors)).depth(0)
        ratios.append(np.percentile(depth, 98) / np.percentile(depth, 2))
    assert ratios[1] > 2 * ratios[0]


@pytest.mark.parametrize("motion", ["shake", "turn_and_stop", "still"])
def test_no_pixel_moves_by_more_than_half_a_pixel_between_images(motion: str) -> None:
    factors = draw_factors(5, SMALL | {"motion": motion, "flicker": "0"})
    camera = random_camera(factors)
    scene = random_scene(factors, camera, 0.5)
    times = frame_times(factors, camera, scene, 500 * MS)
    steps = np.diff(times)
    assert (times[0], times[-1]) == (0, 500 * MS)
    assert steps[:-1].min() >= 199_000
    assert steps.max() <= 20 * MS
    truth = coarse_truth(camera, scene)
    for t, step in list(zip(times, steps, strict=False))[::10]:
        moved = np.linalg.norm(truth.displacement(t, t + int(step)), axis=-1) * GRID
        assert np.nanmax(moved) <= 0.6 or step <= 200_000
    lamp = dataclasses.replace(factors, flicker=0.1)
    assert np.diff(frame_times(lamp, camera, scene, 100 * MS)).max() <= MS


def test_textures_are_reproducible_and_blank_as_the_factor_says() -> None:
    fixed = SMALL | {"texture": "noise", "blank_share": "0.6"}
    factors = draw_factors(0, fixed)
    painted = random_textures(factors)
    np.testing.assert_array_equal(painted.texels, random_textures(factors).texels)
    texels = painted.texels[:, : SIZE * SIZE].reshape(-1, SIZE, SIZE)
    assert len(texels) == PAINTED + 1
    assert texels[BLANK].std() == pytest.approx(0.02, rel=0.01)
    # Fine noise has large differences between neighbours; blank paint has none.
    rough = np.abs(np.diff(texels[0], axis=0))
    cells = rough[:1008].reshape(63, 16, 64, 16).max(axis=(1, 3))
    assert 0.35 < (cells < 0.01).mean() < 0.65


def test_imperfections_reach_the_events(monkeypatch) -> None:
    monkeypatch.setattr("emoflow_ros.simulation.random_recording.random_textures", cheap)
    quiet = SMALL | {"motion": "still", "movers": "0", "hot_pixels": "0", "noise_hz": "0.01"}
    quiet |= {"flicker": "0", "lost": "0", "leak_hz": "0.001", "scene": "plane"}

    def count(**changes: str) -> tuple[int, float]:
        events = simulate_random(draw_factors(1, quiet | changes), duration_s=0.2).events
        return len(events), float(events.p.mean())

    base, _ = count()
    assert base < 300  # 0.011 Hz per pixel: 95 expected
    assert 1.5e4 < count(noise_hz="2")[0] < 2.0e4  # 2 Hz x 43200 px x 0.2 s = 17280
    leaking, positive = count(leak_hz="0.2")
    assert 1000 < leaking < 2700  # 1728 expected
    assert positive > 0.9
    assert count(flicker="0.1", threshold="0.1", lowpass_hz="1000")[0] > 2e4
    assert count(hot_pixels="50")[0] > base + 500


def test_duration_out_of_range_is_refused() -> None:
    for duration in (0.0, 61.0, float("nan")):
        with pytest.raises(InputError, match=r"duration: .* s; give a length in \[0.01, 60\] s"):
            random_truth(draw_factors(0), duration_s=duration)


def test_photographs_and_the_rational_lens_can_be_asked_for():
    fixed = {"texture": "photo", "lens": "rational_polynomial", "blank_share": "0.1"}
    factors = draw_factors(5, fixed)
    usual = draw_factors(5, {"texture": "text", "blank_share": "0.1"})
    photo, text = (random_textures(f) for f in (factors, usual))
    assert not np.array_equal(photo.texels[0], text.texels[0])
    assert abs(photo.texels[0].mean()) < 0.05 and photo.texels[0].std() > 0.1
    camera = random_camera(factors)
    assert camera.model == "rational_polynomial" and len(camera.distortion) == 8
    assert np.isfinite(camera.undistort(np.array([[0.0, 0.0], [100.0, 80.0]]))[0]).all()


def test_photographs_without_scikit_image_are_one_clear_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.data", None)
    with pytest.raises(InputError, match="scikit-image is not installed"):
        random_textures(draw_factors(5, {"texture": "photo"}))
