"""Ray casting against textured rectangles: log-intensity images and exact depth."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.simulation.scene import Pose, Quad
from emoflow_ros.simulation.textures import LEVELS, SIZE, TextureSet

_TILE = 16


class RayCaster:
    """Cast the ray of every pixel of a camera against a set of rectangles.

    In the camera's frame the plane of a rectangle, with normal N through its corner Q, is met
    by the ray Z (x, y, 1) where 1/Z = N.d / N.Q, and the surface coordinates over Z are linear
    in d = (x, y, 1) as well. So a rectangle is one 3x3 matrix per frame: rows for u/Z, v/Z
    and 1/Z, and a tile of pixels that misses it is ruled out by four corners.

    Args:
        camera: the camera, whose lens model gives the rays.
        quads: the rectangles.
    """

    def __init__(self, camera: Camera, quads: Sequence[Quad]) -> None:
        self._bearings = exact_bearings(camera)
        self._focal = float(np.sqrt(camera.fx * camera.fy))
        self._body = np.array([quad.body for quad in quads])
        self._corner = np.array([quad.corner for quad in quads])
        edges = np.array([[quad.along_u, quad.along_v] for quad in quads])
        self._size = np.linalg.norm(edges, axis=2)
        self._axes = edges / self._size[:, :, None]
        self._normal = np.cross(self._axes[:, 0], self._axes[:, 1])
        self._texture = np.array([quad.texture for quad in quads])
        self._paint = np.array([[quad.texel, quad.contrast, quad.shade] for quad in quads])
        self._tiles = _tile_bounds(self._bearings)

    def render(
        self, camera: Pose, bodies: Sequence[Pose], textures: TextureSet
    ) -> NDArray[np.float32]:
        """Log intensity (H, W) seen from a pose, through an optical blur of about one pixel.

        Args:
            camera: rotation world-from-camera and position.
            bodies: the same for each body that carries rectangles, by body number.
            textures: what is painted on the rectangles.
        """
        image = np.zeros(self._bearings.shape[:2], np.float32)
        _render(
            self._bearings,
            self._tiles,
            self._matrices(camera, bodies),
            self._size,
            self._texture,
            self._paint,
            textures.texels,
            textures.level_start,
            self._focal,
            image,
        )
        return np.asarray(_blur(image))

    def cast(
        self, camera: Pose, bodies: Sequence[Pose]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Depth along z (H, W) in m and number of the body that was hit (H, W).

        Where nothing is hit, or the lens model has no ray, the depth is NaN and the body -1.
        """
        depth, quad = _cast(self._bearings, self._tiles, self._matrices(camera, bodies), self._size)
        return depth, np.where(quad >= 0, self._body[quad], -1)

    def _matrices(self, camera: Pose, bodies: Sequence[Pose]) -> NDArray[np.float64]:
        rotation, position = camera
        body_rotation = np.stack([rotation.T @ r for r, _ in bodies])[self._body]
        body_position = np.stack([rotation.T @ (p - position) for _, p in bodies])[self._body]
        corner = np.einsum("nij,nj->ni", body_rotation, self._corner) + body_position
        axes = np.einsum("nij,nkj->nki", body_rotation, self._axes)
        normal = np.einsum("nij,nj->ni", body_rotation, self._normal)
        distance = np.einsum("ni,ni->n", normal, corner)
        distance[np.abs(distance) < 1e-9] = np.inf  # seen edge on: hit by no ray
        inverse_depth = normal / distance[:, None]
        offset = np.einsum("nki,ni->nk", axes, corner)
        surface = axes - offset[:, :, None] * inverse_depth[:, None, :]
        return np.concatenate([surface, inverse_depth[:, None, :]], axis=1)


def exact_bearings(camera: Camera) -> NDArray[np.float64]:
    """Undistorted normalised coordinates of every pixel, (H, W, 2), in double precision."""
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    bearings, _ = camera.undistort(grid.astype(np.float64))
    return bearings


def _tile_bounds(bearings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lowest and highest x and y of each tile's bearings: (rows, columns, 4)."""
    height, width = bearings.shape[:2]
    bounds = np.full((-(-height // _TILE), -(-width // _TILE), 4), np.nan)
    for i in range(bounds.shape[0]):
        for j in range(bounds.shape[1]):
            tile = bearings[i * _TILE : (i + 1) * _TILE, j * _TILE : (j + 1) * _TILE]
            x, y = tile[..., 0][np.isfinite(tile[..., 0])], tile[..., 1][np.isfinite(tile[..., 1])]
            if len(x):
                bounds[i, j] = x.min(), x.max(), y.min(), y.max()
    return bounds


@njit()
def _reaches(row, box):  # type: ignore[no-untyped-def]
    """Whether a linear function of (x, y, 1) is positive anywhere on a box."""
    x = max(row[0] * box[0], row[0] * box[1])
    y = max(row[1] * box[2], row[1] * box[3])
    return x + y + row[2] >= 0


@njit()
def _candidates(box, matrices, sizes, out):  # type: ignore[no-untyped-def]
    """Write the numbers of the rectangles that may be seen in a tile; return how many."""
    count = 0
    for k in range(len(matrices)):
        u, v, inverse = matrices[k, 0], matrices[k, 1], matrices[k, 2]
        if (
            _reaches(inverse, box)
            and _reaches(u, box)
            and _reaches(v, box)
            and _reaches(sizes[k, 0] * inverse - u, box)
            and _reaches(sizes[k, 1] * inverse - v, box)
        ):
            out[count] = k
            count += 1
    return count


@njit(inline="always")
def _nearest(x, y, candidates, count, matrices, sizes):  # type: ignore[no-untyped-def]
    """Number of the nearest rectangle on the ray (-1: none) and its inverse depth."""
    best, nearest = 0.0, -1
    for i in range(count):
        k = candidates[i]
        m = matrices[k]
        inverse = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        if inverse > best:
            u = m[0, 0] * x + m[0, 1] * y + m[0, 2]
            if 0 <= u <= sizes[k, 0] * inverse:
                v = m[1, 0] * x + m[1, 1] * y + m[1, 2]
                if 0 <= v <= sizes[k, 1] * inverse:
                    best, nearest = inverse, k
    return nearest, best


@njit(nogil=True)
def _cast(bearings, tiles, matrices, sizes):  # type: ignore[no-untyped-def]
    height, width = bearings.shape[:2]
    depth = np.full((height, width), np.nan)
    quad = np.full((height, width), -1, np.int64)
    candidates = np.empty(len(matrices), np.int64)
    for i in range(tiles.shape[0]):
        for j in range(tiles.shape[1]):
            count = _candidates(tiles[i, j], matrices, sizes, candidates)
            for row in range(i * _TILE, min((i + 1) * _TILE, height)):
                for column in range(j * _TILE, min((j + 1) * _TILE, width)):
                    x, y = bearings[row, column, 0], bearings[row, column, 1]
                    k, inverse = _nearest(x, y, candidates, count, matrices, sizes)
                    if k >= 0:
                        depth[row, column] = 1 / inverse
                        quad[row, column] = k
    return depth, quad


@njit(nogil=True)
def _render(  # type: ignore[no-untyped-def]
    bearings, tiles, matrices, sizes, texture, paint, texels, level_start, focal, image
):
    height, width = image.shape
    candidates = np.empty(len(matrices), np.int64)
    for i in range(tiles.shape[0]):
        for j in range(tiles.shape[1]):
            count = _candidates(tiles[i, j], matrices, sizes, candidates)
            for row in range(i * _TILE, min((i + 1) * _TILE, height)):
                for column in range(j * _TILE, min((j + 1) * _TILE, width)):
                    x, y = bearings[row, column, 0], bearings[row, column, 1]
                    k, inverse = _nearest(x, y, candidates, count, matrices, sizes)
                    if k >= 0:
                        m = matrices[k]
                        scale = 1 / (inverse * paint[k, 0])
                        u = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) * scale
                        v = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) * scale
                        level = _level(m, u * paint[k, 0], v * paint[k, 0], scale / focal)
                        value = _trilinear(texels[texture[k]], level_start, u, v, level)
                        image[row, column] = paint[k, 2] + paint[k, 1] * value


@njit(inline="always")
def _level(m, u, v, scale):  # type: ignore[no-untyped-def]
    """Pyramid level whose texel is as large as the longer side of the pixel's footprint."""
    ux, uy = m[0, 0] - u * m[2, 0], m[0, 1] - u * m[2, 1]
    vx, vy = m[1, 0] - v * m[2, 0], m[1, 1] - v * m[2, 1]
    footprint = max(ux * ux + vx * vx, uy * uy + vy * vy) * scale * scale
    return min(max(0.5 * np.log2(footprint), 0.0), LEVELS - 1.001)


@njit(inline="always")
def _trilinear(texels, level_start, u, v, level):  # type: ignore[no-untyped-def]
    """Sample between two pyramid levels, so that no level appears abruptly."""
    lower = int(level)
    near = _bilinear(texels, level_start[lower], lower, u, v)
    far = _bilinear(texels, level_start[lower + 1], lower + 1, u, v)
    return near + (level - lower) * (far - near)


@njit(inline="always")
def _bilinear(texels, start, level, u, v):  # type: ignore[no-untyped-def]
    size = SIZE >> level
    u = u / (1 << level) - 0.5
    v = v / (1 << level) - 0.5
    column, row = int(np.floor(u)), int(np.floor(v))
    fu, fv = u - column, v - row
    left, right = column & (size - 1), (column + 1) & (size - 1)
    top = start + (row & (size - 1)) * size
    bottom = start + ((row + 1) & (size - 1)) * size
    upper = texels[top + left] + fu * (texels[top + right] - texels[top + left])
    lower = texels[bottom + left] + fu * (texels[bottom + right] - texels[bottom + left])
    return upper + fv * (lower - upper)


@njit(nogil=True)
def _blur(image):  # type: ignore[no-untyped-def]
    """The lens' point spread: [1 2 1] / 4 along both axes, the border repeated."""
    height, width = image.shape
    rows = np.empty_like(image)
    for i in range(height):
        up, down = image[max(i - 1, 0)], image[min(i + 1, height - 1)]
        for j in range(width):
            rows[i, j] = np.float32(0.25) * (up[j] + down[j]) + np.float32(0.5) * image[i, j]
    out = np.empty_like(image)
    for i in range(height):
        for j in range(width):
            side = rows[i, max(j - 1, 0)] + rows[i, min(j + 1, width - 1)]
            out[i, j] = np.float32(0.25) * side + np.float32(0.5) * rows[i, j]
    return out
