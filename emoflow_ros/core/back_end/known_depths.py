"""Depths of the scene that are known in the middle of a window: of patches, and earlier windows.

A window's flow shows a depth at each node of its lattice, once the motion at that time is known.
The scene stays, so what earlier windows have shown is carried on along the way of the camera.
"""

from collections.abc import Iterable, Sequence

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

_BEYOND = 0.15  # of half the image: depths that far outside still tell of its border


def known_depths(
    patches: Patches, x: Unknowns, shown: Iterable[ShownFlow], way: AdjustedMotion,
    estimate: Estimate, image: WorkingImage, settings: BackEndSettings,
) -> Depths:  # fmt: skip
    """Inverse depths over the mean one, in the middle of a window.

    Args:
        patches: followed up to the newest node.
        x: motion that their depths belong to.
        shown: by earlier windows; those beyond the nodes do not count.
        way: of the camera over the nodes.
        estimate: of the window.
        image: that the patches are followed in.
        settings: of the back end.

    Returns:
        At points in the sensor's pixels, on the image or near it.
    """
    parts = [_of_patches(patches, x, int(way.times[-1]), estimate, image, settings)]
    if way.translates:
        within = [flow for flow in shown if way.times[0] <= flow.t <= way.times[-1]]
        parts.append(carried_on(within, way, estimate.t, image.sensor, settings))
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
    weight = _weight(
        patches.of_depth[known], patches.inverse_depth[known], depth, settings.patch_depth_sd
    )
    return Depths(points, depth, weight)


def carried_on(
    shown: Sequence[ShownFlow], way: AdjustedMotion, t: int, camera: Camera,
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
    if not shown:
        return Depths(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    parts = [_points(flow, way, settings) for flow in shown]
    points, rho, information, static = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    rotation, position = pose(way.times, way.x, t)
    seen = (points - position) @ rotation
    # Far outside a lens may fold: it would put points back into the image.
    reach = (1 + _BEYOND) * max(np.linalg.norm(f.epipolar.bearings, axis=1).max() for f in shown)
    off_axis, depth = np.linalg.norm(seen[:, :2], axis=1), seen[:, 2]
    ahead = (depth > 1 / settings.depths[1]) & (off_axis < reach * depth)
    place, last = camera.project(seen[ahead]), np.array(camera.size) - 1
    beyond = 0.5 * _BEYOND * max(camera.size)
    near = ((place > -beyond) & (place < last + beyond)).all(axis=1)
    chosen = np.flatnonzero(ahead)[near]
    now = 1 / depth[chosen]
    weight = _weight(information[chosen], rho[chosen], now, settings.node_depth_sd)
    return Depths(place[near], now, static[chosen] * weight)


def _points(
    shown: ShownFlow, way: AdjustedMotion, settings: BackEndSettings
) -> tuple[Array, Array, Array, Array]:
    """Points (N, 3) of the way's common frame that a window has shown.

    Besides, (N,) each, their inverse depths, the information on them, and how far they count.
    """
    angular, linear, _ = interpolated(way.times, way.x, shown.t)
    rho, information, static = shown.inverse_depths(angular, linear)
    far, near = settings.depths
    known = (rho > far) & (rho < near)
    rotation, position = pose(way.times, way.x, shown.t)
    rays = shown.epipolar.bearings[known] @ rotation[:, :2].T + rotation[:, 2]
    points = rays / rho[known, None] + position
    return points, rho[known], information[known], static[known]


def _weight(information: Array, then: Array, now: Array, sd: float) -> Array:
    """How much inverse depths count: half where they are known to a standard deviation.

    A depth changes by a length that is the same for all errors of it, its inverse r by
    dr' = (r'/r)^2 dr.

    Args:
        information: on them then.
        then, now: inverse depths.
        sd: that standard deviation.
    """
    certain = np.maximum(information, 0.0) * (then / now) ** 4 * sd**2
    return certain / (1 + certain)
