"""Random recordings: every factor of scene, motion and sensor drawn from a distribution."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.factors import Factors, draw_factors
from emoflow_ros.simulation.random_scene import (
    GRID,
    coarse_truth,
    given_camera,
    random_camera,
    random_scene,
)
from emoflow_ros.simulation.raycast import RayCaster, exact_bearings
from emoflow_ros.simulation.recording import SimulatedRecording
from emoflow_ros.simulation.scene import Scene
from emoflow_ros.simulation.sensor import (
    EventPixels,
    Lamp,
    Photoreceptor,
    SensorModel,
    background_noise,
    hot_pixels,
    lose_bursts,
)
from emoflow_ros.simulation.simulated_truth import GroundTruth
from emoflow_ros.simulation.textures import random_textures

__all__ = ["Factors", "RandomRecording", "draw_factors", "random_truth", "simulate_random"]

_LONGEST_S = 60.0
_LARGEST_STEP_PX = 0.5  # between two images
_SLOWEST_FPS, _FASTEST_FPS, _LAMP_FPS = 50, 5000, 1000
_KNOT = 5 * NS_PER_MS  # how often the image's speed is looked up
_THREADS = 2

Frame = NDArray[np.float32]


@dataclass(frozen=True)
class RandomRecording:
    """A random recording with its truth.

    Attributes:
        factors: what was drawn.
        t_start, t_end: the half-open interval of the events, ns.
        camera: the camera that made the events.
        calibration: the camera that users are given; differs by `factors.calibration_error`.
        events: sorted by time.
        truth: of `camera`, valid at any time from t_start to t_end.
    """

    factors: Factors
    t_start: int
    t_end: int
    camera: Camera
    calibration: Camera
    events: Events
    truth: GroundTruth

    def as_given(self) -> SimulatedRecording:
        """Return the recording as users receive it: its camera is the calibration."""
        return SimulatedRecording(
            "random",
            self.factors.seed,
            self.t_start,
            self.t_end,
            self.calibration,
            self.events,
            self.truth,
        )


def random_truth(factors: Factors, *, duration_s: float = 3.0, start_ns: int = 0) -> GroundTruth:
    """Rebuild the exact truth of a random recording without making its events.

    Args:
        factors: of the recording.
        duration_s: its length; another length is another motion.
        start_ns: time of its start.

    Raises:
        InputError: a duration out of range.
    """
    _check(duration_s)
    camera = random_camera(factors)
    return GroundTruth(camera, random_scene(factors, camera, duration_s), start_ns)


def simulate_random(
    factors: Factors, *, duration_s: float = 3.0, start_ns: int = 0, progress: bool = False
) -> RandomRecording:
    """Make a random recording; the same arguments give bitwise the same events.

    Args:
        factors: from `draw_factors`.
        duration_s: length of the recording.
        start_ns: time of its start.
        progress: whether to show a bar.

    Raises:
        InputError: a duration out of range.
    """
    _check(duration_s)
    camera = random_camera(factors)
    scene = random_scene(factors, camera, duration_s)
    times = frame_times(factors, camera, scene, round(duration_s * NS_PER_S))
    frames = tqdm(
        _frames(factors, camera, scene, times),
        "rendering",
        len(times),
        unit="frame",
        disable=not progress,
    )
    events = _events(factors, camera, times, iter(frames))
    shifted = Events(events.x, events.y, events.t + start_ns, events.p)
    return RandomRecording(
        factors,
        start_ns,
        start_ns + times[-1],
        camera,
        given_camera(factors, camera),
        shifted,
        GroundTruth(camera, scene, start_ns),
    )


def _check(duration_s: float) -> None:
    if not 0.01 <= duration_s <= _LONGEST_S:
        raise InputError(
            "duration", f"{duration_s} s", f"give a length in [0.01, {_LONGEST_S:g}] s"
        )


def frame_times(factors: Factors, camera: Camera, scene: Scene, end: int) -> list[int]:
    """Times of the images, ns from 0 to `end`: no pixel moves by more than half a pixel."""
    truth = coarse_truth(camera, scene)
    speeds = []
    for t in range(0, end + _KNOT, _KNOT):
        speed = np.linalg.norm(truth.flow(t), axis=-1) * GRID
        speeds.append(float(np.nanmax(speed, initial=0.0)))
    slowest = _LAMP_FPS if factors.flicker else _SLOWEST_FPS
    times = [0]
    while times[-1] < end:
        knot = times[-1] // _KNOT
        fps = np.clip(max(speeds[knot : knot + 3]) / _LARGEST_STEP_PX, slowest, _FASTEST_FPS)
        # The speed is known at the knots only, so no step is longer than two knots.
        step = min(int(NS_PER_S / fps), 2 * _KNOT) // 1000 * 1000
        times.append(min(times[-1] + step, end))
    return times


def _frames(factors: Factors, camera: Camera, scene: Scene, times: list[int]) -> Iterator[Frame]:
    """Log-intensity images (H, W) at the times, rendered ahead in threads."""
    caster = RayCaster(camera, scene.quads)
    textures = random_textures(factors)
    lamp = _lamp(factors, camera, scene)

    def render(t: int) -> Frame:
        seconds = t / NS_PER_S
        pose, bodies = scene.poses(seconds)
        image = caster.render(pose, bodies, textures)
        if lamp is not None:
            lamp.light(image, pose[0], seconds)
        return image

    with ThreadPoolExecutor(_THREADS) as pool:
        ahead: deque[Future[Frame]] = deque()
        for t in times:
            ahead.append(pool.submit(render, t))
            if len(ahead) > 2 * _THREADS:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


def _lamp(factors: Factors, camera: Camera, scene: Scene) -> Lamp | None:
    if factors.flicker == 0:
        return None
    rng = factors.generator("lamp")
    rotation, _ = scene.camera.pose(0.0)
    x, y = rng.uniform(-0.3, 0.3, 2) / factors.focal
    direction = rotation @ (np.array([x, y, 1.0]) / np.sqrt(x * x + y * y + 1))
    radius = np.sqrt(factors.flicker * camera.width * camera.height / np.pi)
    return Lamp(
        exact_bearings(camera),
        direction,
        float(np.arctan(radius / camera.fx)),
        float(rng.uniform(0.1, 0.4)),
        float(rng.choice((100.0, 120.0))),
    )


def _events(factors: Factors, camera: Camera, times: list[int], frames: Iterator[Frame]) -> Events:
    """Turn images into the events of the drawn sensor."""
    sensor = SensorModel(
        threshold_on=factors.threshold,
        threshold_off=factors.threshold * factors.off_ratio,
        mismatch=factors.mismatch,
        refractory_us=factors.refractory_us,
    )
    first = next(frames)
    receptor = Photoreceptor(factors.lowpass_hz, first)
    pixels = EventPixels(sensor, first, times[0], factors.generator("pixels"))
    # A leaking pixel sees the light rise all the time, by one threshold for each leak event.
    leak = factors.leak_hz * pixels.thresholds[0]
    parts = []
    for (before, t), image in zip(pairwise(times), frames, strict=True):
        seconds = (t - before) / NS_PER_S
        held = receptor.advance(image, seconds) + leak * (t / NS_PER_S)
        parts.append(pixels.advance(held.astype(np.float32), t))
    shape, end = (camera.height, camera.width), times[-1]
    noise = factors.generator("noise")
    parts.append(background_noise(factors.noise_hz, shape, 0, end, noise))
    parts.append(hot_pixels(factors.hot_pixels, shape, 0, end, factors.generator("hot pixels")))
    events = Events.concatenate(parts)
    events = events[events.t < end]
    events = events[np.argsort(events.t, kind="stable")]
    return lose_bursts(events, factors.lost, factors.generator("lost"))
