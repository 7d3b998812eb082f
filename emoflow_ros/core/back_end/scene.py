"""The remembered scene: depths of patches now, where they should be, and the flow between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.front_end.bearings import looked_up
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.front_end.slices import GRID_PX, grid_nodes
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import motion_field
from emoflow_ros.core.lattice.settings import LATTICE

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

# Depth between patches: Gaussians, of standard deviations in nodes of the grid, and their weights
_SPREADS = tuple((reach / GRID_PX, weight) for reach, weight in LATTICE.depth_reaches)
_NEAREST = 0.05  # least depth over that of the anchor


@dataclass(frozen=True)
class Grid:
    """Matrices of the motion field U = rho A v + B w at nodes over the image, in px.

    Attributes:
        a, b: (rows, columns, 2, 3).
        spreads: matrices (rows, rows) and (columns, columns) that spread values over the nodes,
            of each of the Gaussians.
    """

    a: Array
    b: Array
    spreads: tuple[tuple[Array, Array], ...]

    @classmethod
    def of(cls, camera: Camera) -> "Grid":
        """Nodes GRID_PX apart; where the lens has no inverse, as in the middle of the image."""
        nodes = grid_nodes(camera.size)
        spreads = tuple(
            (_spread(nodes.shape[0], sigma), _spread(nodes.shape[1], sigma))
            for sigma, _ in _SPREADS
        )
        return cls(*motion_field(camera, nodes), spreads)


def _spread(count: int, sigma: float) -> Array:
    """Normalised Gaussian (count, count) of the distance between nodes."""
    apart = np.arange(count) - np.arange(count)[:, None]
    return np.exp(-0.5 * (apart / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))


def rigid_flow(
    grid: Grid, place: Array, depths: Array, shown: NDArray[np.bool_], angular: Array, linear: Array
) -> F32:
    """Flow of the scene that patches show, (rows, columns, 2) px/s.

    Args:
        grid: of the tracking image.
        place: (N, 2) px of the patches.
        depths: (N,) inverse depths there.
        shown: (N,) those that count, where their depth is known.
        angular, linear: (3,) motion of the camera in its frame.
    """
    rows, columns = grid.a.shape[:2]
    chosen = shown & np.isfinite(depths)
    node = np.clip(np.round(place[chosen] / GRID_PX).astype(int), 0, [columns - 1, rows - 1])
    index = node[:, 1] * columns + node[:, 0]
    found = np.stack([  # sums of depths, and their numbers
        np.bincount(index, weight, rows * columns).reshape(rows, columns)
        for weight in (depths[chosen], None)
    ])  # fmt: skip
    above, below = 1e-6 + sum(
        weight * (by_row @ found @ by_column)
        for (_, weight), (by_row, by_column) in zip(_SPREADS, grid.spreads, strict=True)
    )
    inverse_depth = (above / below)[..., None]
    return (grid.b @ angular + inverse_depth * (grid.a @ linear)).astype(np.float32)


def depths_now(patches: Patches, x: Unknowns, bounds: tuple[float, float]) -> Array:
    """Inverse depths (N,) at the newest node."""
    points = _points(patches, x, patches.inverse_depth, np.full(len(patches), len(x.position) - 1))
    return _depths(patches, points, bounds)


def at_second(patches: Patches, x: Unknowns, bounds: tuple[float, float]) -> tuple[Array, Array]:
    """Where the way puts patches in the second slice that shows each.

    Returns:
        Bearings (N, 2) on the undistorted normalised plane, as found there where the depth is
        unknown or the way leads past the patch; inverse depths (N,), NaN where unknown.
    """
    second = patches.second
    points = _points(patches, x, patches.inverse_depth, second)
    ahead = points[:, 2:] > _NEAREST  # not where it is NaN
    by_way = points[:, :2] / np.maximum(points[:, 2:], _NEAREST)
    bearings = np.where(ahead, by_way, patches.seen[np.arange(len(patches)), second])
    return bearings, _depths(patches, points, bounds)


def _depths(patches: Patches, points: Array, bounds: tuple[float, float]) -> Array:
    """Inverse depths (N,) of points (N, 3), over the depth at their first slice."""
    return np.clip(patches.inverse_depth / np.maximum(points[:, 2], _NEAREST), *bounds)


def expected_places(camera: Camera, patches: Patches, x: Unknowns) -> Array:
    """Where the newest node sees patches (N, 2), px; new ones at the mean depth."""
    depths = np.where(np.isfinite(patches.inverse_depth), patches.inverse_depth, 1.0)
    points = _points(patches, x, depths, np.full(len(patches), len(x.position) - 1))
    points[:, 2] = np.maximum(points[:, 2], _NEAREST)
    return camera.project(points)


def deformations(camera: Camera, place: Array, x: Unknowns, depths: Array) -> Array:
    """What the way from the last but one node to the newest makes of patches, (N, 2, 2).

    Offsets (x, y) px within a patch are multiplied by it. Patches face the camera. It is the
    identity for those that are, or come, off the image or behind the camera.

    Args:
        camera: of the tracking image.
        place: (N, 2) px of the patches at the last but one node.
        x: motion of the nodes.
        depths: (N,) inverse depths at the last but one node; NaN where unknown.
    """
    seen, jacobian = looked_up(camera, place)
    turn = x.rotation[-1].T @ x.rotation[-2]
    way = x.rotation[-1].T @ (x.position[-2] - x.position[-1])
    rho = np.where(np.isfinite(depths), depths, 1.0)[:, None]
    to = seen @ turn[:, :2].T + turn[:, 2] + rho * way
    ahead = to[:, 2] > _NEAREST  # not where it is NaN
    to = np.where(ahead[:, None], to, [0.0, 0.0, 1.0])
    plane = to[:, :2] / to[:, 2:]
    on_plane = (turn[:2, :2] - plane[:, :, None] * turn[2, :2]) / to[:, 2, None, None]
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=1)
    arrived, back = looked_up(camera, camera.project(rays))
    with np.errstate(invalid="ignore"):
        found = np.linalg.inv(np.where(np.isfinite(back), back, np.eye(2))) @ on_plane @ jacobian
        known = ahead & np.isfinite(arrived).all(axis=1) & (np.linalg.det(found) > 0)
    return np.where(known[:, None, None], found, np.eye(2))


def _points(patches: Patches, x: Unknowns, depths: Array, node: NDArray[np.int64]) -> Array:
    """Patches (N, 3) in the frames of nodes (N,), over the depth at their first slice."""
    every, first = np.arange(len(patches)), patches.first
    rays = np.concatenate([patches.seen[every, first], np.ones((len(patches), 1))], axis=1)
    common = np.einsum("nij,nj->ni", x.rotation[first], rays)
    common += depths[:, None] * (x.position[first] - x.position[node])
    return np.asarray(np.einsum("nji,nj->ni", x.rotation[node], common))
