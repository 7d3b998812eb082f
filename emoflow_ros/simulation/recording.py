"""Recordings of the named scenes: what stands where, what moves, and the events and the truth."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.raycast import RayCaster
from emoflow_ros.simulation.scene import (
    MOVING,
    PITCH,
    ROLL,
    YAW,
    Look,
    Quad,
    Scene,
    Trajectory,
    Wave,
    X,
    Y,
    Z,
    cuboid,
)
from emoflow_ros.simulation.sensor import EventPixels, SensorModel, background_noise
from emoflow_ros.simulation.simulated_truth import GroundTruth
from emoflow_ros.simulation.textures import make_textures

_TEXTURES = 6
_LENSES: dict[str, tuple[float, ...]] = {
    "none": (),
    "plumb_bob": (-0.34, 0.14, 0.0004, -0.0003),
    # MVSEC's left camera, indoor_flying.
    "equidistant": (
        -0.048031442223833355,
        0.011330957517194437,
        -0.055378166304281135,
        0.021500973881459395,
    ),
}
LENSES = tuple(_LENSES)

SceneBuilder = Callable[[float, np.random.Generator], Scene]


def davis346(lens: str) -> Camera:
    """A DAVIS346 with the intrinsics of MVSEC's left camera (indoor_flying).

    Raises:
        KeyError: the lens is not one of LENSES.
    """
    return Camera(
        width=346,
        height=260,
        fx=226.38018519795807,
        fy=226.15002947047415,
        cx=173.6470807871759,
        cy=133.73271487507847,
        model=lens,
        distortion=_LENSES[lens],
    )


_IDEAL_DAVIS346 = davis346("none")
_SENSOR = SensorModel()


@dataclass(frozen=True)
class SimulatedRecording:
    """A recording with its truth.

    Attributes:
        scene, seed: what it was made from.
        t_start, t_end: the half-open interval of the events, ns.
        camera: the camera, lens included.
        events: sorted by time.
        truth: valid at any time from t_start to t_end.
    """

    scene: str
    seed: int
    t_start: int
    t_end: int
    camera: Camera
    events: Events
    truth: GroundTruth


def simulate(
    scene: str,
    *,
    duration_s: float,
    seed: int,
    camera: Camera = _IDEAL_DAVIS346,
    fps: int = 1000,
    sensor: SensorModel = _SENSOR,
    start_ns: int = 0,
    progress: bool = False,
) -> SimulatedRecording:
    """Render a scene frame by frame and turn the changes of brightness into events.

    The same arguments give bitwise the same events.

    Args:
        scene: a key of SCENES.
        duration_s: length of the recording.
        seed: of the layout, the textures, the motion, the pixels and the noise.
        camera: any camera; rays follow its lens model.
        fps: rendered images per second; between them brightness is linear in log intensity.
        sensor: the pixels.
        start_ns: time of the first image.
        progress: whether to show a bar.

    Raises:
        InputError: an unknown scene, or a duration or frame rate out of range.
    """
    if not 0 < duration_s <= 600:
        raise InputError("duration", f"{duration_s} s", "give a length in (0, 600] s")
    if not 10 <= fps <= 100_000:
        raise InputError("fps", f"{fps}", "give a rate in [10, 100000] images per second")
    layout_rng, texture_rng, pixel_rng, noise_rng = np.random.default_rng(seed).spawn(4)
    built = build_scene(scene, duration_s, layout_rng)
    caster = RayCaster(camera, built.quads)
    textures = make_textures(_TEXTURES, texture_rng)

    first = caster.render(*built.poses(0.0), textures)
    pixels = EventPixels(sensor, first, start_ns, pixel_rng)
    parts = []
    frames = range(1, round(duration_s * fps) + 1)
    for frame in tqdm(frames, "rendering", unit="frame", disable=not progress):
        image = caster.render(*built.poses(frame / fps), textures)
        parts.append(pixels.advance(image, start_ns + frame * NS_PER_S // fps))
    t_end = start_ns + len(frames) * NS_PER_S // fps
    noise_hz = built.noise_hz if sensor.noise_hz is None else sensor.noise_hz
    shape = (camera.height, camera.width)
    parts.append(background_noise(noise_hz, shape, start_ns, t_end, noise_rng))
    events = Events.concatenate(parts)
    events = events[events.t < t_end]
    events = events[np.argsort(events.t, kind="stable")]
    truth = GroundTruth(camera, built, start_ns)
    return SimulatedRecording(scene, seed, start_ns, t_end, camera, events, truth)


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
    box = cuboid((0, 0, 0), (0.6, 0.6, 0.3), 0.3, Look(_TEXTURES, 0.003, body=MOVING), rng)
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
    quads = cuboid((0, 0, length / 2 - 1), (4, 2.8, length), 0, Look(_TEXTURES, 0.004), rng)
    for k in range(int(1.2 * length)):
        side = (-1) ** k * rng.uniform(1.1, 1.7)
        centre = (side, rng.uniform(-0.9, 0.9), 0.8 + k / 1.2)
        size = tuple(rng.uniform(0.3, 0.8, 3))
        quads += cuboid(centre, size, rng.uniform(0, np.pi), Look(_TEXTURES, 0.003), rng)
    sway = _hover(rng, speed=0.08, rate_deg=10, hz=0.3)
    return Scene(tuple(quads), Trajectory(rate=(0, 0, speed, 0, 0, 0), waves=sway))


def _driving(duration_s: float, rng: np.random.Generator) -> Scene:
    speed, eye = 12.5, 1.5
    length = speed * duration_s + 100.0
    road = Look(_TEXTURES, 0.012)
    # The outermost box: meadows below, hills beside and ahead, the sky above.
    far = Look(_TEXTURES, 0.06, contrast=0.8)
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
            quads += cuboid(centre, (1.8, 1.5, 4.0), 0, Look(_TEXTURES, 0.006), rng)
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
    quads = cuboid((0, 0, 1), (7, 4, 8), 0, Look(_TEXTURES, 0.006), rng)
    for x in (-1.6, -0.6, 0.6, 1.6):
        for y in (-0.8, 0.8):
            centre = (x + rng.uniform(-0.3, 0.3), y + rng.uniform(-0.3, 0.3), rng.uniform(2, 4.5))
            size = tuple(rng.uniform(0.3, 1.0, 3))
            quads += cuboid(centre, size, rng.uniform(0, np.pi), Look(_TEXTURES, 0.004), rng)
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
