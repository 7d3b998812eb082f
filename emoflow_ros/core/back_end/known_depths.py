"""Depths of the scene that are known in the middle of a window: of patches, and earlier windows.

A window's flow shows a depth at each node of its lattice, once the motion at that time is known.
The scene stays, so what earlier windows have shown is carried on along the way of the camera.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.back_end.scene import depths_now
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import AdjustedMotion, interpolated, pose
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.preparation import WorkingImage
from emoflow_ros.core.lattice.refinement import Depths, ShownFlow
from emoflow_ros.core.types.estimate import Estimate

Array = NDArray[np.float64]

_MARGIN = 0.075  # of the image's longer side, beyond which a depth tells nothing of its border


def known_depths(
    patches: Patches, x: Unknowns, shown: Iterable[ShownFlow], way: AdjustedMotion,
    estimate: Estimate, image: WorkingImage, settings: BackEndSettings,
) -> Depths:  # fmt: skip
    """Inverse depths over the mean one, in the middle of a window.

    Args:
        patches: followed up to the newest node.
        x: motion that their depths belong to.
        shown: by earlier windows, within the nodes.
        way: of the camera over the nodes.
        estimate: of the window.
        image: that the patches are followed in.
        settings: of the back end.

    Returns:
        At points in the sensor's pixels, on the image or near it.
    """
    parts = [_of_patches(patches, x, int(way.times[-1]), estimate, image, settings)]
    if way.translates:
        parts.append(carried_on(shown, way, estimate.t, image.sensor, settings))
    columns = zip(*((d.points, d.inverse_depth, d.weight) for d in parts), strict=True)
    return Depths(*(np.concatenate(column) for column in columns))


def _of_patches(
    patches: Patches, x: Unknowns, newest: int, estimate: Estimate, image: WorkingImage,
    settings: BackEndSettings,
) -> Depths:  # fmt: skip
    """Depths of the patches that the newest slice (ns) shows.

    In a window without a flow they stay where that slice shows them.
    """
    known = patches.shown & np.isfinite(patches.inverse_depth)
    depth = depths_now(patches, x, settings.depths)[known]
    points = patches.place[known] * image.sensor_px
    if estimate.flow is not None:
        points = estimate.flow.tracks(points, [newest, estimate.t])[1]
    # On the way the error of a depth grows as the depth does.
    information = patches.of_depth[known] * (patches.inverse_depth[known] / depth) ** 2
    return Depths(points, depth, _weight(information, settings.patch_depth_sd))


def carried_on(
    shown: Iterable[ShownFlow], way: AdjustedMotion, t: int, camera: Camera,
    settings: BackEndSettings,
) -> Depths:  # fmt: skip
    """Inverse depths, over the mean one, that earlier windows have shown, at a later time (ns).

    Args:
        shown: by these windows.
        way: of a camera that translates, from there to the later time.
        t: that time.
        camera: of the sensor.
        settings: of the back end.
    """
    parts = [(np.zeros((0, 3)), np.zeros(0)), *(_points(flow, way, settings) for flow in shown)]
    points, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    rotation, position = pose(way.times, way.x, t)
    seen = (points - position) @ rotation
    ahead = seen[:, 2] > 1 / settings.depths[1]
    place, depth = camera.project(seen[ahead]), 1 / seen[ahead, 2]
    margin, last = _MARGIN * max(camera.size), np.array(camera.size) - 1
    near = ((place > -margin) & (place < last + margin)).all(axis=1)
    return Depths(place[near], depth[near], weight[ahead][near])


def _points(
    shown: ShownFlow, way: AdjustedMotion, settings: BackEndSettings
) -> tuple[Array, Array]:
    """Points (N, 3) of the way's common frame that a window has shown, and their weights (N,)."""
    angular, linear, _ = interpolated(way.times, way.x, shown.t)
    rho, information, static = shown.inverse_depths(angular, linear)
    far, near = settings.depths
    known = (rho > far) & (rho < near)
    rotation, position = pose(way.times, way.x, shown.t)
    rays = shown.epipolar.bearings[known] @ rotation[:, :2].T + rotation[:, 2]
    weight = static * _weight(information, settings.node_depth_sd)
    return rays / rho[known, None] + position, weight[known]


def _weight(information: Array, sd: float) -> Array:
    """How much depths count: half where they are known to a standard deviation."""
    certain = np.maximum(information, 0.0) * sd**2
    return certain / (1 + certain)
