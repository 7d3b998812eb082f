"""The tremor in a window's middle, of points that turn with a camera whose motion is known."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.camera_motion import SplineMotion
from emoflow_ros.core.contrast import Contrast
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import Window
from emoflow_ros.core.gyro_config import GyroConfig
from emoflow_ros.core.gyro_measurement import GyroReadings
from emoflow_ros.core.lattice import Lattice, LatticeFlow
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.lattice_estimator import LatticeEstimator
from emoflow_ros.core.lattice_kernels import bilinear
from emoflow_ros.core.preparation import WorkingImage
from emoflow_ros.core.tremor import Tremor
from emoflow_ros.core.window_events import WindowEvents
from emoflow_ros.simulation.recording import simulate

CAMERA = Camera(346, 260, 226.4, 226.2, 173.6, 133.7)
LATTICE = Lattice.with_spacing(346, 260, 26.0)
EPIPOLAR = NodeEpipolar(CAMERA, LATTICE, 0.7)
CONTRASTS = {scale: Contrast(LATTICE, scale) for scale in (0.25, 0.5)}
TREMOR = Tremor(WorkingImage.of(CAMERA), EPIPOLAR, CONTRASTS)
NS = 135_000_000
SECONDS = NS * 1e-9
TURN = np.radians([5.0, -30.0, 4.0])  # rad/s, the mean over the window
KNOWN = np.eye(6) * np.radians(1.0) ** 2


def flow_of(w: np.ndarray) -> np.ndarray:
    """Flow of a rotation w (3,) in rad/s, px per window."""
    nodes = (EPIPOLAR.b @ (w * SECONDS)).reshape(LATTICE.columns, LATTICE.rows, 1, 2)
    return np.repeat(nodes, 2, axis=2).astype(np.float32)


def events(tremor: np.ndarray, points: int = 400, each: int = 25) -> WindowEvents:
    """Points that turn by TURN and one period of a cosine, which is `tremor` (3,) in the middle."""
    rng = np.random.default_rng(0)
    place = rng.uniform([20, 20], [325, 240], (points, 2)).repeat(each, axis=0)
    s = rng.random(points * each).astype(np.float32)
    on = (rng.random(points) < 0.5).repeat(each)
    # the cosine is 1 in the middle, s = 1/2, and has no mean: so far it has turned by that
    shake = -np.sin(2 * np.pi * s) / (2 * np.pi)
    moved = (s - 0.5)[:, None] * flow_at(place, TURN) + shake[:, None] * flow_at(place, tremor)
    x, y = (place + moved).astype(np.float32).T
    order = np.argsort(s)
    return WindowEvents.prepare(x[order], y[order], s[order], on[order])


def flow_at(points: np.ndarray, w: np.ndarray) -> np.ndarray:
    return bilinear(LATTICE.at_time(flow_of(w), 0.5), points, LATTICE.per_px)


def fitted() -> Estimate:
    """An estimate of the mean rotation."""
    return Estimate(
        0, NS, NS // 2, Status.OK, Quality(10_000), MotionModel.ROTATION,
        angular=TURN, covariance=KNOWN,
        flow=LatticeFlow(LATTICE, flow_of(TURN), 0, NS),
        motion=SplineMotion(0, NS, np.tile(TURN, (4, 1)), np.zeros((4, 3))),
    )  # fmt: skip


@pytest.mark.parametrize("axis", [0, 1])
def test_the_events_of_the_middle_tell_the_tremor(axis):
    tremor = np.radians(20.0) * np.eye(3)[axis]
    found = TREMOR.add_to(fitted(), events(tremor), flow_of(TURN))
    change = found.angular - TURN
    # The least squares line through the way of the cosine has 0.687 of its height as its slope.
    assert 0.6 < change[axis] / tremor[axis] < 0.75
    assert np.abs(np.delete(change, axis)).max() < 0.15 * tremor[axis]
    added = np.degrees(np.sqrt(np.diag(found.covariance[3:, 3:] - KNOWN[3:, 3:])))
    assert ((added > 0.5) & (added < 8)).all()  # less than the 8 deg/s that are expected
    assert (found.covariance[:3] == KNOWN[:3]).all()


def test_flow_and_motion_hold_in_the_middle_and_stay_over_the_window():
    before = fitted()
    found = TREMOR.add_to(before, events(np.radians([0.0, 20.0, 0.0])), flow_of(TURN))
    w = found.angular - TURN
    assert found.motion.angular(found.t) == pytest.approx(found.angular, abs=1e-12)
    over = np.mean([found.motion.angular(int(t)) for t in np.linspace(0, NS, 1001)], axis=0)
    assert over == pytest.approx(TURN, abs=1e-2 * np.abs(w).max())
    more = found.flow.velocity(found.t) - before.flow.velocity(before.t)
    expected = LATTICE.image(flow_of(w)[:, :, 0]) / SECONDS
    assert np.abs(more - expected).max() < 1e-3 * np.abs(expected).max() + 0.01
    moved = found.flow.displacement(0, NS) - before.flow.displacement(0, NS)
    assert np.abs(moved).max() < 0.05


@pytest.mark.parametrize(
    "window",
    [events(np.zeros(3)), events(np.radians([0.0, 20.0, 0.0]), points=10)],
    ids=["no tremor", "few events"],
)
def test_nothing_is_added_where_the_middle_tells_nothing(window):
    before = fitted()
    assert TREMOR.add_to(before, window, flow_of(TURN)) is before


def test_noise_tells_no_tremor():
    rng = np.random.default_rng(1)
    x, y = (rng.uniform(0, [[345], [259]], (2, 8000))).astype(np.float32)
    s = np.sort(rng.random(8000)).astype(np.float32)
    noise = WindowEvents.prepare(x, y, s, rng.random(8000) < 0.5)
    before = fitted()
    after = TREMOR.add_to(before, noise, flow_of(TURN))
    assert np.degrees(np.linalg.norm(after.angular - TURN)) < 0.5


def test_on_a_larger_sensor_the_flow_of_the_tremor_is_in_its_pixels():
    sensor = CAMERA.resized(692, 520)
    image = WorkingImage.of(sensor)
    tremor = Tremor(image, EPIPOLAR, CONTRASTS)
    lattice, field = image.on_sensor(LATTICE, flow_of(TURN))
    before = replace(fitted(), flow=LatticeFlow(lattice, field, 0, NS))
    found = tremor.add_to(before, events(np.radians([0.0, 20.0, 0.0])), flow_of(TURN))
    more = (found.flow.velocity(found.t) - before.flow.velocity(before.t))[260, 346]
    w = found.angular - TURN
    assert more[0] == pytest.approx(-sensor.fx * w[1], rel=0.02)  # u = -f w_y beside the middle


TURNING = simulate("rotation", duration_s=0.3, seed=0)


@pytest.mark.parametrize(
    ("options", "gyro", "asked"),
    [
        pytest.param({}, False, True, id="by events"),
        pytest.param({"model": "translation"}, False, False, id="no turn"),
        pytest.param({"deadline_ms": 1e-6}, False, False, id="late"),
        pytest.param({}, True, False, id="gyro"),
    ],
)
def test_the_estimator_asks_for_a_tremor_where_the_events_tell_w(monkeypatch, options, gyro, asked):
    seen = []
    monkeypatch.setattr(Tremor, "add_to", lambda self, estimate, *_: seen.append(1) or estimate)
    camera, begin = TURNING.camera, int(TURNING.events.t[0])
    estimator = LatticeEstimator(camera, LatticeConfig(**options), imu=GyroConfig(use="auto"))
    end = begin + 60_000_000
    window = Window(begin, end, TURNING.events[: np.searchsorted(TURNING.events.t, end)])
    if gyro:
        t = begin + np.arange(-20, 90) * 1_000_000
        w = np.array([TURNING.truth.twist(int(each))[1] for each in t])
        window = window.with_gyro(GyroReadings(t, w))
    assert estimator.estimate(window).status is Status.OK
    assert bool(seen) is asked
