"""What widens the covariance of an adjustment: revisions, the lattice, misfits, few patches."""

import numpy as np
import pytest

from emoflow_ros.core.back_end.consistency import Revisions, covariance_factor
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import MotionAt

SETTINGS = BackEndSettings()
W = np.array([0.1, -0.2, 0.3])
SD = 0.02  # rad/s


def told(angular: np.ndarray = W) -> MotionAt:
    return MotionAt(angular, np.zeros(3), np.diag(np.repeat([1.0, SD**2], 3)))


def factor(cost: float = 1.0, shown: int = 100, apart: float = 0.0, revision: float = 0.1) -> float:
    measured = W + np.array([apart * SD, 0.0, 0.0])
    return covariance_factor(told(), cost, shown, measured, revision, SETTINGS)


def test_the_covariance_grows_with_misfits_and_falls_with_the_number_of_patches():
    assert factor(cost=4.0) == pytest.approx(4 * factor(cost=1.0))
    assert factor(cost=0.1) == factor(cost=0.2)  # fewer errors than expected are not believed
    assert factor(shown=25) == pytest.approx(2 * factor(shown=100))
    assert factor(shown=0) == factor(shown=SETTINGS.fewest_shown)


def test_another_motion_by_the_lattice_counts_by_its_square():
    near, far, farther = (factor(apart=n) for n in (0.0, 3.0, 6.0))
    assert far / near == pytest.approx(1 + 3.0)
    assert farther / near == pytest.approx(1 + 12.0)


def test_revisions_are_learnt_from_what_the_next_adjustment_changes():
    start = Revisions(0.1)
    assert start.after(told(), SETTINGS) == 0.1  # nothing was told before
    before = Revisions(0.1, 5, told())
    assert before.after(None, SETTINGS) == 0.1
    share = SETTINGS.revision_share
    for change, squared in ((1.0, 1 / 3), (30.0, SETTINGS.most_revision)):
        again = told(W + np.array([0.0, change * SD, 0.0]))
        mean = (1 - share) * 0.1 + share * squared
        assert before.after(again, SETTINGS) == pytest.approx(mean)
    assert factor(revision=0.4) == pytest.approx(4 * factor(revision=0.1))
