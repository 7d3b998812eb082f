"""What stands where in a random recording: walls, clutter, poles and slanted planes."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.simulation.factors import Factors
from emoflow_ros.simulation.scene import MOVING, Look, Quad, cuboid
from emoflow_ros.simulation.textures import BLANK, FEATURE, LOG_CONTRAST, PAINTED

_LENGTH = 260.0  # m: no recording goes further down a corridor or a street
_GROUND = -1  # in place of a texture: one will be drawn, but not the blank one
_SHADE = 0.35  # spread of the faces' mean log intensity


@dataclass(frozen=True)
class Layout:
    """Surfaces around a camera that starts near the origin and looks roughly along z.

    Attributes:
        quads: all static surfaces.
        depth: typical distance of what the camera sees, m.
        pitch: where it looks at the start, rad; negative is down.
        reach: how far it may move to and fro before it comes near something, m.
    """

    quads: tuple[Quad, ...]
    depth: float
    pitch: float
    reach: float


@dataclass(frozen=True)
class _Walls:
    quads: list[Quad]
    near: float
    far: float
    pitch: float = 0.0
    floor: float | None = None  # y of the ground that things stand on
    lane: float = 0.0  # half width of the way that is kept free


def random_layout(factors: Factors) -> Layout:
    """Lay out the static surfaces."""
    rng = factors.generator("layout")
    walls = _BUILDERS[factors.scene](factors, rng)
    depth = float(np.sqrt(walls.near * walls.far)) if factors.scene != "plane" else walls.far
    texel = factors.feature_px * depth / (factors.focal * factors.size[0]) / FEATURE
    quads = list(walls.quads)
    if factors.scene != "plane":
        objects = factors.generator("objects")
        quads += _clutter(factors, walls, objects)
        quads += _poles(factors, walls, objects)
        quads += _slants(factors, walls, objects)
    paint = factors.generator("paint")
    painted = tuple(_painted(quad, factors, texel, paint) for quad in quads)
    reach = (0.35 if factors.scene != "plane" else 0.6) * walls.near
    return Layout(painted, depth, walls.pitch, reach)


def mover_box(
    factors: Factors, number: int, side: float, distance: float, rng: np.random.Generator
) -> list[Quad]:
    """A box around the origin of the body MOVING + number, in sight at `distance`."""
    size = tuple(float(side * s) for s in rng.uniform((0.7, 0.7, 0.3), (1.3, 1.3, 0.8)))
    look = Look(PAINTED, 1.0, body=MOVING + number)
    texel = factors.feature_px * distance / (factors.focal * factors.size[0]) / FEATURE
    box = cuboid((0, 0, 0), (size[0], size[1], size[2]), float(rng.uniform(-0.6, 0.6)), look, rng)
    return [_painted(quad, factors, texel, rng) for quad in box]


def _room(factors: Factors, rng: np.random.Generator) -> _Walls:
    near = float(rng.uniform(0.6, 1.5))
    far = float(np.clip(near * factors.depth_ratio, 2.0, 30.0))
    width = max(far * rng.uniform(0.8, 1.6), 2.5)
    height = max(2.4, 0.35 * far) * rng.uniform(1.0, 1.2)
    behind = max(1.5, 0.5 * far)
    floor = height * rng.uniform(0.4, 0.6)
    centre = (width * rng.uniform(-0.15, 0.15), floor - height / 2, (far - behind) / 2)
    room = cuboid(centre, (width, height, far + behind), rng.uniform(-0.4, 0.4), _plain(), rng)
    return _Walls(room, near, far, floor=floor)


def _corridor(factors: Factors, rng: np.random.Generator) -> _Walls:
    width, height = rng.uniform(1.8, 3.2), rng.uniform(2.3, 2.9)
    floor = height * rng.uniform(0.35, 0.65)
    centre = (width * rng.uniform(-0.12, 0.12), floor - height / 2, _LENGTH / 2 - 5)
    quads = cuboid(centre, (width, height, _LENGTH), 0.0, _plain(), rng)
    near = 0.6 * width
    return _Walls(quads, near, float(near * max(factors.depth_ratio, 3.0)), floor=floor, lane=0.5)


def _street(factors: Factors, rng: np.random.Generator) -> _Walls:
    floor = float(rng.uniform(1.0, 2.0))
    quads = _ground_and_sky(floor, rng)
    half = rng.uniform(4.5, 9.0)
    for side in (-1, 1):
        z = -10.0
        while z < _LENGTH - 40:
            depth, height, setback = rng.uniform((8, 4, 0), (25, 14, 4))
            centre = (side * (half + setback + 4), floor - height / 2, z + depth / 2)
            quads += cuboid(centre, (8.0, height, depth), 0.0, _plain(), rng)
            z += depth + rng.uniform(0, 10)
    for z in np.arange(4.0, _LENGTH - 40, rng.uniform(7, 25)):
        beside = rng.choice((-1, 1)) * rng.uniform(0.65, 0.8) * half
        centre = (beside, floor - 0.75, z + rng.uniform(0, 6))
        quads += cuboid(centre, (1.8, 1.5, 4.2), 0.0, _plain(), rng)
    near = 0.5 * half
    return _Walls(quads, near, near * max(factors.depth_ratio, 3.0), -0.03, floor, 0.35 * half)


def _open_ground(factors: Factors, rng: np.random.Generator) -> _Walls:
    floor = float(np.exp(rng.uniform(np.log(0.4), np.log(6.0))))
    quads = _ground_and_sky(floor, rng)
    near = 1.6 * floor
    pitch = -float(rng.uniform(0.05, 0.6))
    return _Walls(quads, near, near * max(factors.depth_ratio, 2.0), pitch, floor, 0.3 * near)


def _table_top(factors: Factors, rng: np.random.Generator) -> _Walls:
    near = float(rng.uniform(0.45, 0.8))
    far = float(np.clip(near * factors.depth_ratio, 1.2, 8.0))
    floor = float(rng.uniform(0.3, 0.5))
    table = cuboid((0, floor + 0.02, 0.9), (1.8, 0.04, 1.4), 0.0, _plain(), rng)
    room = cuboid((0, 0, 0.35 * far), (2.4 * far, 3.0, 1.7 * far), 0.0, _plain(), rng)
    return _Walls(table + room, near, far, -float(rng.uniform(0.2, 0.5)), floor)


def _plane(factors: Factors, rng: np.random.Generator) -> _Walls:
    distance = float(np.exp(rng.uniform(np.log(0.6), np.log(4.0))))
    yaw, pitch = rng.uniform(-0.5, 0.5, 2)
    wall = _panel((0.0, 0.0, distance), yaw, pitch, 80 * distance, 80 * distance)
    return _Walls([dataclasses.replace(wall, texture=_GROUND)], distance, distance)


_BUILDERS: dict[str, Callable[[Factors, np.random.Generator], _Walls]] = {
    "room": _room,
    "corridor": _corridor,
    "street": _street,
    "open_ground": _open_ground,
    "table_top": _table_top,
    "plane": _plane,
}


def _ground_and_sky(floor: float, rng: np.random.Generator) -> list[Quad]:
    """A ground to the horizon; around it hills or haze, and the sky, without texture."""
    side = 2 * _LENGTH
    ground = _level(floor, side)
    dome = cuboid((0, floor + 5 - 100, _LENGTH / 2), (side, 200, side), 0.0, _plain(), rng)
    sky = [dataclasses.replace(quad, texture=BLANK, shade=0.6) for quad in dome]
    return [ground, *sky]


def _level(y: float, side: float) -> Quad:
    corner = np.array([-side / 2, y, _LENGTH / 2 - side / 2])
    return Quad(corner, np.array([side, 0.0, 0.0]), np.array([0.0, 0.0, side]), _GROUND, 1.0)


def _panel(
    centre: tuple[float, float, float], yaw: float, pitch: float, width: float, height: float
) -> Quad:
    """A rectangle that faces the start of the camera, but for yaw and pitch."""
    cos_yaw, sin_yaw = np.cos(yaw), np.sin(yaw)
    across = width * np.array([cos_yaw, 0.0, -sin_yaw])
    sin_pitch, cos_pitch = np.sin(pitch), np.cos(pitch)
    down = height * np.array([sin_pitch * sin_yaw, cos_pitch, sin_pitch * cos_yaw])
    return Quad(np.array(centre) - across / 2 - down / 2, across, down, 0, 1.0)


def _clutter(factors: Factors, walls: _Walls, rng: np.random.Generator) -> list[Quad]:
    quads: list[Quad] = []
    for _ in range(factors.clutter):
        x, y, z = _place(factors, walls, rng)
        size = z * rng.uniform(0.08, 0.35, 3)
        size[2] = min(size[2], 0.5 * z)
        if walls.floor is not None and rng.random() < 0.7:
            y = walls.floor - size[1] / 2  # it stands on the ground
        x = _beside_lane(x, size[0], walls)
        quads += cuboid((x, y, z), tuple(size), rng.uniform(0, np.pi), _plain(), rng)
    return quads


def _poles(factors: Factors, walls: _Walls, rng: np.random.Generator) -> list[Quad]:
    quads: list[Quad] = []
    for _ in range(factors.poles):
        x, y, z = _place(factors, walls, rng)
        width = max(z * rng.uniform(0.01, 0.03), 0.01)
        height = 3 * z if walls.floor is None else max(2 * walls.floor, z)
        y = y if walls.floor is None else walls.floor - height / 2
        x = _beside_lane(x, width, walls)
        quads += cuboid((x, y, z), (width, height, width), 0.3, _plain(), rng)
    return quads


def _slants(factors: Factors, walls: _Walls, rng: np.random.Generator) -> list[Quad]:
    quads: list[Quad] = []
    for _ in range(factors.slants):
        x, y, z = _place(factors, walls, rng)
        width, height = z * rng.uniform(0.3, 0.8, 2)
        yaw, pitch = rng.uniform(-0.9, 0.9, 2)
        x = _beside_lane(x, width, walls)
        quads.append(_panel((x, y, z + 0.4 * width), yaw, pitch, width, height))
    return quads


def _place(factors: Factors, walls: _Walls, rng: np.random.Generator) -> tuple[float, float, float]:
    """A place in sight of the start, between the near and the far end of the scene."""
    width, height = factors.size
    z = float(np.exp(rng.uniform(np.log(1.2 * walls.near), np.log(max(walls.far, 2 * walls.near)))))
    x = z * rng.uniform(-0.7, 0.7) / factors.focal
    y = z * rng.uniform(-0.4, 0.4) * height / width / factors.focal
    return x, y, z


def _beside_lane(x: float, width: float, walls: _Walls) -> float:
    """Move what would stand in the way to its side."""
    clear = walls.lane + 0.8 * width if walls.lane else 0.0
    return x if abs(x) >= clear else float(np.copysign(clear, x))


def _plain() -> Look:
    return Look(PAINTED, 1.0)


def _painted(quad: Quad, factors: Factors, texel: float, rng: np.random.Generator) -> Quad:
    """Draw how a face looks; some are blank as a whole."""
    blank = rng.random() < 0.5 * factors.blank_share and quad.texture != _GROUND
    texture, scale = int(rng.integers(PAINTED)), float(rng.uniform(0.7, 1.4))
    contrast, shade = float(rng.uniform(0.6, 1.3)), float(rng.normal(0, _SHADE))
    if quad.texture == BLANK:  # the sky keeps its shade
        return dataclasses.replace(quad, texel=texel * scale)
    return dataclasses.replace(
        quad,
        texture=BLANK if blank else texture,
        texel=texel * scale,
        contrast=1.0 if blank else factors.contrast / LOG_CONTRAST * contrast,
        shade=shade,
    )


def quad_distance(quads: tuple[Quad, ...], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from each point (N, 3) to the nearest of the rectangles, (N,) m."""
    nearest = np.full(len(points), np.inf)
    for quad in quads:
        offset = points - quad.corner
        inside = np.zeros_like(offset)
        for edge in (quad.along_u, quad.along_v):
            inside += np.outer(np.clip(offset @ edge / (edge @ edge), 0, 1), edge)
        nearest = np.minimum(nearest, np.linalg.norm(offset - inside, axis=1))
    return nearest
