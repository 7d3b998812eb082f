"""Patches found again in later slices by what they show along the present flow."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.front_end.appearance import (
    completed_slopes,
    first_slopes,
    moves,
    power,
    unit,
    visible,
)
from emoflow_ros.core.front_end.appearance_kernels import templates
from emoflow_ros.core.front_end.bearings import looked_up, on_plane
from emoflow_ros.core.front_end.corner_kernels import cornerness, corners, products
from emoflow_ros.core.front_end.patch_kernels import align
from emoflow_ros.core.front_end.patches import RADIUS, RADIUS_HALF, Patches
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import Picture, Slice, flow_at
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.numerics.smoothing import gaussian, outwards, smooth
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]
F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_STEPS, _STEPS_HALF = 12, 6  # of its search at each scale
_TENSOR_TAPS = outwards(gaussian(4.0))
_HIGH = 0.995  # quantile that scores are measured by


def directions(patches: Patches, flow: F32, place: Array, settings: FrontEndSettings) -> Array:
    """Directions (N, 2) of a flow in the frames of the first appearances.

    They turn with the patch: a roll of the camera is no change of the flow. Where next to nothing
    moves they are the first ones.

    Args:
        patches: N of them.
        flow: (rows, columns, 2) px/s of the newest slice.
        place: (N, 2) px, where the patches are in it.
        settings: of the front end.
    """
    along = np.linalg.solve(patches.shape, flow_at(flow, place)[..., None])[..., 0]
    return np.where(moves(along, settings)[:, None], unit(along), patches.toward)


def follow(
    patches: Patches, picture: Slice, expected: Array, camera: Camera, settings: FrontEndSettings
) -> Patches:
    """Find patches again in a new slice.

    A patch is looked for at half, then at full resolution, in the shape that the motion has given
    it, as the flow should show it now. While that is little of what it showed first, it is not
    looked for: there is another image, whose likeness is greatest at a wrong place.

    Args:
        patches: of the slices before.
        picture: the new one.
        expected: (N, 2) px, where the patches should be; NaN where not to look.
        camera: of the tracking image.
        settings: of the front end.
    """
    count, size = len(patches), np.array(camera.size)
    place = np.where(np.isfinite(expected), expected, -1.0)
    seen, root, found = np.zeros((count, 2)), np.zeros((count, 2, 2)), np.zeros(count, np.bool_)
    toward = directions(patches, picture.flow, place, settings)
    look = patches.followed(settings.patience)
    look &= visible(patches.power, patches.toward, toward, settings)
    look &= ((expected > 0) & (expected < size)).all(axis=1)
    chosen = np.flatnonzero(look)
    if len(chosen):
        at, information, good = _matched(
            patches, chosen, toward, picture, expected[chosen], size, settings
        )
        hit = chosen[good]
        age = (picture.t - patches.born[hit]) / NS_PER_S
        place[hit] = at[good]
        seen[hit], root[hit] = on_plane(camera, at[good], information[good], age, settings)
        found[hit] = np.isfinite(seen[hit]).all(axis=1)
    return patches.extended(place, seen, root, found)


def _matched(
    patches: Patches, chosen: Index, toward: Array, picture: Slice, expected: Array, size: Index,
    settings: FrontEndSettings,
) -> tuple[Array, Array, Mask]:  # fmt: skip
    """Places (M, 2), information (M, 2, 2) and whether they count (M,) of patches chosen (M,).

    They are seen along toward (N, 2).
    """
    reach, shape = settings.expected_px, patches.shape
    near, _, _ = _align(
        templates(patches.half, chosen, toward, shape), picture.half,
        expected / 2 - 0.25, reach / 2, _STEPS_HALF,
    )  # fmt: skip
    near = 2 * near + 0.5
    at, information, correlation = _align(
        templates(patches.full, chosen, toward, shape), picture.full, near, reach, _STEPS
    )
    apart = np.linalg.norm(at - expected, axis=1)
    good = (correlation > settings.correlation) & (apart < settings.reach_px)
    good &= ((at > settings.border_px) & (at < size - settings.border_px)).all(axis=1)
    return at, information, good


def choose(picture: Slice, patches: Patches, camera: Camera, settings: FrontEndSettings) -> Patches:
    """Choose new patches where a slice has structure and none is looked for, and add them.

    Where the flow has turned they come beside the old ones, which wait for it to turn back. There
    are none where next to nothing moves: their slopes would have no direction.

    Args:
        picture: the newest slice.
        patches: followed up to it.
        camera: of the tracking image.
        settings: of the front end.
    """
    toward = directions(patches, picture.flow, patches.place, settings)
    looked_for = patches.followed(settings.patience)
    looked_for &= visible(patches.power, patches.toward, toward, settings)
    taken = patches.place[patches.shown | looked_for]
    most = settings.most_patches - len(taken)
    if most <= 0:
        return patches
    tensor = products(picture.full.along_x, picture.full.along_y)
    smooth(tensor, _TENSOR_TAPS)
    score = cornerness(tensor, settings.edge_share)
    some = score.ravel()[::4]  # enough for a quantile
    high = int(_HIGH * some.size)
    least = settings.least_score * float(np.partition(some, high)[high])
    apart = round(min(settings.distance_px, settings.distance * max(camera.size)))
    points = corners(score, taken, apart, settings.border_px + 2, least, most)
    (bearing, _), flow = looked_up(camera, points), flow_at(picture.flow, points)
    good = np.isfinite(bearing).all(axis=1) & moves(flow, settings)
    points, bearing, toward = points[good], bearing[good], unit(flow[good])
    count, slices = len(points), max(1, patches.found.shape[1])
    seen, root = np.zeros((count, slices, 2)), np.zeros((count, slices, 2, 2))
    found = np.zeros((count, slices), np.bool_)
    seen[:, -1], found[:, -1] = bearing, True
    half = first_slopes(picture.half, points / 2 - 0.25, toward, RADIUS_HALF, settings)
    new = Patches(
        np.full(count, picture.t),
        first_slopes(picture.full, points, toward, RADIUS, settings),
        half,
        power(half),
        toward,
        np.tile(np.eye(2), (count, 1, 1)),
        points, seen, root, found, np.full(count, np.nan), np.zeros(count),
    )  # fmt: skip
    return patches.joined(new) if patches.found.shape[1] else new


def completed(
    patches: Patches, picture: Slice, place: Array, settings: FrontEndSettings
) -> Patches:
    """Let patches learn what the newest slice shows of them if the flow has turned.

    Args:
        patches: followed up to it.
        picture: the newest slice.
        place: (N, 2) px, where the adjusted motion puts them.
        settings: of the front end.
    """
    toward = directions(patches, picture.flow, place, settings)
    across = np.abs(patches.toward[:, 0] * toward[:, 1] - patches.toward[:, 1] * toward[:, 0])
    near = np.linalg.norm(place - patches.place, axis=1) < settings.adjusted_px
    chosen = np.flatnonzero(patches.shown & near & (across > settings.turned))
    if not len(chosen):
        return patches
    full, half = patches.full.copy(), patches.half.copy()
    shape, first, now = patches.shape[chosen], patches.toward[chosen], toward[chosen]
    for slopes, scale, at in (
        (full, picture.full, place[chosen]),
        (half, picture.half, place[chosen] / 2 - 0.25),
    ):
        slopes[chosen] = completed_slopes(slopes[chosen], scale, at, shape, first, now, settings)
    of_half = patches.power.copy()
    of_half[chosen] = power(half[chosen])
    return replace(patches, full=full, half=half, power=of_half)


def _align(
    templates: F32, picture: Picture, begin: Array, reach: float, steps: int
) -> tuple[Array, Array, Array]:
    """Places (N, 2), information (N, 2, 2) and correlations (N,) of templates in a picture."""
    count = len(templates)
    place, information = np.empty((count, 2)), np.empty((count, 2, 2))
    correlation = np.empty(count)
    align(
        templates, picture.image, picture.along_x, picture.along_y,
        np.ascontiguousarray(begin), reach, steps, place, information, correlation,
    )  # fmt: skip
    return place, information, correlation
