"""A flow bent within its window: the middle moves, the way over the window stays."""

import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import motion_field
from emoflow_ros.core.lattice.bending import Bend
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow

CAMERA = Camera(173, 130, 120.0, 120.0, 86.0, 64.5)
END = 100_000_000


class Trembling:
    """A rotation that swings once over the window (a Motion)."""

    def __init__(self, amplitude: float) -> None:
        self._amplitude = amplitude

    def angular(self, t: int) -> np.ndarray:
        return np.array([0.2, self._amplitude * np.cos(2 * np.pi * t / END), 0.0])

    def linear(self, _: int) -> np.ndarray:
        return np.zeros(3)


def flow() -> LatticeFlow:
    lattice = Lattice.with_spacing(173, 130, 26.0)
    values = np.random.default_rng(1).normal(0, 5, lattice.shape).astype(np.float32)
    return LatticeFlow(lattice, values, 0, END)


def test_the_middle_moves_by_the_rotation_off_its_mean():
    straight, bent = flow(), Bend(CAMERA)(flow(), Trembling(0.5))
    assert bent.values.shape[2] == 3
    mean = (straight.values[:, :, 0] + straight.values[:, :, 1]) / 2
    of_w = motion_field(CAMERA, straight.lattice.pixels)[1][:, :, 1]  # by rad/s about y
    expected = (-0.5 * of_w * (END / 1e9)).reshape(mean.shape)
    assert np.abs(expected).max() > 5
    assert bent.values[:, :, 1] - mean == pytest.approx(expected, abs=1e-4)


def test_the_mean_over_the_window_stays():
    straight, bent = flow(), Bend(CAMERA)(flow(), Trembling(0.5))
    begin, middle, end = (bent.values[:, :, k] for k in range(3))
    trapezoids = (begin + 2 * middle + end) / 4
    change = straight.values[:, :, 1] - straight.values[:, :, 0]
    assert trapezoids == pytest.approx(straight.values.mean(axis=2), abs=1e-4)
    assert end - begin == pytest.approx(change, abs=1e-4)


def test_a_steady_rotation_bends_nothing():
    straight, bent = flow(), Bend(CAMERA)(flow(), Trembling(0.0))
    assert bent.values[:, :, 1] == pytest.approx(straight.values.mean(axis=2), abs=1e-4)
    assert bent.values[:, :, ::2] == pytest.approx(straight.values, abs=1e-4)
