import numpy as np
import pytest
from scipy.ndimage import convolve1d

from emoflow_ros.core.numerics.smoothing import gaussian, outwards, smooth


def test_gaussian():
    taps = gaussian(2.0).astype(np.float64)
    assert taps.sum() == pytest.approx(1, rel=1e-6)
    np.testing.assert_allclose(taps / taps[5], np.exp(-(np.arange(-5, 6) ** 2) / 8), rtol=1e-5)


@pytest.mark.parametrize("shape", [(41, 57), (2, 2)])
def test_smooth_is_a_convolution_with_zeros_outside(shape):
    images = np.random.default_rng(1).normal(size=(2, *shape)).astype(np.float32)
    taps = gaussian(2.0)
    expected = images.astype(np.float64)
    for axis in (1, 2):
        expected = convolve1d(expected, taps.astype(np.float64), axis, mode="constant")
    smooth(images, outwards(taps))
    np.testing.assert_allclose(images, expected, atol=1e-6)
