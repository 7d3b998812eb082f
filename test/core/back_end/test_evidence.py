"""What the adjustment is told of windows: how they lie between the nodes."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.back_end.evidence import Measured, prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.walks import Walks
from emoflow_ros.core.types.events import NS_PER_MS
from emoflow_ros.core.types.gyro import KnownBias

BACK = BackEndSettings()
T = np.array([100, 140, 200]) * NS_PER_MS


def shares(begin: int, end: int) -> list[float]:
    """Shares of a window, ms, between the nodes and after the newest."""
    window = Measured(begin * NS_PER_MS, end * NS_PER_MS, np.ones(3), np.eye(3), np.zeros(3))
    known = prior(T, (window,), Walks.unknown(BACK), BACK)
    assert known.measured.tolist() == [[1.0, 1.0, 1.0]]
    return known.measured_share[0].tolist()


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        ((120, 160), [0.5, 0.5, 0.0]),
        ((150, 190), [0.0, 1.0, 0.0]),
        ((180, 220), [0.0, 0.5, 0.5]),  # goes on after the newest node
        ((90, 120), [1.0, 0.0, 0.0]),  # began before the oldest
        ((130, 230), [0.1, 0.6, 0.3]),
    ],
)
def test_a_window_is_shared_out_by_time(window: tuple[int, int], expected: list[float]):
    assert shares(*window) == pytest.approx(expected)


def test_windows_beyond_the_nodes_tell_nothing():
    far = Measured(300 * NS_PER_MS, 400 * NS_PER_MS, np.ones(3), np.eye(3), np.zeros(3))
    known = prior(T, (far,), Walks.unknown(BACK), BACK)
    assert known.measured.shape == (0, 3)
    assert known.measured_share.shape == (0, 3)


def test_windows_of_a_gyro_are_without_the_newest_bias():
    lattice = Measured(110 * NS_PER_MS, 130 * NS_PER_MS, np.ones(3), np.eye(3), np.zeros(3))
    older = replace(lattice, bias=KnownBias(np.array([0.1, 0.0, 0.0]), np.eye(3)))
    newest = replace(lattice, bias=KnownBias(np.array([0.3, -0.2, 0.0]), np.diag([0.5, 0.25, 0.2])))
    known = prior(T, (lattice, older, newest), Walks.unknown(BACK), BACK)
    assert known.measured_biased.tolist() == [False, True, True]
    assert known.bias_information == pytest.approx(np.diag([2.0, 4.0, 5.0]))
    expected = np.array([[1.0, 1.0, 1.0], [0.8, 1.2, 1.0], [1.0, 1.0, 1.0]])
    assert known.measured == pytest.approx(expected)
