import numpy as np
import pytest
from scipy.ndimage import convolve1d

from emoflow_ros.core.smoothing import binomial, outwards, smooth


@pytest.mark.parametrize("variance", [1.0, 2.0])
def test_binomials_have_their_variance_and_come_near_to_gaussians(variance):
    taps = binomial(variance).astype(np.float64)
    at = np.arange(len(taps)) - len(taps) // 2
    assert taps.sum() == 1 and taps @ at**2 == variance
    gaussian = np.exp(-(at**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
    np.testing.assert_allclose(taps, gaussian, atol=0.025)


def test_binomials_in_turn_add_their_variances():
    np.testing.assert_array_equal(np.convolve(binomial(1.0), binomial(1.0)), binomial(2.0))


@pytest.mark.parametrize("shape", [(41, 57), (2, 2)])
def test_smooth_is_a_convolution_with_zeros_outside(shape):
    images = np.random.default_rng(1).normal(size=(2, *shape)).astype(np.float32)
    taps = binomial(2.0)
    expected = images.astype(np.float64)
    for axis in (1, 2):
        expected = convolve1d(expected, taps.astype(np.float64), axis, mode="constant")
    smooth(images, outwards(taps))
    np.testing.assert_allclose(images, expected, atol=1e-6)
