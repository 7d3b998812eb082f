"""What patches look like under a flow.

An event camera does not see a picture, but its slopes s along the flow: a slice of events moved
along the unit vector u shows e = s . u. So a patch is remembered by its slopes, as far as they are
known, and looks different once the flow has turned.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.front_end.appearance_kernels import cut_shaped, learn
from emoflow_ros.core.front_end.patch_kernels import cut
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import Picture
from emoflow_ros.core.numerics.smoothing import gaussian, outwards, smooth

Array = NDArray[np.float64]
F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_TAPS = outwards(gaussian(1.5))  # of a pixel, over which its structure tensor is a mean
_REACH = len(_TAPS) - 1


def moves(flow: Array, settings: FrontEndSettings) -> Mask:
    """Tell which flows (N, 2) px/s have a direction, (N,)."""
    return np.asarray(np.linalg.norm(flow, axis=1) > settings.least_speed)


def unit(vectors: Array) -> Array:
    """Vectors (..., D) of length one; zero stays."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


def first_slopes(
    picture: Picture, points: Array, toward: Array, radius: int, settings: FrontEndSettings
) -> F32:
    """Slopes (N, 2, side, side) that events e along u show first.

    Of slopes with the covariance M the likeliest are s = M u e / (u . M u). M is the structure
    tensor of the events: slopes of an edge lie across it.

    Args:
        picture: of the events.
        points: (N, 2) px, the patches' middles.
        toward: (N, 2) u.
        radius: of the patches, px.
        settings: of the front end.
    """
    wide = radius + _REACH
    x, y = (cut(slopes, points, wide) for slopes in (picture.along_x, picture.along_y))
    tensor = np.concatenate([x * x, x * y, y * y])
    smooth(tensor, _TAPS)
    inner = slice(_REACH, -_REACH)
    xx, xy, yy = tensor.reshape(3, *x.shape)[..., inner, inner]
    u, v = toward.astype(np.float32).T[..., None, None]
    noise = settings.any_direction * (xx + yy) + 1e-9
    along_x, along_y = (xx + noise) * u + xy * v, xy * u + (yy + noise) * v
    share = cut(picture.image, points, radius) / (along_x * u + along_y * v)
    return np.stack([along_x * share, along_y * share], axis=1)


def power(slopes: F32) -> Array:
    """Sums (N, 2, 2) P over each patch of products of its slopes (N, 2, side, side).

    The square of what they show along u is u . P u.
    """
    flat = slopes.reshape(*slopes.shape[:2], slopes.shape[2] * slopes.shape[3])
    return (flat @ flat.transpose(0, 2, 1)).astype(np.float64)


def visible(of_slopes: Array, first: Array, toward: Array, settings: FrontEndSettings) -> Mask:
    """Tell which patches show enough along u (N, 2) of what they showed at `first` (N, 2), (N,).

    Args:
        of_slopes: (N, 2, 2) their `power`.
        first, toward: u.
        settings: of the front end.
    """
    then, now = (np.einsum("ni,nij,nj->n", u, of_slopes, u) for u in (first, toward))
    return np.asarray(now >= settings.visible**2 * then)


def completed_slopes(
    slopes: F32, picture: Picture, place: Array, shape: Array, first: Array, toward: Array,
    settings: FrontEndSettings,
) -> F32:  # fmt: skip
    """Learn the slopes across the first flow from events along another one.

    What the first flow has shown stays as it was. How strongly edges fire now is told by all that
    is expected, so that slopes which are new come out a third too small: what was seen first counts
    more. Nothing is learnt off the image, and of patches that do not look as expected.

    Args:
        slopes: (N, 2, side, side) that are known.
        picture: of the events.
        place: (N, 2) px of the patches in it.
        shape: (N, 2, 2) that the motion has given them.
        first: (N, 2) u of the first flow.
        toward: (N, 2) u of the present one, in the frames of the first appearances.
        settings: of the front end.
    """
    found = cut_shaped(picture.image, place, shape, slopes.shape[-1] // 2)
    learnt = slopes.copy()
    learn(learnt, found, first, toward, settings.learning, settings.correlation)
    return learnt
