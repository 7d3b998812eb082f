"""The pictures of one window: flow, truth, error and events before and after the warp."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import FlowSampler
from emoflow_ros.core.flow_color import color_wheel, flow_to_rgb
from emoflow_ros.core.sharpened import warped_counts
from emoflow_ros.offline.figures import style
from emoflow_ros.offline.gallery import Example
from emoflow_ros.offline.metrics import end_point_error
from emoflow_ros.offline.truth import TrueFlow, Truth

_UNKNOWN = "#dddddd"
_MOVING = "#1f7fd8"
_WIDTH, _BAR, _TITLE = 10.0, 0.9, 0.3  # of the figure, its colour bar and a row's titles, inches


@style
def window_panels(example: Example, camera: Camera, truth: Truth) -> Figure:
    """Draw one window: flow, events before and after the warp; truth and error where known."""
    window = example.window
    flow = example.estimate.flow
    assert flow is not None, "the gallery holds windows with a flow only"
    estimated = flow.displacement(window.t_start, window.t_end).astype(np.float64)
    true = truth.flows.displacement(window.t_start, window.t_end) if truth.flows else None
    longest = _longest(estimated, true)
    rows, columns = (1, 4) if true is None else (2, 3)
    aspect = rows / columns * camera.height / camera.width
    width = _WIDTH if true is None else _WIDTH - _BAR
    figure = Figure(figsize=(_WIDTH, width * aspect + _TITLE * rows), layout="constrained")
    panels = list(figure.subplots(rows, columns).flat)
    for ax in panels:
        ax.axis("off")

    _show(panels.pop(0), flow_to_rgb(estimated, longest), "Estimated flow")
    if true is not None:
        known = np.where(true.valid[..., None], true.displacement, np.nan)
        _show(panels.pop(0), flow_to_rgb(known, longest), "True flow (black: unknown)")
        _error_map(figure, panels.pop(0), end_point_error(estimated, known), true.moving)
    before, after, legend = panels
    _events(before, after, example, flow, camera)
    _wheel(legend, longest)
    return figure


def _longest(estimated: NDArray[np.float64], true: TrueFlow | None) -> float:
    """Length of full colour: nearly the longest of the truth, or of the estimate without one."""
    if true is not None and true.valid.any():
        judged = true.displacement[true.valid].astype(np.float64)
    else:
        judged = estimated[np.isfinite(estimated).all(axis=-1)]
    lengths = np.linalg.norm(judged, axis=-1)
    return max(float(np.percentile(lengths, 99.9)), 1e-3) if lengths.size else 1.0


def _error_map(
    figure: Figure,
    ax: Axes,
    error: NDArray[np.floating],
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
    bar = figure.colorbar(image, ax=ax, shrink=0.85, pad=0.02, extend="max")
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
    inset = ax.inset_axes((0.18, 0.12, 0.64, 0.72))
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
