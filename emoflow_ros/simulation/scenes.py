"""The scenes: what stands where, and how camera and objects move."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emoflow_ros.errors import InputError
from emoflow_ros.simulation.surfaces import MOVING, Look, Quad, cuboid
from emoflow_ros.simulation.trajectory import PITCH, ROLL, YAW, Pose, Trajectory, Wave, X, Y, Z

TEXTURES = 6
_QUIET_HZ = 0.1


@dataclass(frozen=True)
class Scene:
    """Surfaces and motions, in a world with x right, y down and z forward at the start.

    Attributes:
        quads: all surfaces, each in the frame of the body that carries it.
        camera: world-from-camera.
        movers: world-from-body of each body that moves by itself: bodies MOVING, MOVING + 1, ...
        noise_hz: background events per second and pixel; dim scenes have more.
    """

    quads: tuple[Quad, ...]
    camera: Trajectory
    movers: tuple[Trajectory, ...] = ()
    noise_hz: float = _QUIET_HZ

    def poses(self, t: float) -> tuple[Pose, tuple[Pose, ...]]:
        """Poses at t in s: the camera's, and those of the bodies STATIC, MOVING and so on."""
        rest = (np.eye(3), np.zeros(3))
        return self.camera.pose(t), (rest, *(mover.pose(t) for mover in self.movers))


SceneBuilder = Callable[[float, np.random.Generator], Scene]


def build_scene(name: str, duration_s: float, rng: np.random.Generator) -> Scene:
    """Lay out a scene, long enough for `duration_s` of motion.

    Raises:
        InputError: an unknown name.
    """
    if name not in SCENES:
        raise InputError("scene", f"unknown name '{name}'", f"use one of {', '.join(SCENES)}")
    return SCENES[name](duration_s, rng)


def _calm(duration_s: float, rng: np.random.Generator) -> Scene:
    return Scene(_room(rng), Trajectory(waves=_hover(rng, speed=0.4, rate_deg=10, hz=0.25)))


def _noisy(duration_s: float, rng: np.random.Generator) -> Scene:
    calm = _calm(duration_s, rng)
    return Scene(calm.quads, calm.camera, noise_hz=6.0)


def _static(duration_s: float, rng: np.random.Generator) -> Scene:
    return Scene(_room(rng), Trajectory())


def _agile(duration_s: float, rng: np.random.Generator) -> Scene:
    return Scene(_room(rng), Trajectory(waves=_hover(rng, speed=0.9, rate_deg=58, hz=0.6)))


def _rotation(duration_s: float, rng: np.random.Generator) -> Scene:
    return Scene(_room(rng), Trajectory(waves=_hover(rng, speed=0, rate_deg=58, hz=0.6)))


def _translation(duration_s: float, rng: np.random.Generator) -> Scene:
    return Scene(_room(rng), Trajectory(waves=_hover(rng, speed=0.9, rate_deg=0, hz=0.25)))


def _mover(duration_s: float, rng: np.random.Generator) -> Scene:
    calm = _calm(duration_s, rng)
    box = cuboid((0, 0, 0), (0.6, 0.6, 0.3), 0.3, Look(TEXTURES, 0.003, body=MOVING), rng)
    phase = float(rng.uniform(0, 2 * np.pi))
    path = Trajectory(
        offset=(0.0, 0.0, 1.5, 0.0, 0.0, 0.0),
        waves=(
            Wave(X, 0.35, 0.25, phase),
            Wave(Y, 0.2, 0.25, phase + np.pi / 2),
            Wave(ROLL, 0.3, 0.2, phase),
        ),
    )
    return Scene(calm.quads + tuple(box), calm.camera, (path,))


def _bystander(duration_s: float, rng: np.random.Generator) -> Scene:
    mover = _mover(duration_s, rng)
    return Scene(mover.quads, Trajectory(), mover.movers)


def _forward(duration_s: float, rng: np.random.Generator) -> Scene:
    speed = 1.0
    length = speed * duration_s + 9.0
    quads = cuboid((0, 0, length / 2 - 1), (4, 2.8, length), 0, Look(TEXTURES, 0.004), rng)
    for k in range(int(1.2 * length)):
        side = (-1) ** k * rng.uniform(1.1, 1.7)
        centre = (side, rng.uniform(-0.9, 0.9), 0.8 + k / 1.2)
        size = tuple(rng.uniform(0.3, 0.8, 3))
        quads += cuboid(centre, size, rng.uniform(0, np.pi), Look(TEXTURES, 0.003), rng)
    sway = _hover(rng, speed=0.08, rate_deg=10, hz=0.3)
    return Scene(tuple(quads), Trajectory(rate=(0, 0, speed, 0, 0, 0), waves=sway))


def _driving(duration_s: float, rng: np.random.Generator) -> Scene:
    speed, eye = 12.5, 1.5
    length = speed * duration_s + 100.0
    road = Look(TEXTURES, 0.012)
    # The outermost box: meadows below, hills beside and ahead, the sky above.
    far = Look(TEXTURES, 0.06, contrast=0.8)
    quads = cuboid((0, eye - 29.9, length / 2 - 10), (90, 60, length + 20), 0, far, rng)
    quads += cuboid((0, eye + 0.05, length / 2 - 10), (14, 0.1, length + 20), 0, road, rng)
    for side in (-1, 1):
        z = -5.0
        while z < length - 20:
            depth, height, setback = rng.uniform((8, 4, 5), (20, 12, 8))
            centre = (side * (setback + 4), eye - height / 2, z + depth / 2)
            quads += cuboid(centre, (8, height, depth), 0, road, rng)
            z += depth + rng.uniform(0, 6)
        for z in np.arange(4.0, length - 20, 12.0):  # parked cars and the like
            centre = (side * rng.uniform(3.0, 3.8), eye - 0.75, z + rng.uniform(0, 6))
            quads += cuboid(centre, (1.8, 1.5, 4.0), 0, Look(TEXTURES, 0.006), rng)
    sway = _hover(rng, speed=0.1, rate_deg=4, hz=0.3)
    return Scene(tuple(quads), Trajectory(rate=(0, 0, speed, 0, 0, 0), waves=sway))


SCENES: dict[str, SceneBuilder] = {
    "calm": _calm,
    "agile": _agile,
    "forward": _forward,
    "rotation": _rotation,
    "translation": _translation,
    "driving": _driving,
    "mover": _mover,
    "noisy": _noisy,
    "static": _static,
    "bystander": _bystander,
}


def _room(rng: np.random.Generator) -> tuple[Quad, ...]:
    """A room of 7 x 4 x 8 m around the camera with boxes at 1.6 to 4.5 m in front of it."""
    quads = cuboid((0, 0, 1), (7, 4, 8), 0, Look(TEXTURES, 0.006), rng)
    for x in (-1.6, -0.6, 0.6, 1.6):
        for y in (-0.8, 0.8):
            centre = (x + rng.uniform(-0.3, 0.3), y + rng.uniform(-0.3, 0.3), rng.uniform(2, 4.5))
            size = tuple(rng.uniform(0.3, 1.0, 3))
            quads += cuboid(centre, size, rng.uniform(0, np.pi), Look(TEXTURES, 0.004), rng)
    return tuple(quads)


def _hover(
    rng: np.random.Generator, *, speed: float, rate_deg: float, hz: float
) -> tuple[Wave, ...]:
    """Circle in position and in gaze: two axes a quarter period apart, nearly constant speed.

    Args:
        rng: draws phases, the sense of rotation and variations of 10 %.
        speed: of the position, m/s.
        rate_deg: of the orientation, deg/s.
        hz: turns per second, roughly.
    """
    hz_drawn = hz * rng.uniform(0.9, 1.1)
    phase, lead = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi / 3, np.pi / 3)
    quarter = rng.choice((-1, 1)) * np.pi / 2
    waves = []
    # Pitch and y have opposite signs: then both circles move the image the same way.
    for channels, rate, start, turn in (
        ((X, Y), speed, phase, quarter),
        ((YAW, PITCH), np.radians(rate_deg), phase + lead, -quarter),
    ):
        amplitude = rate * rng.uniform(0.9, 1.1) / (2 * np.pi * hz_drawn)
        waves.append(Wave(channels[0], amplitude, hz_drawn, start))
        waves.append(Wave(channels[1], amplitude, hz_drawn, start + turn))
    for channel, rate in ((Z, 0.4 * speed), (ROLL, 0.3 * np.radians(rate_deg))):
        amplitude = rate / (2 * np.pi * 1.3 * hz_drawn)
        waves.append(Wave(channel, amplitude, 1.3 * hz_drawn, rng.uniform(0, 2 * np.pi)))
    return tuple(waves)
