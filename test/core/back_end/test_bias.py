"""What an adjustment tells of a gyro's bias."""

import numpy as np
import pytest
from independent_adjustment import best_by_scipy, with_gyro
from small_problem import DEPTHS, NODES, NOT_ROBUST, T, W, prior, problem, start

from emoflow_ros.core.back_end.adjustment import adjust
from emoflow_ros.core.back_end.bias import seen_bias


def test_the_bias_of_a_gyro_is_that_of_scipy():
    known = with_gyro()
    found = adjust(problem(), start(), known, NOT_ROBUST, 40, DEPTHS)
    seen = seen_bias(found, known)
    best, covariance = best_by_scipy(known)
    # what the events show, and what was known before, make all that is known
    of_events = np.linalg.inv(seen.covariance)
    posterior = np.linalg.inv(of_events + known.bias_information)
    assert posterior @ of_events @ seen.excess == pytest.approx(best.x[-3:], rel=0.02)
    assert posterior == pytest.approx(covariance[-3:, -3:], rel=0.05, abs=1e-6)
    assert seen.seconds == pytest.approx((T[-1] - T[0]) * 1e-9)


def test_places_show_the_bias_of_a_gyro():
    bias, shares = np.array([0.02, -0.03, 0.01]), np.full((1, NODES), 1 / (NODES - 1))
    shares[0, -1] = 0.0
    known = prior()._replace(
        measured=W[None] + bias, measured_share=shares, measured_root=np.eye(3)[None] / 1e-4,
        measured_biased=np.ones(1, np.bool_), bias_information=np.eye(3) / 0.02**2,
    )  # fmt: skip
    found = adjust(problem(noise=0.0), start(), known, NOT_ROBUST, 60, DEPTHS)
    assert seen_bias(found, known).excess == pytest.approx(bias, abs=2e-3)
    assert seen_bias(found, prior()) is None


def test_where_places_tell_nothing_no_bias_is_seen():
    known, o = with_gyro()._replace(measured_biased=np.ones(3, np.bool_)), problem()
    blind = o._replace(root=1e-9 * o.root)
    assert seen_bias(adjust(o, start(), known, NOT_ROBUST, 40, DEPTHS), known) is not None
    assert seen_bias(adjust(blind, start(), known, NOT_ROBUST, 40, DEPTHS), known) is None
