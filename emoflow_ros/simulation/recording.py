"""Simulate a recording in memory: events and their ground truth."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.raycast import RayCaster
from emoflow_ros.simulation.scenes import TEXTURES, build_scene
from emoflow_ros.simulation.sensor import EventPixels, SensorModel, background_noise
from emoflow_ros.simulation.textures import make_textures
from emoflow_ros.simulation.truth import GroundTruth

# Intrinsics of MVSEC's left DAVIS346 (indoor_flying), without its lens.
DAVIS346 = Camera(
    346, 260, 226.38018519795807, 226.15002947047415, 173.6470807871759, 133.73271487507847
)


@dataclass(frozen=True)
class SimulatedRecording:
    """A recording with its truth.

    Attributes:
        scene: the scene's name.
        t_start, t_end: the interval that was simulated, ns.
        camera: the camera, lens included.
        events: sorted by time.
        truth: valid at any time from t_start to t_end.
    """

    scene: str
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
    camera: Camera = DAVIS346,
    fps: int = 1000,
    sensor: SensorModel = SensorModel(),
    start_ns: int = 0,
    on_frame: Callable[[], object] = lambda: None,
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
        on_frame: called after each image, for progress bars.

    Raises:
        InputError: an unknown scene, or a duration or frame rate out of range.
    """
    if not 0 < duration_s <= 600:
        raise InputError("duration", f"{duration_s} s", "give a length in (0, 600] s")
    if not 10 <= fps <= 100_000:
        raise InputError("fps", f"{fps}", "give a rate in [10, 100000] images per second")
    layout_rng, texture_rng, pixel_rng, noise_rng = np.random.default_rng(seed).spawn(4)
    built = build_scene(scene, duration_s, layout_rng)
    caster = RayCaster(camera, built.quads, make_textures(TEXTURES, texture_rng))
    truth = GroundTruth(camera, built, caster, start_ns)

    stamps = [start_ns + k * NS_PER_S // fps for k in range(round(duration_s * fps) + 1)]
    first = caster.render(truth.camera_pose(start_ns), truth.bodies(start_ns))
    pixels = EventPixels(sensor, first, start_ns, pixel_rng)
    parts = []
    for t in stamps[1:]:
        parts.append(pixels.advance(caster.render(truth.camera_pose(t), truth.bodies(t)), t))
        on_frame()
    noise_hz = built.noise_hz if sensor.noise_hz is None else sensor.noise_hz
    shape = (camera.height, camera.width)
    parts.append(background_noise(noise_hz, shape, start_ns, stamps[-1], noise_rng))
    events = Events.concatenate(parts)
    events = events[np.argsort(events.t, kind="stable")]
    return SimulatedRecording(scene, start_ns, stamps[-1], camera, events, truth)
