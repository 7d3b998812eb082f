"""A known scene and other motions of the camera: points whose depth and motion are known."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.belief import Belief
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.contrast import Contrast
from emoflow_ros.core.cross_check import CrossCheck
from emoflow_ros.core.earlier_scene import (
    EarlierScene,
    EarlierScenes,
    KnownScene,
    inverse_depths,
    motion_covariance,
)
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Events, Window
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.uncertainty import Disagreement
from emoflow_ros.core.window_events import WindowEvents

CAMERA = Camera(240, 180, 200.0, 200.0, 120.0, 90.0)
LATTICE = Lattice.with_spacing(240, 180, 26.0)
EPIPOLAR = NodeEpipolar(CAMERA, LATTICE, 0.7)
SCALES = {scale: Contrast(LATTICE, scale) for scale in (0.25, 0.5)}
NS = 100 * NS_PER_MS  # length of a window
SECONDS = NS / NS_PER_S
W = np.array([0.1, -0.2, 0.15])
V = np.array([0.8, 0.0, 0.6])
W_LATER, V_LATER = np.array([0.25, 0.05, 0.0]), np.array([0.6, 0.3, 0.5])
X, Y = LATTICE.pixels.T
INVERSE_DEPTH = 0.4 + 0.3 * X / 240 + 0.2 * (Y / 180) ** 2


def rigid(w, v):
    """Flow (nodes, 2) of the scene, px/s."""
    return EPIPOLAR.b @ w + INVERSE_DEPTH[:, None] * (EPIPOLAR.a @ v)


def field(flow):
    whole = np.repeat(SECONDS * flow[:, None], LATTICE.times, axis=1)
    return whole.reshape(LATTICE.shape).astype(np.float32)


def moving(flow) -> WindowEvents:
    """400 points with 20 events each along a flow (nodes, 2) in px/s, noise of 0.3 px."""
    rng = np.random.default_rng(5)
    points = np.repeat(rng.uniform([15, 15], [225, 165], (400, 2)), 20, axis=0)
    way = LATTICE.interpolate(SECONDS * flow, points)
    s = rng.uniform(0, 1, len(points))
    x, y = (points + (s[:, None] - 0.5) * way + rng.normal(0, 0.3, points.shape)).T
    on = np.repeat(rng.random(400) < 0.5, 20)
    order = np.argsort(s)
    return WindowEvents.prepare(*(c[order].astype(np.float32) for c in (x, y, s)), on[order])


def window(middle_ms: int) -> Window:
    middle = middle_ms * NS_PER_MS
    return Window(middle - NS // 2, middle + NS // 2, Events.empty())


def scene(middle_ms: int, *, travels: bool = True, w=W) -> EarlierScene:
    at = window(middle_ms)
    v = V if travels else np.zeros(3)
    return EarlierScene(
        at.t_start, at.t_end, field(rigid(W, V)), w, v, np.diag([1e-3] * 3 + [1e-2] * 3), travels
    )


def scenes() -> EarlierScenes:
    return EarlierScenes(LATTICE, EPIPOLAR, SCALES, LatticeConfig())


def test_inverse_depths_are_those_of_the_points():
    inner = np.linalg.norm(EPIPOLAR.a @ V, axis=-1) > 30  # away from the focus of expansion
    found = inverse_depths(EPIPOLAR, rigid(W, V), W, V)
    np.testing.assert_allclose(found[inner], INVERSE_DEPTH[inner], rtol=1e-3)
    assert (inverse_depths(EPIPOLAR, rigid(W, -V), W, V) == 0).all()  # behind the camera


def test_the_field_after_a_change_is_that_of_the_other_motion():
    known = KnownScene.at_depths(EPIPOLAR, rigid(W, V), INVERSE_DEPTH)
    change = np.concatenate([W_LATER - W, V_LATER - V])
    np.testing.assert_allclose(
        known.field(LATTICE, SECONDS, change), field(rigid(W_LATER, V_LATER)), atol=1e-4
    )


@pytest.mark.parametrize("free", [6, 3])
def test_events_tell_how_the_motion_has_changed(free):
    known = KnownScene.at_depths(EPIPOLAR, rigid(W, V), INVERSE_DEPTH)
    v = V_LATER if free == 6 else V
    prior = np.zeros(free), 1e-3 * np.eye(free)
    change, information = known.fit(SCALES, ((0.5, 4),), moving(rigid(W_LATER, v)), SECONDS, prior)
    np.testing.assert_allclose(change[:3], W_LATER - W, atol=0.03)
    np.testing.assert_allclose(change[3:], (v - V)[: free - 3], atol=0.1)
    assert (np.linalg.eigvalsh(information) > 1e-3).all()


def test_a_prior_that_is_certain_decides():
    known = KnownScene.at_depths(EPIPOLAR, rigid(W, V), INVERSE_DEPTH)
    expected = np.array([0.02, 0.0, -0.01, 0.1, 0.0, 0.0])
    certain = expected, 1e12 * np.eye(6)
    change, _ = known.fit(SCALES, ((0.5, 2),), moving(rigid(W_LATER, V_LATER)), SECONDS, certain)
    np.testing.assert_allclose(change, expected, atol=1e-6)


def test_the_scene_nearest_to_225_ms_is_chosen():
    kept = scenes()
    for middle in (500, 600, 730, 790, 900):
        kept.keep(scene(middle))
    chosen = kept.choose(window(1000))
    assert chosen is not None and chosen.t == 790 * NS_PER_MS
    kept.forget()
    assert kept.choose(window(1000)) is None


@pytest.mark.parametrize(("age_ms", "counts"), [(99, 0), (101, 1), (449, 1), (451, 0), (-200, 0)])
def test_scenes_too_young_or_too_old_do_not_count(age_ms, counts):
    kept = scenes()
    kept.keep(scene(1000 - age_ms))
    assert (kept.choose(window(1000)) is not None) == bool(counts)


def test_an_earlier_scene_explains_a_window_under_another_motion():
    """Its depths have moved with the flow; the camera turns and travels otherwise since."""
    seen = scene(800)
    recalled = scenes().explain(seen, window(1000), moving(rigid(W_LATER, V_LATER)))
    assert recalled is not None
    np.testing.assert_allclose(recalled.w, W_LATER, atol=0.06)
    error = np.linalg.norm(recalled.flow - field(rigid(W_LATER, V_LATER)), axis=-1)
    before = np.linalg.norm(seen.flow - field(rigid(W_LATER, V_LATER)), axis=-1)
    assert np.median(error) < 0.5 < 2.0 < np.median(before)


def test_where_no_travel_was_known_only_the_rotation_changes():
    recalled = scenes().explain(scene(800, travels=False), window(1000), moving(rigid(W_LATER, V)))
    assert recalled is not None
    np.testing.assert_allclose(recalled.w, W_LATER, atol=0.08)
    inner = np.s_[2:-2, 2:-2, 0]
    rest = (recalled.flow - field(EPIPOLAR.b @ recalled.w))[inner]
    before = (field(rigid(W, V)) - field(EPIPOLAR.b @ W))[inner]
    assert np.median(np.linalg.norm(rest - before, axis=-1)) < 0.5  # but for its way since


def test_a_wrong_scene_explains_nothing():
    """Depths that rise where they fall: the flow that comes of it lies far off."""
    wrong = EPIPOLAR.b @ W + INVERSE_DEPTH[::-1, None] ** 3 * 2 * (EPIPOLAR.a @ V)
    at = window(800)
    seen = EarlierScene(at.t_start, at.t_end, field(wrong), W, V, 1e-2 * np.eye(6), True)
    true = rigid(W_LATER, 2 * V)
    recalled = scenes().explain(seen, window(1000), moving(true))
    right = scenes().explain(scene(800), window(1000), moving(true))
    assert recalled is not None and right is not None
    errors = [np.median(np.linalg.norm(r.flow - field(true), axis=-1)) for r in (recalled, right)]
    assert errors[0] > 3 * errors[1]


def test_scenes_that_share_events_with_the_window_do_not_count():
    """Windows of 100 ms: one whose middle is 120 ms before, but which ends 1 ms after it begins."""
    kept, at = scenes(), window(1000)
    seen = scene(880)
    kept.keep(replace(seen, t_start=seen.t_start - 21 * NS_PER_MS, t_end=at.t_start + NS_PER_MS))
    assert kept.choose(at) is None
    kept.keep(replace(seen, t_end=at.t_start))
    assert kept.choose(at) is not None


def test_scenes_are_kept_by_age_however_often_windows_come():
    kept = scenes()
    for middle in range(100, 1000, 2):
        kept.keep(scene(middle))
    chosen = kept.choose(window(1000))
    assert chosen is not None and abs(chosen.t - 775 * NS_PER_MS) <= NS_PER_MS


def test_a_scene_that_is_not_finite_explains_nothing():
    broken = scene(800, w=np.array([np.nan, 0.0, 0.0]))
    assert scenes().explain(broken, window(1000), moving(rigid(W_LATER, V))) is None


def test_nodes_where_the_lens_has_no_inverse_spoil_no_others():
    camera = Camera(240, 180, 200.0, 200.0, 120.0, 90.0, "plumb_bob", (-0.9, 0.0, 0.0, 0.0))
    epipolar = NodeEpipolar(camera, LATTICE, 0.7)
    assert 10 < (~epipolar.usable).sum() < 50  # of 80
    flow = epipolar.b @ W + INVERSE_DEPTH[:, None] * (epipolar.a @ V)
    flow = np.where(epipolar.usable[:, None], flow, rigid(W, V))  # the flow goes on there
    kept = EarlierScenes(LATTICE, epipolar, SCALES, LatticeConfig())
    at = window(800)
    seen = EarlierScene(at.t_start, at.t_end, field(flow), W, V, 1e-3 * np.eye(6), True)
    later = epipolar.b @ W_LATER + INVERSE_DEPTH[:, None] * (epipolar.a @ V_LATER)
    recalled = kept.explain(seen, window(1000), moving(later * epipolar.usable[:, None]))
    assert recalled is not None
    error = np.linalg.norm(recalled.flow - field(later), axis=-1)[..., 0].ravel()
    assert error[epipolar.usable].max() < 1.0


def estimate(middle_ms: int, second_look_px: float, front: float = 1.0) -> Estimate:
    at = window(middle_ms)
    quality = Quality(8000, second_look_px=second_look_px)
    belief = Belief.of(at.t_end, W, front * V, np.diag([1e-3] * 3 + [1e-2] * 3)).facing(front)
    return Estimate(
        at.t_start, at.t_end, middle_ms * NS_PER_MS, Status.OK, quality, MotionModel.FULL,
        belief.v, W, belief.across(),
    )  # fmt: skip


def disagreement(check: CrossCheck, middle_ms: int = 1000) -> Disagreement:
    at, events = window(middle_ms), moving(rigid(W_LATER, V_LATER))
    check.begin(at, events)
    return check.disagreement(at, events, field(rigid(W_LATER, V_LATER)))


def checked(second_look_px: float) -> CrossCheck:
    """After one window, which the second look judged so."""
    check = CrossCheck(LATTICE, EPIPOLAR, LatticeConfig())
    check.keep(estimate(800, second_look_px), field(rigid(W, V)))
    return check


def test_a_right_flow_agrees_with_a_fresh_fit_and_with_an_earlier_scene():
    apart = disagreement(checked(0.5))
    assert apart.second_look_px < 1.5 and apart.earlier_px < 1.5
    assert apart.w is not None
    np.testing.assert_allclose(apart.w, SECONDS * W_LATER, atol=0.006)


def test_a_scene_that_the_second_look_did_not_bear_out_is_not_kept():
    apart = disagreement(checked(3.1))
    assert np.isnan(apart.earlier_px) and apart.w is None


def test_a_copy_from_a_checkpoint_keeps_the_scenes():
    check = checked(0.5)
    disagreement(check)
    copy = pickle.loads(pickle.dumps(check))
    again, expected = disagreement(copy, 1030), disagreement(check, 1030)
    assert again.earlier_px == expected.earlier_px > 0
    assert again.second_look_px == expected.second_look_px


def test_the_covariance_of_a_motion_turns_round_with_its_direction():
    """What a camera would turn more it would travel less: with -v it is more."""
    covariance = np.diag([1e-3] * 3 + [1e-2] * 3)
    covariance[1, 3] = covariance[3, 1] = 2e-3
    belief = Belief.of(0, W, np.array([0.0, 0.0, 1.0]), covariance)
    found = belief.facing(-1.0)
    np.testing.assert_allclose(found.v, [0.0, 0.0, -1.0])
    assert found.covariance[1, 3] == -2e-3 and found.across()[0, 4] == -2e-3
    np.testing.assert_allclose(found.covariance[:3, :3], belief.covariance[:3, :3])
    np.testing.assert_allclose(found.covariance[3:, 3:], belief.covariance[3:, 3:])
    np.testing.assert_allclose(motion_covariance(estimate(800, 0.5), V), covariance_of_estimate())


def test_the_covariance_of_a_motion_turns_with_its_direction():
    """By 40 degrees about x: the standard deviations across v stay, and the ties to w follow."""
    before = np.array([0.0, 0.0, 1.0])
    turn = Rotation.from_euler("x", 40, degrees=True).as_matrix()
    of_twist = np.diag([1e-2, 4e-2, 0.0, 1e-3, 1e-3, 1e-3])
    of_twist[1, 3] = of_twist[3, 1] = 2e-3  # v_y and w_x
    its = replace(estimate(800, 0.5), linear=before, covariance=of_twist)
    found = motion_covariance(its, turn @ before)
    of_v = turn @ np.diag([1e-2, 4e-2, 1.0]) @ turn.T
    np.testing.assert_allclose(found[3:, 3:], of_v, atol=1e-12)
    np.testing.assert_allclose(found[0, 3:], 2e-3 * turn[:, 1], atol=1e-12)
    np.testing.assert_allclose(found[:3, :3], 1e-3 * np.eye(3))


def covariance_of_estimate() -> np.ndarray:
    return Belief.of(0, W, V, np.diag([1e-3] * 3 + [1e-2] * 3)).covariance
