"""One word for why the covariance of an estimate is large."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from emoflow_ros.core.products.wide import why_wide
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status

DEGREE = np.radians(1.0)
GOOD = Quality(20_000, stop_reason="converged", contrast_gain=1.8, warm=True)


def estimate(w_deg_s: float, v_deg: float = 5.0, **quality: Any) -> Estimate:
    covariance = np.diag([v_deg**2, v_deg**2, 0.0] + [w_deg_s**2] * 3) * DEGREE**2
    return Estimate(
        0, 2, 1, Status.OK, replace(GOOD, **quality), MotionModel.FULL, np.array([0.0, 0.0, 1.0]),
        covariance=covariance,
    )  # fmt: skip


@pytest.mark.parametrize(("found", "word"), [
    (estimate(4.9), ""),
    (estimate(4.9, 14.0, warm=False), ""),
    (estimate(5.1), "ambiguous"),
    (estimate(1.0, 16.0), "ambiguous"),
    (estimate(5.1, warm=False), "start"),
    (estimate(5.1, events=4_000), "events"),
    (estimate(5.1, contrast_gain=1.2), "motion"),
])  # fmt: skip
def test_the_word_follows_from_the_record_of_the_fit(found, word):
    assert why_wide(found) == word


@pytest.mark.parametrize("status", [Status.CARRIED, Status.BOUNDED, Status.LOST])
def test_what_was_not_measured_says_why(status):
    found = replace(estimate(1.0, stop_reason="too_few_events"), status=status)
    assert why_wide(found) == "too_few_events"


def test_rest_and_windows_without_a_motion_need_no_word():
    for status in (Status.STILL, Status.NO_MOTION, Status.DIVERGED):
        wide = replace(estimate(1.0, stop_reason=str(status)), status=status)
        assert why_wide(wide) == ""
