"""Smoothing of images by symmetric kernels, in numba."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import fast

F32 = NDArray[np.float32]

# A symmetric kernel from its middle outwards. The length of a tuple is known to the compiler, which
# unrolls the loops over it.
type Taps = tuple[np.float32, ...]


def gaussian(sigma: float) -> F32:
    """Sampled Gaussian with sum 1, to 2.5 sigma on either side."""
    reach = int(np.ceil(2.5 * sigma))
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return (taps / taps.sum()).astype(np.float32)


def outwards(taps: F32) -> Taps:
    """Bring a symmetric kernel of an odd number of taps to the form that `smooth` takes."""
    return tuple(taps[len(taps) // 2 :])


@fast(inline="always")
def smooth(images: F32, taps: Taps) -> None:
    """Convolve images with a symmetric kernel along columns and rows, in place; zero outside.

    Args:
        images: (n, h, w).
        taps: from the middle outwards.
    """
    number, h, w = images.shape
    reach = len(taps) - 1
    padded = np.zeros((h + 2 * reach, w), np.float32)
    row = np.zeros(w + 2 * reach, np.float32)
    for n in range(number):
        image = images[n]
        for i in range(h):  # compiled faster than an assignment to a slice
            for j in range(w):
                padded[reach + i, j] = image[i, j]
        for i in range(h):
            for j in range(w):
                total = taps[0] * padded[i + reach, j]
                for k in range(1, len(taps)):
                    total += taps[k] * (padded[i + reach - k, j] + padded[i + reach + k, j])
                row[j + reach] = total
            for j in range(w):
                total = taps[0] * row[j + reach]
                for k in range(1, len(taps)):
                    total += taps[k] * (row[j + reach - k] + row[j + reach + k])
                image[i, j] = total
