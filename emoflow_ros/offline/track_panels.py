"""The picture of the point tracks up to the end of one window."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.flow_color import flow_to_rgb
from emoflow_ros.core.sharpened import warped_counts
from emoflow_ros.core.tracks import Points, trails
from emoflow_ros.offline.figures import style
from emoflow_ros.offline.gallery import Example

_COLORS = "plasma_r"
_TRUTH = "#0b8043"


@style
def track_panels(example: Example, camera: Camera) -> Figure:
    """Draw the tracks over the events warped to the window's end, and over its flow."""
    window, flow = example.window, example.estimate.flow
    assert flow is not None, "the gallery holds windows with a flow only"
    paths, ages = trails(example.tracks)
    figure = Figure(figsize=(10, 5 * camera.height / camera.width + 1.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    sharp = warped_counts(window, flow, window.t_end, camera.width, camera.height)
    limit = 2.0 * float(np.percentile(sharp[sharp > 0], 99)) if (sharp > 0).any() else 1.0
    left.imshow(sharp, cmap="gray_r", vmin=0, vmax=limit)
    colors = flow_to_rgb(flow.displacement(window.t_start, window.t_end))
    right.imshow(colors)
    lines = _colored(left, paths, ages)
    right.add_collection(LineCollection(list(paths), colors="#222222", linewidths=0.9))
    _heads(left, example, truth=True)
    _heads(right, example, truth=False)
    for ax, title in ((left, "Events warped to the window's end"), (right, "Estimated flow")):
        ax.axis("off")
        ax.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5))
        ax.set_title(title, loc="left")
    bar = figure.colorbar(lines, ax=[left, right], location="bottom", shrink=0.4, aspect=50)
    bar.set_label("time before the window's end, s")
    bar.outline.set_visible(False)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=len(labels))
    return figure


def _colored(ax: Axes, paths: Points, ages: Points) -> LineCollection:
    lines = LineCollection(list(paths), cmap=_COLORS, linewidths=1.5, capstyle="round")
    lines.set_array(ages.mean(axis=1))
    lines.set_clim(0, float(ages.max()) if len(ages) else 1.0)
    ax.add_collection(lines)
    return lines


def _heads(ax: Axes, example: Example, *, truth: bool) -> None:
    """Mark where the points are at the window's end and, where known, should be."""
    last = example.tracks[-1]
    ends, true = last.positions[-1], last.true_ends[-1]
    ax.scatter(
        ends[:, 0], ends[:, 1], s=7, color="#222222", linewidths=0, zorder=3,
        label="estimated position",
    )  # fmt: skip
    if truth and np.isfinite(true).any():
        true = np.where(np.isfinite(ends), true, np.nan)
        ax.add_collection(
            LineCollection(list(np.stack([ends, true], 1)), colors=_TRUTH, linewidths=0.6)
        )
        ax.scatter(
            true[:, 0], true[:, 1], s=26, facecolors="none", edgecolors=_TRUTH, linewidths=0.9,
            zorder=3, label="true position",
        )  # fmt: skip
