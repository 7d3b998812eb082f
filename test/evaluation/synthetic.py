"""Recordings of a textured plane with a closed form, written as MVSEC and DSEC write theirs."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import h5py
import hdf5plugin
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events
from emoflow_ros.simulation import messages as msg
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording_files import Topic, write_bag

_NORMAL = np.array([0.15, -0.1, 1.0])  # of the plane n X = 2 m in the world
_DISTANCE = 2.0
STEP = NS_PER_MS  # between two looks at the points that make events


@dataclass
class Plane:
    """A camera with a constant twist (in its own axes) before a plane of dots."""

    camera: Camera
    start: int
    end: int
    angular: np.ndarray
    linear: np.ndarray
    dots: int = 4800

    def pose(self, t: int) -> np.ndarray:
        """World-from-camera (4, 4): the closed form of a constant twist."""
        s = (t - self.start) / NS_PER_S
        angle = np.linalg.norm(self.angular)
        x, y, z = self.angular / angle
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        a = angle * s
        integral = s * np.eye(3) + (1 - np.cos(a)) / angle * cross
        integral += (s - np.sin(a) / angle) * cross @ cross
        transform = np.eye(4)
        transform[:3, :3] = Rotation.from_rotvec(self.angular * s).as_matrix()
        transform[:3, 3] = integral @ self.linear
        return transform

    def depth(self, t: int) -> np.ndarray:
        """Depth (H, W) in m along the optical axis."""
        rotation, position = self.pose(t)[:3, :3], self.pose(t)[:3, 3]
        return (_DISTANCE - _NORMAL @ position) / (self._rays @ rotation.T @ _NORMAL)

    def displacement(self, t0: int, t1: int) -> np.ndarray:
        """Where the points that pixels see at t0 are at t1, minus the pixels: (H, W, 2)."""
        points = self._rays * self.depth(t0)[..., None]
        motion = np.linalg.inv(self.pose(t1)) @ self.pose(t0)
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        return self.camera.project(moved) - self.camera.project(points)

    @cached_property
    def events(self) -> Events:
        """An event whenever a dot enters another pixel."""
        return dot_events(self, self.camera.project)

    def dots_in_camera(self, t: int) -> np.ndarray:
        """The dots (N, 3) in the camera's axes, in spots of 16."""
        rng = np.random.default_rng(4)
        spots = rng.uniform(-1, 1, (self.dots // 16, 1, 2)) * 1.2 * _DISTANCE
        xy = (spots + rng.normal(0, 0.01, (self.dots // 16, 16, 2))).reshape(-1, 2)
        z = (_DISTANCE - xy @ _NORMAL[:2]) / _NORMAL[2]
        world = np.column_stack([xy, z])
        inverse = np.linalg.inv(self.pose(t))
        return world @ inverse[:3, :3].T + inverse[:3, 3]

    @cached_property
    def _rays(self) -> np.ndarray:
        grid = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        bearings, _ = self.camera.undistort(np.stack(grid, -1).astype(float))
        return np.concatenate([bearings, np.ones((*bearings.shape[:2], 1))], -1)


def dot_events(world: Plane, project) -> Events:
    """Events of the dots under a projection, in whole microseconds and in order."""
    width, height = world.camera.width, world.camera.height
    rng = np.random.default_rng(5)
    brighter = np.arange(world.dots // 16 * 16) % 32 < 16  # every other spot
    parts, before = [], None
    for t in range(world.start, world.end, STEP):
        at = np.rint(project(world.dots_in_camera(t)))
        if before is not None:
            moved = (at != before).any(-1)
            inside = moved & (at >= 0).all(-1) & (at < (width, height)).all(-1)
            x, y = at[inside].astype(np.uint16).T
            times = t - STEP + 1000 * np.sort(rng.integers(1, STEP // 1000, inside.sum()))
            parts.append(Events(x, y, times.astype(np.int64), brighter[inside]))
        before = at
    return Events.concatenate(parts)


def write_mvsec_bags(folder: Path, name: str, world: Plane, frames, stamps) -> tuple[Path, Path]:
    """`<name>_data.bag` (events, image_raw) and `<name>_gt.bag` (pose, odometry, depth)."""
    encoder = MessageEncoder(ros1=True)
    events, camera = world.events, world.camera

    def batch(end):
        a, b = np.searchsorted(events.t, [end - 10 * NS_PER_MS, end])
        return encoder.events(end, camera, events[a:b])

    def grey(t):  # only the header is read
        return encoder.depth_image(t, np.zeros((camera.height, camera.width)))

    def pose(t):
        return encoder.pose(t, world.pose(t))

    def depth(t):
        return encoder.depth_image(t, world.depth(t))

    def other_depth(t):  # of the right camera: nobody may take it for the left one's
        return encoder.depth_image(t, 9 * world.depth(t))

    ends = range(world.start + 10 * NS_PER_MS, world.end + 10 * NS_PER_MS, 10 * NS_PER_MS)
    poses = range(world.start, world.end, 10 * NS_PER_MS)
    data, truth = folder / f"{name}_data.bag", folder / f"{name}_gt.bag"
    topics = [
        Topic("/davis/left/events", msg.EVENT_ARRAY, ends, batch),
        Topic("/davis/right/events", msg.EVENT_ARRAY, ends, batch),
        Topic("/davis/left/image_raw", msg.IMAGE, _even(frames), grey),
    ]
    write_bag(data, encoder, topics, progress=False)
    topics = [
        Topic("/davis/left/pose", msg.POSE, poses, pose),
        Topic("/davis/left/odometry", msg.POSE, poses, pose),
        Topic("/davis/left/depth_image_raw", msg.IMAGE, _even(stamps), depth),
        Topic("/davis/right/depth_image_raw", msg.IMAGE, _even(stamps), other_depth),
    ]
    write_bag(truth, encoder, topics, progress=False)
    return data, truth


def write_mvsec_hdf5(folder: Path, name: str, world: Plane, frames, stamps) -> tuple[Path, Path]:
    """`<name>_data.hdf5` and `<name>_gt.hdf5`, which has poses at 100 Hz and raw depth."""
    events = world.events
    data, truth = folder / f"{name}_data.hdf5", folder / f"{name}_gt.hdf5"
    with h5py.File(data, "w") as file:
        p = np.where(events.p, 1.0, -1.0)
        file["davis/left/events"] = np.column_stack([events.x, events.y, events.t / 1e9, p])
        file["davis/left/image_raw_ts"] = np.array(frames) / 1e9
    poses = range(world.start, world.end, 10 * NS_PER_MS)
    with h5py.File(truth, "w") as file:
        file["davis/left/pose"] = np.array([world.pose(t) for t in poses])
        file["davis/left/pose_ts"] = np.array(poses) / 1e9
        file["davis/left/depth_image_raw"] = np.array([world.depth(t) for t in stamps], np.float32)
        file["davis/left/depth_image_raw_ts"] = np.array(stamps) / 1e9
    return data, truth


def flow_maps(world: Plane, stamps) -> np.ndarray:
    """MVSEC's flow (N, H, W, 2): px to the next stamp, zero in a part of the image."""
    ends = [*stamps[1:], 2 * stamps[-1] - stamps[-2]]
    flow = np.array([world.displacement(a, b) for a, b in zip(stamps, ends, strict=True)])
    flow[:, :, :40] = 0  # unknown
    flow[:, 100, :, 1] = 0  # no v: does not count
    return flow


def write_flow_npz(path: Path, stamps, flow: np.ndarray) -> Path:
    """`<name>_gt_flow_dist.npz`."""
    np.savez(
        path, timestamps=np.array(stamps) / 1e9, x_flow_dist=flow[..., 0], y_flow_dist=flow[..., 1]
    )
    return path


def write_odom_npz(path: Path, world: Plane, stamps) -> dict[str, np.ndarray]:
    """`<name>_odom.npz`: the means in place and the spoilt orientations of MVSEC's script."""
    count = len(stamps)
    linear, angular = np.zeros((count, 3)), np.zeros((count, 3))
    for i in range(1, count):
        step = np.linalg.inv(world.pose(stamps[i - 1])) @ world.pose(stamps[i])
        dt = (stamps[i] - stamps[i - 1]) / NS_PER_S
        linear[i] = step[:3, 3] / dt
        angular[i] = Rotation.from_matrix(step[:3, :3]).as_rotvec() / dt
    for values in (linear, angular):
        for i in range(count):
            values[i] = values[max(0, i - 10) : i + 11].mean(axis=0)
    columns = {
        "timestamps": np.array(stamps) / 1e9,
        "lin_vel": linear,
        "ang_vel": angular,
        "pos": np.array([world.pose(t)[:3, 3] for t in stamps]),
        "quat": np.zeros((count, 4)),
    }
    np.savez(path, **columns)
    return columns


@dataclass
class DsecFiles:
    """A DSEC sequence as written, and what is in it.

    Attributes:
        path: the folder.
        raw: the events on the sensor.
        rectify_map: (480, 640, 2).
        intervals: (start, end) in ns.
        flow, valid: the truth of each interval.
    """

    path: Path
    raw: Events
    rectify_map: np.ndarray
    intervals: list[tuple[int, int]]
    flow: list[np.ndarray]
    valid: list[np.ndarray]


SENSOR = Camera(640, 480, 555.6, 555.8, 342.5, 215.2, "plumb_bob", (-0.091, 0.183, -0.0007, 0.0004))
TO_RECTIFIED = Rotation.from_rotvec([0.01, -0.02, 0.015]).as_matrix()


def write_dsec(path: Path, world: Plane, intervals, numbers) -> DsecFiles:
    """A sequence's folder; the world's camera is the rectified view, SENSOR sees the events."""
    raw = dot_events(world, lambda points: SENSOR.project(points @ TO_RECTIFIED))
    grid = np.stack(np.meshgrid(np.arange(640), np.arange(480)), -1).astype(float)
    bearings, _ = SENSOR.undistort(grid)
    rays = np.concatenate([bearings, np.ones((480, 640, 1))], -1) @ TO_RECTIFIED.T
    table = world.camera.project(rays).astype(np.float32)

    left, flow_folder = path / "events" / "left", path / "flow" / "forward"
    for folder in (left, flow_folder, path / "calibration"):
        folder.mkdir(parents=True)
    _write_dsec_events(left / "events.h5", raw)
    with h5py.File(left / "rectify_map.h5", "w") as file:
        file["rectify_map"] = table
    _write_dsec_calibration(path / "calibration" / "cam_to_cam.yaml", world.camera)
    rng = np.random.default_rng(6)
    files = DsecFiles(path, raw, table, list(intervals), [], [])
    lines = ["# from_timestamp_us, to_timestamp_us"]
    for (start, end), number in zip(intervals, numbers, strict=True):
        valid = rng.random((480, 640)) < 0.2
        code = np.rint(world.displacement(start, end) * 128) + 2**15
        code[~valid] = 0
        bgr = np.dstack([valid, code[..., 1], code[..., 0]]).astype(np.uint16)
        cv2.imwrite(str(flow_folder / f"{number:06d}.png"), bgr)
        files.flow.append(np.where(valid[..., None], (code - 2**15) / 128, 0))
        files.valid.append(valid)
        lines.append(f"{start // 1000}, {end // 1000}")
    (path / "flow" / "forward_timestamps.txt").write_text("\n".join(lines) + "\n")
    return files


def _write_dsec_events(path: Path, events: Events) -> None:
    microseconds = events.t // 1000
    offset = int(microseconds[0]) - 17
    t = (microseconds - offset).astype(np.uint32)
    columns = {"x": events.x, "y": events.y, "t": t, "p": events.p.astype(np.uint8)}
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"events/{name}", data=values, **hdf5plugin.Blosc(cname="zstd"))
        file["ms_to_idx"] = np.searchsorted(t, 1000 * np.arange(int(t[-1]) // 1000 + 1))
        file["t_offset"] = offset


def _write_dsec_calibration(path: Path, rectified: Camera) -> None:
    def view(camera: Camera) -> dict:
        return {
            "camera_matrix": [camera.fx, camera.fy, camera.cx, camera.cy],
            "distortion_coeffs": list(camera.distortion),
            "distortion_model": "radtan",
            "resolution": [camera.width, camera.height],
        }

    tree = {
        "extrinsics": {"R_rect0": TO_RECTIFIED.tolist()},
        "intrinsics": {"cam0": view(SENSOR), "camRect0": view(rectified)},
    }
    path.write_text(yaml.safe_dump(tree))


def _even(times) -> range:
    """Evenly spaced times as the range that a Topic wants."""
    return range(times[0], times[-1] + 1, times[1] - times[0])
