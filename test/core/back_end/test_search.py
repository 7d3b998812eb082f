"""Starts of the adjustment: depths are looked for, and outliers told from a guess step by step."""

import numpy as np
import pytest
from small_problem import DEPTHS, T, W, prior, problem, start, truth

from emoflow_ros.core.back_end.adjustment import adjust
from emoflow_ros.core.back_end.adjustment_kernels import Observations, likeliest_depths
from emoflow_ros.core.back_end.search import best
from emoflow_ros.core.back_end.settings import BackEndSettings

SETTINGS = BackEndSettings()


def partly_wrong(seed: int = 5) -> Observations:
    """Observations of which a third lies far off."""
    rng, o = np.random.default_rng(seed), problem()
    wrong = rng.random(len(o.patch)) < 0.33
    return o._replace(seen=o.seen + 0.05 * wrong[:, None] * rng.normal(size=o.seen.shape))


def test_depths_along_the_true_way_are_the_next_ones():
    x = truth()
    found = likeliest_depths(
        problem(), x._replace(inverse_depth=np.ones_like(x.inverse_depth)), 2.0
    )
    assert np.median(np.abs(np.log(found / x.inverse_depth))) < 0.15
    assert np.abs(np.log(found / x.inverse_depth)).max() < 0.5


def test_the_better_of_two_starts_is_taken():
    o = partly_wrong()
    poor = start()
    poor = poor._replace(angular=poor.angular + 2.0)
    alone = adjust(o, poor, prior(), SETTINGS.outlier, 1, DEPTHS)
    result = best(o, poor, prior(), [start()], SETTINGS)
    assert result is not None
    found, _ = result
    assert found.cost < alone.cost
    exact = adjust(o, truth(), prior(), SETTINGS.outlier, 40, DEPTHS)
    assert found.cost == pytest.approx(exact.cost, rel=0.05)
    assert found.x.angular[len(T) // 2] == pytest.approx(W, abs=0.03)
