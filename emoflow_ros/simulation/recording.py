"""Simulate a recording in memory: events and their ground truth."""

from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.cameras import davis346
from emoflow_ros.simulation.raycast import RayCaster
from emoflow_ros.simulation.scenes import TEXTURES, build_scene
from emoflow_ros.simulation.sensor import EventPixels, SensorModel, background_noise
from emoflow_ros.simulation.textures import make_textures
from emoflow_ros.simulation.truth import GroundTruth

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
        scene: a key of `scenes.SCENES`.
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
    textures = make_textures(TEXTURES, texture_rng)

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
