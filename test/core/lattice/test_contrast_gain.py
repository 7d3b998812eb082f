"""The contrast of warped events over that of the events as they came."""

import numpy as np
import pytest
from test_contrast import LATTICE, SCALES, constant, on_pixels

from emoflow_ros.core.lattice.contrast import Contrast, contrast_gain
from emoflow_ros.core.lattice.window_events import WindowEvents

UNMOVED = np.zeros((1, 2), np.float32)


def test_unlike_polarities_cancel():
    """On pixels of the image, where votes have no fractions to round."""
    x, y = on_pixels([40, 40], [30, 30])
    events = WindowEvents(*np.float32([x, y, [0.5, 0.5], [1, -1]]))
    contrast = Contrast(LATTICE, 1.0)
    assert contrast.scores(events, UNMOVED)[0] == 0
    assert contrast_gain(contrast, events, constant(5, 5)) == 0


def test_the_gain_over_nothing_but_rounding_is_none():
    """The votes of many ON and OFF events of equal places do not cancel to the last bit."""
    rng = np.random.default_rng(0)
    x, y = np.repeat(rng.integers(10, 80, (2, 3000)), 2, axis=1).astype(np.float32)
    s = np.sort(rng.random(len(x))).astype(np.float32)
    events = WindowEvents(x, y, s, np.float32([1.1, -1.1] * 3000))
    contrast = Contrast(LATTICE, 1.0)
    left = contrast.scores(events, UNMOVED)[0]
    assert 0 < left < 1e-6 * contrast.sharpen(events, constant(9, -4))
    assert contrast_gain(contrast, events, constant(9, -4)) == 0


@pytest.mark.parametrize("scale", SCALES)
def test_noise_on_whole_pixels_is_as_sharp_warped_as_it_came(scale):
    """In images of the sensor's own pixels the ratio would be 0.87 at full resolution."""
    rng = np.random.default_rng(4)
    x, y = rng.integers(0, (120, 90), (20_000, 2)).astype(np.float32).T
    noise = WindowEvents.prepare(
        x, y, np.sort(rng.random(len(x))).astype("f4"), rng.random(len(x)) < 0.5
    )
    contrast = Contrast(LATTICE, scale)
    gains = [
        contrast_gain(contrast, noise, constant(*rng.normal(scale=6, size=2))) for _ in range(20)
    ]
    assert np.mean(gains) == pytest.approx(1.0, abs=0.04)
