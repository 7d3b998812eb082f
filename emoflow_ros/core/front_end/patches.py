"""Patches of slices: what they look like, and where they were seen."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

RADIUS, RADIUS_HALF = 12, 8  # of a patch, px of its scale


@dataclass(frozen=True)
class Patches:
    """Patches that are followed, and where they were in the last K slices.

    Attributes:
        born: (N,) ns, the slice of the first appearance.
        full, half: (N, 2, side, side) slopes along x and y in the frame of the first appearance, as
            far as they are known, at full and at half resolution.
        power: (N, 2, 2) of those at half resolution.
        toward: (N, 2) direction of the flow at that time.
        shape: (N, 2, 2) what the motion, as it was expected from slice to slice, has made of
            offsets (x, y) px in the first appearance.
        place: (N, 2) px of the tracking image, where it is, or should be: off the image if unknown.
        seen: (N, K, 2) on the undistorted normalised plane; the first is where the way put it
            once an earlier one was forgotten.
        root: (N, K, 2, 2) square root of the information there.
        found: (N, K) whether it was seen.
        inverse_depth: (N,) at the first of the slices that shows it, over the median one; NaN
            where nothing is known.
        of_depth: (N,) information on it by the places, along the way as it was adjusted; 0 where
            fewer than two show it.
    """

    born: Index
    full: F32
    half: F32
    power: Array
    toward: Array
    shape: Array
    place: Array
    seen: Array
    root: Array
    found: Mask
    inverse_depth: Array
    of_depth: Array

    def __len__(self) -> int:
        return len(self.born)

    @classmethod
    def none(cls) -> "Patches":
        """No patches, no slices."""
        side, side_half = 2 * RADIUS + 1, 2 * RADIUS_HALF + 1
        return cls(
            np.zeros(0, np.int64),
            np.zeros((0, 2, side, side), np.float32),
            np.zeros((0, 2, side_half, side_half), np.float32),
            np.zeros((0, 2, 2)),
            np.zeros((0, 2)),
            np.zeros((0, 2, 2)),
            np.zeros((0, 2)),
            np.zeros((0, 0, 2)),
            np.zeros((0, 0, 2, 2)),
            np.zeros((0, 0), np.bool_),
            np.zeros(0),
            np.zeros(0),
        )

    @property
    def shown(self) -> Mask:
        """Those that the newest slice shows, (N,)."""
        return self.followed(0)

    def followed(self, patience: int) -> Mask:
        """Those that were missing in so many of the newest slices at most, (N,)."""
        return self.found[:, -1 - patience :].any(axis=1)

    def kept(self, patience: int) -> float:
        """Share of those followed so far that the newest slice shows; 1 if there were none."""
        before = self.found[:, -2 - patience : -1].any(axis=1)
        return float(self.found[before, -1].mean()) if before.any() else 1.0

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

    def without(self, node: int, bearings: Array, depths: Array) -> "Patches":
        """Forget a slice, and patches that no other one shows.

        Later places are held against the first. When that is forgotten, the next one becomes it,
        but where the way puts the patch: an error of what was found there would be in all later
        ones.

        Args:
            node: which of the K slices.
            bearings, depths: (N, 2) and inverse depths (N,) in the second slice that shows each.
        """
        moved = self.first == node
        others = np.arange(self.found.shape[1]) != node
        seen = self.seen.copy()
        seen[moved, self.second[moved]] = bearings[moved]
        kept = replace(
            self,
            seen=seen[:, others],
            root=self.root[:, others],
            found=self.found[:, others],
            inverse_depth=np.where(moved, depths, self.inverse_depth),
        )
        still = kept.found.any(axis=1)
        return kept if still.all() else kept.at(still)

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
