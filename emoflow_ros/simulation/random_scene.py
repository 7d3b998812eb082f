"""The scene of a random recording: camera, surfaces and motions that fit together."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.simulation.factors import Factors
from emoflow_ros.simulation.random_layout import Layout, mover_box, quad_distance, random_layout
from emoflow_ros.simulation.random_motion import Demand, Path, mover_path, random_path
from emoflow_ros.simulation.scene import Quad, Scene, Trajectory
from emoflow_ros.simulation.simulated_truth import GroundTruth

CLEARANCE = 0.3  # m, from the camera to any static surface, at least
_CLEARANCE_SHARE = 0.25  # of the typical depth: the camera keeps its distance from walls
GRID = 16  # px: motion is measured on every 16th pixel
_FAR = 80.0  # m: sky and hills do not count for the image's motion
_LARGEST_ACCELERATION = np.radians(3000)  # rad/s^2
_ROUNDS = 6


def random_camera(factors: Factors) -> Camera:
    """Draw the true camera: focal length, centre and lens."""
    rng = factors.generator("camera")
    width, height = factors.size
    focal = factors.focal * width
    model = factors.lens
    distortion: tuple[float, ...] = ()
    if model == "plumb_bob":
        k1 = -float(rng.uniform(0.15, 0.38))
        k2 = k1 * k1 * float(rng.uniform(0.8, 1.3))  # the mapping stays monotone
        distortion = (k1, k2, float(rng.normal(0, 5e-4)), float(rng.normal(0, 5e-4)))
    elif model == "rational_polynomial":  # OpenCV's: the denominator takes on what k1 leaves
        k1, k4 = (float(rng.uniform(*bounds)) for bounds in ((-0.2, 0.1), (0.1, 0.3)))
        distortion = (k1, 0.0, 0.0, 0.0, 0.0, k4, 0.0, 0.0)
    elif model == "equidistant":
        drawn = rng.uniform((-0.05, -0.01, -0.02, -0.005), (0.0, 0.015, 0.005, 0.01))
        distortion = tuple(float(k) for k in drawn)
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=focal * float(1 + rng.normal(0, 0.002)),
        cx=width * float(0.5 + rng.normal(0, 0.01)),
        cy=height * float(0.5 + rng.normal(0, 0.01)),
        model=model,
        distortion=distortion,
    )


def given_camera(factors: Factors, camera: Camera) -> Camera:
    """Return the calibration that users are given: off by `calibration_error`."""
    error = factors.calibration_error
    if error == 0:
        return camera
    rng = factors.generator("calibration")
    focal = 1 + error * float(rng.choice((-1, 1)))
    shift = error * camera.width / 2 * rng.uniform(-1, 1, 2)
    return dataclasses.replace(
        camera,
        fx=camera.fx * focal,
        fy=camera.fy * focal,
        cx=camera.cx + float(shift[0]),
        cy=camera.cy + float(shift[1]),
        distortion=tuple(k * float(1 + 5 * error * rng.uniform(-1, 1)) for k in camera.distortion),
    )


def coarse_truth(camera: Camera, scene: Scene) -> GroundTruth:
    """Truth on every GRID-th pixel; its flow is in units of GRID pixels."""
    return GroundTruth(
        dataclasses.replace(
            camera,
            width=-(-camera.width // GRID),
            height=-(-camera.height // GRID),
            fx=camera.fx / GRID,
            fy=camera.fy / GRID,
            cx=(camera.cx + 0.5) / GRID - 0.5,
            cy=(camera.cy + 0.5) / GRID - 0.5,
        ),
        scene,
        0,
    )


def random_scene(factors: Factors, camera: Camera, duration_s: float) -> Scene:
    """Build surfaces and motions; nothing is painted yet.

    The camera's motion is scaled until the image moves as `image_motion` says, as far as the
    surfaces around it and the largest angular acceleration allow.
    """
    layout = random_layout(factors)
    rng = factors.generator("motion")
    yaw, pitch = float(rng.uniform(-0.2, 0.2)), layout.pitch + float(rng.normal(0, 0.06))
    rate = factors.image_motion * 10 / camera.fx
    demand = Demand(rate * layout.depth, rate, layout.reach, duration_s)
    path = random_path(factors.motion, demand, rng)
    path = _fitted(path, (yaw, pitch), layout, factors.image_motion, camera, duration_s)
    movers, boxes = _movers(factors, camera, layout, path, (yaw, pitch), duration_s)
    return Scene(layout.quads + boxes, path.trajectory(yaw, pitch), movers)


def image_motion(camera: Camera, scene: Scene, duration_s: float) -> float:
    """RMS over time of the median over pixels of the image's motion, px per 100 ms."""
    truth = coarse_truth(camera, scene)
    medians = []
    for t in np.linspace(0, duration_s, 40):
        ns = int(t * NS_PER_S)
        speed = np.linalg.norm(truth.flow(ns), axis=-1)
        near = (truth.depth(ns) < _FAR) & np.isfinite(speed)
        medians.append(np.median(speed[near]) if near.any() else 0.0)
    return float(np.sqrt(np.mean(np.square(medians))) * GRID * 0.1)


def _fitted(
    path: Path,
    gaze: tuple[float, float],
    layout: Layout,
    wanted: float,
    camera: Camera,
    duration_s: float,
) -> Path:
    """Scale a path towards the wanted image motion, short of flying into anything."""
    place = rotation = 1.0
    times = np.linspace(0, duration_s, 400)
    for k in range(_ROUNDS):
        place = _with_clearance(path, place, rotation, gaze, layout, times)
        acceleration = _acceleration(path.scaled(place, rotation), times)
        rotation *= min(1.0, _LARGEST_ACCELERATION / acceleration)
        if k == _ROUNDS - 1:
            break
        scene = Scene(layout.quads, path.scaled(place, rotation).trajectory(*gaze))
        found = image_motion(camera, scene, duration_s)
        if found == 0 or abs(found / wanted - 1) < 0.03:
            break
        change = float(np.clip(wanted / found, 0.3, 3.0))
        place, rotation = place * change, min(rotation * change, 4.0)
    return path.scaled(place, rotation)


def _with_clearance(
    path: Path,
    place: float,
    rotation: float,
    gaze: tuple[float, float],
    layout: Layout,
    times: NDArray[np.float64],
) -> float:
    """Shrink the translation until the camera keeps its distance from everything."""
    start = float(quad_distance(layout.quads, np.zeros((1, 3)))[0])
    allowed = min(max(CLEARANCE, _CLEARANCE_SHARE * layout.depth), 0.7 * start)
    for _ in range(40):
        trajectory = path.scaled(place, rotation).trajectory(*gaze)
        way = np.stack([trajectory.pose(t)[1] for t in times])
        if quad_distance(layout.quads, way).min() >= allowed:
            break
        place *= 0.85
    return place


def _acceleration(path: Path, times: NDArray[np.float64]) -> float:
    trajectory = path.trajectory(0.0, 0.0)
    return max(1e-9, *(float(np.linalg.norm(trajectory.angular_acceleration(t))) for t in times))


def _movers(
    factors: Factors,
    camera: Camera,
    layout: Layout,
    path: Path,
    gaze: tuple[float, float],
    duration_s: float,
) -> tuple[tuple[Trajectory, ...], tuple[Quad, ...]]:
    """Objects in front of the first view, which move along with the camera."""
    rng = factors.generator("movers")
    rotation, _ = path.trajectory(*gaze).pose(0.0)
    trajectories: list[Trajectory] = []
    boxes: list[Quad] = []
    for k in range(factors.movers):
        distance = layout.depth * float(rng.uniform(0.4, 0.65))
        pixels = np.sqrt(factors.mover_share / factors.movers * camera.width * camera.height)
        side = float(max(pixels, 4) / camera.fx * distance)
        distance = max(distance, CLEARANCE + side)
        boxes += mover_box(factors, k, side, distance, rng)
        x, y = rng.uniform(-0.3, 0.3, 2) * (1, camera.height / camera.width) / factors.focal
        start = rotation @ (distance * np.array([x, y, 1.0]))
        rate = factors.mover_motion * 10 / camera.fx
        motion = mover_path(Demand(rate * distance, rate, 0.3 * distance, duration_s), rng)
        motion = dataclasses.replace(motion, velocity=path.velocity)
        trajectories.append(
            motion.trajectory(0.0, 0.0, (float(start[0]), float(start[1]), float(start[2])))
        )
    return tuple(trajectories), tuple(boxes)
