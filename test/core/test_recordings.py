"""The real-time estimator on real events: rotations of the Event-Camera Dataset, one window each.

The magnitude of the reference is uncertain: contrast peaks at 1.13 to 1.15 times it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.calibration import load_calibration
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.types.events import NS_PER_S, Events, WindowPolicy, WindowSlicer


@dataclass(frozen=True)
class Slice:
    camera: Camera
    events: Events
    w: np.ndarray
    estimate: Estimate


def load_events(path: Path) -> Events:
    t, x, y, p = np.loadtxt(path).T
    ns = np.round(t * NS_PER_S).astype(np.int64)
    return Events(x.astype(np.uint16), y.astype(np.uint16), ns, p > 0)


@pytest.fixture(scope="module", params=[("shapes_rotation", 98.0), ("dynamic_rotation", 21.0)])
def rotation(request, shared_data) -> Slice:
    name, duration_ms = request.param
    folder = shared_data / "ecd" / name
    if not folder.is_dir():
        pytest.skip(f"no recording {folder}")
    camera = load_calibration(folder / "calib.txt")
    slicer = WindowSlicer(WindowPolicy(duration_ms=duration_ms))
    (window,) = slicer.push(load_events(folder / "events.txt"))
    estimate = LatticeEstimator(camera, LatticeConfig()).estimate(window)
    return Slice(
        camera, window.events, np.loadtxt(folder / "motion.txt").reshape(-1)[-3:], estimate
    )


def test_it_is_seen_to_be_a_rotation(rotation):
    assert rotation.estimate.status is Status.OK
    assert rotation.estimate.model is MotionModel.ROTATION
    assert rotation.estimate.quality.contrast_gain > 1.5
    assert not rotation.estimate.translation_observable
    np.testing.assert_array_equal(rotation.estimate.linear, 0)
    assert rotation.estimate.covariance[0, 0] == -1


def test_axis_of_the_rotation(rotation):
    found, true = rotation.estimate.angular, rotation.w
    lengths = np.linalg.norm(found), np.linalg.norm(true)
    assert np.degrees(np.arccos(found @ true / np.prod(lengths))) < 4


def variance_of_turned_events(rotation: Slice, w: np.ndarray) -> float:
    """Variance of the events' image, turned back to the slice's middle ray by ray."""
    camera, events = rotation.camera, rotation.events
    rays = np.column_stack([camera.bearings[events.y, events.x], np.ones(len(events))])
    seconds = (events.t - rotation.estimate.t) / NS_PER_S
    # A ray of the scene turns against the camera: back in time it turns with it.
    x, y = camera.project(Rotation.from_rotvec(seconds[:, None] * w).apply(rays)).T
    image = np.zeros((camera.height, camera.width))
    for column in (np.floor(x), np.floor(x) + 1):
        for row in (np.floor(y), np.floor(y) + 1):
            votes = (1 - np.abs(x - column)) * (1 - np.abs(y - row))
            inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
            pixels = row[inside].astype(int), column[inside].astype(int)
            np.add.at(image, pixels, votes[inside])
    return float(image.var())


def test_speed_is_the_one_of_highest_contrast(rotation):
    scales = np.arange(0.8, 1.3, 0.01)
    contrast = [variance_of_turned_events(rotation, k * rotation.estimate.angular) for k in scales]
    assert 0.95 <= scales[np.argmax(contrast)] <= 1.05
    assert max(contrast) > 1.5 * variance_of_turned_events(rotation, np.zeros(3))


def test_flow_is_that_of_the_estimated_rotation(rotation):
    """U = B w on the bearings of the lens, back to pixels."""
    camera, estimate = rotation.camera, rotation.estimate
    x, y = np.moveaxis(camera.bearings.astype(np.float64), -1, 0)
    wx, wy, wz = estimate.angular
    u = np.stack([x * y * wx - (1 + x * x) * wy + y * wz,
                  (1 + y * y) * wx - x * y * wy - x * wz], -1)  # fmt: skip
    lens = np.linalg.inv(camera.flow_jacobian.astype(np.float64))
    expected = np.einsum("...ij,...j->...i", lens, u)
    error = np.linalg.norm(estimate.flow.velocity(estimate.t) - expected, axis=-1)
    assert np.median(error) < 0.05 * np.median(np.linalg.norm(expected, axis=-1))
