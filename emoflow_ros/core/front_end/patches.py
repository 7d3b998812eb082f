"""Patches of slices, found again in later ones by what they show along the present flow."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.front_end.appearance import (
    completed_slopes,
    first_slopes,
    moves,
    seen_along,
    unit,
    visible,
)
from emoflow_ros.core.front_end.bearings import looked_up, on_plane
from emoflow_ros.core.front_end.corner_kernels import cornerness, corners, products
from emoflow_ros.core.front_end.patch_kernels import align, deformed
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import Picture, Slice, flow_at
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.numerics.smoothing import gaussian, outwards, smooth
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]
F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_RADIUS, _RADIUS_HALF = 12, 8  # of a patch, px of its scale
_STEPS, _STEPS_HALF = 12, 6  # of its search at each scale
_TENSOR_TAPS = outwards(gaussian(4.0))
_HIGH = 0.995  # quantile that scores are measured by


@dataclass(frozen=True)
class Patches:
    """Patches that are followed, and where they were in the last K slices.

    Attributes:
        born: (N,) ns, the slice of the first appearance.
        full, half: (N, 2, side, side) slopes along x and y in the frame of the first appearance, as
            far as they are known, at full and at half resolution.
        toward: (N, 2) direction of the flow at that time.
        shape: (N, 2, 2) what the motion, as it was expected from slice to slice, has made of
            offsets (x, y) px in the first appearance.
        place: (N, 2) px of the tracking image, where it is, or should be: off the image if unknown.
        seen: (N, K, 2) on the undistorted normalised plane.
        root: (N, K, 2, 2) square root of the information there.
        found: (N, K) whether it was seen.
        inverse_depth: (N,) at the first of the slices that shows it, over the median one; NaN
            where nothing is known.
    """

    born: Index
    full: F32
    half: F32
    toward: Array
    shape: Array
    place: Array
    seen: Array
    root: Array
    found: Mask
    inverse_depth: Array

    def __len__(self) -> int:
        return len(self.born)

    @classmethod
    def none(cls) -> "Patches":
        """No patches, no slices."""
        side, side_half = 2 * _RADIUS + 1, 2 * _RADIUS_HALF + 1
        return cls(
            np.zeros(0, np.int64),
            np.zeros((0, 2, side, side), np.float32),
            np.zeros((0, 2, side_half, side_half), np.float32),
            np.zeros((0, 2)),
            np.zeros((0, 2, 2)),
            np.zeros((0, 2)),
            np.zeros((0, 0, 2)),
            np.zeros((0, 0, 2, 2)),
            np.zeros((0, 0), np.bool_),
            np.zeros(0),
        )

    @property
    def shown(self) -> Mask:
        """Those that the newest slice shows, (N,)."""
        return self.followed(0)

    @property
    def times_seen(self) -> float:
        """Number of slices on average that show one of `shown`; 0 without any."""
        return float(self.found[self.shown].sum(axis=1).mean()) if self.shown.any() else 0.0

    def followed(self, patience: int) -> Mask:
        """Those that were missing in so many of the newest slices at most, (N,)."""
        return self.found[:, -1 - patience :].any(axis=1)

    @property
    def first(self) -> Index:
        """The first slice that shows each, (N,)."""
        return self.found.argmax(axis=1)

    @property
    def second(self) -> Index:
        """The second slice that shows each, (N,); the first where none does."""
        later = self.found.copy()
        later[np.arange(len(self)), self.first] = False
        return np.where(later.any(axis=1), later.argmax(axis=1), self.first)

    def at(self, chosen: Mask) -> "Patches":
        """Those of a mask (N,)."""
        return Patches(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def without(self, node: int, depths: Array) -> "Patches":
        """Forget a slice, and patches that no other one shows.

        Args:
            node: which of the K slices.
            depths: (N,) inverse depths at the second slice that shows each.
        """
        moved = self.first == node
        others = np.arange(self.found.shape[1]) != node
        kept = replace(
            self,
            seen=self.seen[:, others],
            root=self.root[:, others],
            found=self.found[:, others],
            inverse_depth=np.where(moved, depths, self.inverse_depth),
        )
        return kept.at(kept.found.any(axis=1))

    def extended(self, place: Array, seen: Array, root: Array, found: Mask) -> "Patches":
        """Add a slice: (N, 2) px, (N, 2), (N, 2, 2) and (N,)."""
        return replace(
            self,
            place=place,
            seen=np.concatenate([self.seen, seen[:, None]], axis=1),
            root=np.concatenate([self.root, root[:, None]], axis=1),
            found=np.concatenate([self.found, found[:, None]], axis=1),
        )

    def joined(self, others: "Patches") -> "Patches":
        """These and others of as many slices."""
        both = ((getattr(self, f.name), getattr(others, f.name)) for f in fields(self))
        return Patches(*(np.concatenate(pair) for pair in both))


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
    look &= visible(patches.half, patches.toward, toward, settings)
    look &= ((expected > 0) & (expected < size)).all(axis=1)
    if look.any():
        at, information, good = _matched(
            patches.at(look), toward[look], picture, expected[look], size, settings
        )
        hit = np.flatnonzero(look)[good]
        age = (picture.t - patches.born[hit]) / NS_PER_S
        place[hit] = at[good]
        seen[hit], root[hit] = on_plane(camera, at[good], information[good], age, settings)
        found[hit] = np.isfinite(seen[hit]).all(axis=1)
    return patches.extended(place, seen, root, found)


def _matched(
    patches: Patches, toward: Array, picture: Slice, expected: Array, size: Index,
    settings: FrontEndSettings,
) -> tuple[Array, Array, Mask]:  # fmt: skip
    """Places (N, 2), information (N, 2, 2) and whether they count (N,), seen along (N, 2)."""
    reach, shape = settings.expected_px, patches.shape
    near, _, _ = _align(
        deformed(seen_along(patches.half, toward), shape), picture.half,
        expected / 2 - 0.25, reach / 2, _STEPS_HALF,
    )  # fmt: skip
    near = 2 * near + 0.5
    at, information, correlation = _align(
        deformed(seen_along(patches.full, toward), shape), picture.full, near, reach, _STEPS
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
    looked_for &= visible(patches.half, patches.toward, toward, settings)
    taken = patches.place[patches.shown | looked_for]
    most = settings.most_patches - len(taken)
    if most <= 0:
        return patches
    tensor = products(picture.full.along_x, picture.full.along_y)
    smooth(tensor, _TENSOR_TAPS)
    score = cornerness(tensor, settings.edge_share)
    high = int(_HIGH * score.size)
    least = settings.least_score * float(np.partition(score.ravel(), high)[high])
    points = corners(score, taken, settings.distance_px, settings.border_px + 2, least, most)
    (bearing, _), flow = looked_up(camera, points), flow_at(picture.flow, points)
    good = np.isfinite(bearing).all(axis=1) & moves(flow, settings)
    points, bearing, toward = points[good], bearing[good], unit(flow[good])
    count, slices = len(points), max(1, patches.found.shape[1])
    seen, root = np.zeros((count, slices, 2)), np.zeros((count, slices, 2, 2))
    found = np.zeros((count, slices), np.bool_)
    seen[:, -1], found[:, -1] = bearing, True
    new = Patches(
        np.full(count, picture.t),
        first_slopes(picture.full, points, toward, _RADIUS, settings),
        first_slopes(picture.half, points / 2 - 0.25, toward, _RADIUS_HALF, settings),
        toward,
        np.tile(np.eye(2), (count, 1, 1)),
        points, seen, root, found, np.full(count, np.nan),
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
    return replace(patches, full=full, half=half)


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
