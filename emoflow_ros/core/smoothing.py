"""Gaussian smoothing of images, in numba."""

import numba
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

REACH = 6  # px of an image on either side of the middle of a smoothing kernel, at most


def gaussian(sigma: float) -> F32:
    """Sampled Gaussian with sum 1, to 2.5 sigma on either side."""
    reach = int(np.ceil(2.5 * sigma))
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return (taps / taps.sum()).astype(np.float32)


def outwards(taps: F32) -> F32:
    """Bring a symmetric kernel of at most 13 taps to the form that `smooth` takes, (REACH + 1,)."""
    middle = len(taps) // 2
    result = np.zeros(REACH + 1, np.float32)
    result[: middle + 1] = taps[middle:]
    return result


@numba.njit(cache=True, fastmath=True, nogil=True)
def smooth(images: F32, taps: F32) -> None:
    """Convolve images with a symmetric kernel along columns and rows, in place; zero outside.

    Args:
        images: (n, h, w).
        taps: (REACH + 1,) from the middle outwards: always as many, so that the loops over them
            are unrolled.
    """
    number, h, w = images.shape
    padded = np.zeros((h + 2 * REACH, w), np.float32)
    row = np.zeros(w + 2 * REACH, np.float32)
    for n in range(number):
        image = images[n]
        padded[REACH:-REACH] = image
        for i in range(h):
            for j in range(w):
                total = taps[0] * padded[i + REACH, j]
                for k in range(1, REACH + 1):
                    total += taps[k] * (padded[i + REACH - k, j] + padded[i + REACH + k, j])
                row[j + REACH] = total
            for j in range(w):
                total = taps[0] * row[j + REACH]
                for k in range(1, REACH + 1):
                    total += taps[k] * (row[j + REACH - k] + row[j + REACH + k])
                image[i, j] = total
