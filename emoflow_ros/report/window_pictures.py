"""The pictures of one window: flow, truth, error, events before and after the warp, and tracks."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import FlowSampler
from emoflow_ros.core.products import Points, color_wheel, flow_to_rgb, trails, warped_counts
from emoflow_ros.evaluation.metrics import end_point_error
from emoflow_ros.evaluation.run_progress import Example
from emoflow_ros.report.figures import style
from emoflow_ros.truth import TrueFlow, Truth

_UNKNOWN = "#dddddd"
_MOVING = "#1f7fd8"
# Of the figure, the colour bar, the gaps and the titles of a row, in inches.
_WIDTH, _BAR, _GAP, _TITLE = 10.0, 0.75, 0.08, 0.3

_COLORS = "plasma_r"
_TRUE_POSITION = "#0b8043"


@style
def window_panels(example: Example, camera: Camera, truth: Truth) -> Figure:
    """Draw one window: flow, events before and after the warp; truth and error where known."""
    window = example.window
    flow = example.estimate.flow
    assert flow is not None, "the gallery holds windows with a flow only"
    estimated = flow.displacement(window.t_start, window.t_end).astype(np.float64)
    true = truth.flows.displacement(window.t_start, window.t_end) if truth.flows else None
    longest = _longest(estimated, true)
    panels, figure = _grid(camera, *((1, 4) if true is None else (2, 3)))

    _show(panels.pop(0), flow_to_rgb(estimated, longest), "Estimated flow")
    if true is not None:
        known = np.where(true.valid[..., None], true.displacement, np.nan)
        _show(panels.pop(0), flow_to_rgb(known, longest), "True flow (black: unknown)")
        _error_map(panels.pop(0), end_point_error(estimated, known), true.moving)
    before, after, legend = panels
    _events(before, after, example, flow, camera)
    _wheel(legend, longest)
    return figure


def _grid(camera: Camera, rows: int, columns: int) -> tuple[list[Axes], Figure]:
    """Lay panels of the camera's shape out by hand, which is much faster than by a solver."""
    panel = (_WIDTH - _BAR - (columns - 1) * _GAP) / columns
    height = rows * (panel * camera.height / camera.width + _TITLE)
    figure = Figure(figsize=(_WIDTH, height))
    axes = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(
        left=0,
        right=1 - _BAR / _WIDTH,
        bottom=0,
        top=1 - _TITLE / height,
        wspace=_GAP / panel,
        hspace=_TITLE / (height / rows - _TITLE),
    )
    for ax in axes.flat:
        ax.axis("off")
    return list(axes.flat), figure


def _longest(estimated: NDArray[np.float64], true: TrueFlow | None) -> float:
    """Length of full colour: nearly the longest of the truth, or of the estimate without one."""
    if true is not None and true.valid.any():
        judged = true.displacement[true.valid].astype(np.float64)
    else:
        judged = estimated[np.isfinite(estimated).all(axis=-1)]
    lengths = np.linalg.norm(judged, axis=-1)
    return max(float(np.percentile(lengths, 99.9)), 1e-3) if lengths.size else 1.0


def _error_map(
    ax: Axes,
    error: NDArray[np.floating[Any]],
    moving: NDArray[np.bool_] | None,
) -> None:
    known = error[np.isfinite(error)]
    limit = max(3.0, float(np.percentile(known, 95))) if known.size else 3.0
    ax.axis("on")
    ax.set(xticks=[], yticks=[], facecolor=_UNKNOWN)
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(False)
    image = ax.imshow(error, cmap="magma_r", vmin=0, vmax=limit, interpolation="nearest")
    beside = ax.inset_axes((1.03, 0.08, 0.04, 0.84))
    bar = beside.figure.colorbar(image, cax=beside, extend="max")
    bar.set_label("end-point error, px")
    bar.outline.set_visible(False)
    title = "Error (grey: truth unknown)"
    if moving is not None and moving.any():
        ax.contour(moving, [0.5], colors=_MOVING, linewidths=0.9)
        title = "Error (outlined: moves by itself)"
    ax.set_title(title, loc="left")


def _events(left: Axes, right: Axes, example: Example, flow: FlowSampler, camera: Camera) -> None:
    """Events before and after the warp on one grey scale, so that sharpness can be compared."""
    window, size = example.window, (camera.width, camera.height)
    cells = window.events.y.astype(np.int64) * camera.width + window.events.x
    counts = np.bincount(cells, minlength=camera.width * camera.height)
    before = counts.reshape(camera.height, camera.width)
    after = warped_counts(window, flow, (window.t_start + window.t_end) // 2, *size)
    limit = float(np.percentile(after[after > 0], 99.5)) if (after > 0).any() else 1.0
    for ax, image, title in (
        (left, before, "Events before the warp"),
        (right, after, "Events warped to the middle"),
    ):
        _show(ax, image, title, cmap="gray_r", vmin=0, vmax=limit)


def _wheel(ax: Axes, longest: float) -> None:
    """Legend: direction and length of the flow colours."""
    inset = ax.inset_axes((0.2, 0.24, 0.64, 0.62))
    inset.imshow(color_wheel(201), extent=(-longest, longest, longest, -longest))
    inset.set_aspect("equal")
    inset.set_title("Flow colours", loc="center")
    inset.set_xlabel("u (right), px")
    inset.set_ylabel("v (down), px")
    inset.grid(visible=False)
    for spine in inset.spines.values():
        spine.set_visible(False)


def _show(ax: Axes, image: NDArray[np.generic], title: str, **options: Any) -> None:
    ax.imshow(image, interpolation="nearest", **options)
    ax.set_title(title, loc="left")


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
            LineCollection(list(np.stack([ends, true], 1)), colors=_TRUE_POSITION, linewidths=0.6)
        )
        ax.scatter(
            true[:, 0], true[:, 1], s=26, facecolors="none", edgecolors=_TRUE_POSITION,
            linewidths=0.9, zorder=3, label="true position",
        )  # fmt: skip
