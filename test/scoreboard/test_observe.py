"""What the scoreboard notes about each window, with an estimator that knows the truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks._scoring import SimulatedTruth
from benchmarks.scoreboard import observe as observing
from benchmarks.scoreboard.figures import errors_of, figures_of
from benchmarks.scoreboard.observe import observe, start_times
from benchmarks.scoreboard.subjects import Material
from benchmarks.scoreboard.truths import NominalFlow, relative_pose, true_rotation
from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import Events
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.truth import TrueFlow, TrueTwist, Truth
from emoflow_ros.truth.text_truth import ConstantRotation

MS = 1_000_000
CAMERA = Camera(96, 72, 80.0, 80.0, 48.0, 36.0)
CONFIG = load_config(overrides={"window.stride_ms": 67.5})


@pytest.fixture(scope="module")
def calm():
    made = simulate("calm", duration_s=0.32, seed=1, camera=CAMERA, fps=100)
    truth = SimulatedTruth(made.truth)
    return Material(made.events, CAMERA, CAMERA, Truth(truth, truth)), made.truth


class Oracle:
    """Answers with the truth, its flow off by a constant; every third window without estimate."""

    def __init__(self, truth, offset_px):
        self._truth, self._offset, self._windows = truth, offset_px, 0

    def estimate(self, window):
        self._windows += 1
        t = (window.t_start + window.t_end) // 2
        bounds = (window.t_start, window.t_end, t)
        if self._windows % 3 == 0:
            return Estimate(*bounds, Status.NO_MOTION, Quality(events=1))
        linear, angular = self._truth.twist(t)
        return Estimate(
            *bounds,
            Status.OK,
            Quality(events=len(window.events)),
            MotionModel.FULL,
            linear / np.linalg.norm(linear),
            angular,
            1e-4 * np.eye(6),
            flow=SimpleNamespace(tracks=self._tracks),
        )

    def _tracks(self, points, times):
        flow = self._truth.displacement(*times)
        columns, rows = points.astype(int).T
        return np.stack([points, points + flow[rows, columns] + [self._offset, 0.0]])


@pytest.fixture
def oracle(monkeypatch, calm):
    calibrations = []

    def make(camera, config):
        calibrations.append(camera)
        return Oracle(calm[1], 0.25)

    monkeypatch.setattr(observing, "make_estimator", make)
    return calibrations


def test_the_truth_itself_is_accurate_and_its_flow_error_is_what_was_added(calm, oracle):
    material, _ = calm
    windows = observe(material, CONFIG)
    assert np.unique(windows["start"]).tolist() == [0, 1]
    assert windows["ok"].tolist() == [True, True, False, True, True]
    assert np.isfinite(windows["epe_px"]).tolist() == windows["ok"].tolist()
    found = figures_of(windows)
    assert found.w_rms == pytest.approx(0.0, abs=1e-9)
    directions = errors_of(windows).v
    np.testing.assert_allclose(directions[windows["ok"]], 0.0, atol=1e-4)
    assert found.epe_px == pytest.approx(0.25, abs=1e-5)
    assert (found.still, found.covered_still) == (5, 80.0)  # the small image moves by 1 px


def test_each_start_has_an_estimator_that_is_told_the_calibration(calm, oracle):
    told = replace(CAMERA, fx=81.0)
    observe(replace(calm[0], calibration=told), CONFIG)
    assert oracle == [told, told]


def test_the_way_of_the_image_pixel_by_pixel(calm, oracle):
    material, truth = calm
    windows = observe(material, CONFIG)
    assert not windows["ok"][2]
    for window in windows[[0, 2]]:
        _check_way(window, material.events, truth)
    inexact = observe(replace(material, exact_flow=False), CONFIG)
    assert np.isnan(inexact["truth_px"]).all()


def _check_way(window, events, truth):
    begin, end = int(window["t_window"]), int(window["t_end"])
    flow = truth.displacement(begin, end)
    pixels = {
        (int(x), int(y))
        for x, y, t in zip(events.x, events.y, events.t, strict=True)
        if begin <= t < end
    }
    lengths = [float(np.hypot(*flow[y, x])) for x, y in pixels]
    assert window["moved_px"] == pytest.approx(np.median(lengths), rel=1e-5)
    assert window["truth_px"] == pytest.approx(np.mean(lengths), rel=1e-5)


def test_parallax_is_what_the_rotation_leaves(calm, oracle):
    material, truth = calm
    window = observe(material, CONFIG)[0]
    begin, end = int(window["t_window"]), int(window["t_end"])
    flow = truth.displacement(begin, end)
    turn = truth.pose(end)[:3, :3].T @ truth.pose(begin)[:3, :3]
    chosen = (material.events.t >= begin) & (material.events.t < end)
    lengths = []
    columns, rows = material.events.x[chosen], material.events.y[chosen]
    for x, y in {(int(x), int(y)) for x, y in zip(columns, rows, strict=True)}:
        a, b, c = turn @ [(x - 48.0) / 80.0, (y - 36.0) / 80.0, 1.0]
        turned = 80.0 * a / c + 48.0 - x, 80.0 * b / c + 36.0 - y
        lengths.append(float(np.hypot(flow[y, x, 0] - turned[0], flow[y, x, 1] - turned[1])))
    assert window["parallax_px"] == pytest.approx(np.mean(lengths), rel=1e-4)


def test_a_mover_before_a_camera_at_rest_is_no_motion(oracle):
    displacement = np.zeros((72, 96, 2), np.float32)
    displacement[20:50, 20:50] = 9.0
    moving = displacement[..., 0] > 0
    flow = TrueFlow(displacement, np.ones((72, 96), np.bool_), moving)
    still = SimpleNamespace(
        name="still",
        description="",
        twist=lambda t: TrueTwist(np.zeros(3), np.zeros(3)),
        displacement=lambda t0, t1: flow,
    )
    n = 20_000
    x, y = np.random.default_rng(0).integers(20, 50, (2, n)).astype(np.uint16)
    events = Events(x, y, np.linspace(0, 300 * MS, n).astype(np.int64), np.zeros(n, np.bool_))
    x[::100] = 5  # some noise on the background
    windows = observe(Material(events, CAMERA, CAMERA, Truth(still, still)), CONFIG)
    assert len(windows) > 0
    assert (windows["moved_px"] == 0).all()
    assert np.isnan(windows["true_linear"]).all()


def test_the_second_start_is_later_but_leaves_two_thirds_of_short_recordings(calm):
    def with_span(ns):
        t = np.array([5, 5 + ns], np.int64)
        zeros = np.zeros(2, np.uint16)
        return replace(calm[0], events=Events(zeros, zeros, t, zeros > 0))

    assert start_times(with_span(3000 * MS)) == (5, 5 + 370 * MS)
    assert start_times(with_span(300 * MS)) == (5, 5 + 100 * MS)


def test_a_recording_without_events_has_no_windows(calm):
    assert len(observe(replace(calm[0], events=Events.empty()), CONFIG)) == 0


def test_the_same_recording_gives_the_same_figures(calm):
    first, second = (figures_of(observe(calm[0], CONFIG)) for _ in range(2))
    assert repr(replace(first, window_ms=0.0)) == repr(replace(second, window_ms=0.0))


def test_velocities_are_integrated_to_poses():
    rate = np.array([0.3, -2.0, 1.0])
    source = ConstantRotation(CAMERA, rate, "test")
    pose = relative_pose(source, 0, 200 * MS)
    exact = source.displacement(0, 200 * MS)
    ours = NominalFlow(source, CAMERA, 1.0).displacement(0, 200 * MS)
    assert pose is not None
    assert ours is not None
    np.testing.assert_array_equal(pose[1], 0)
    np.testing.assert_array_equal(ours.valid, exact.valid)
    np.testing.assert_allclose(ours.displacement, exact.displacement, atol=1e-3)


def test_a_plane_at_a_nominal_depth_moves_by_focal_length_times_way_over_depth():
    class Slider:
        name = "slider"

        def twist(self, t):
            return TrueTwist(np.zeros(3), np.array([0.3, 0, 0])) if t > 50 * MS else None

    flow = NominalFlow(Slider(), CAMERA, 0.5).displacement(0, 100 * MS)
    assert flow is not None
    np.testing.assert_allclose(flow.displacement[..., 0], -80 * 0.03 / 0.5, rtol=1e-5)
    assert relative_pose(Slider(), 0, 40 * MS) is None


def test_rotation_comes_from_poses_where_they_are_known(calm):
    _, truth = calm
    poses = SimpleNamespace(covers=lambda t: t >= 0, transform=truth.pose)
    twists = SimulatedTruth(truth)
    exact = true_rotation(Truth(twists, poses=poses), 0, 100 * MS)
    integrated = true_rotation(Truth(twists), 0, 100 * MS)
    np.testing.assert_allclose(integrated, exact, atol=1e-6)
    assert true_rotation(Truth(), 0, 100 * MS) is None
