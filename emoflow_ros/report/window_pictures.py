"""The pictures of one window: flow, truth, error, events before and after the warp, and tracks."""

from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import (
    Image,
    Points,
    color_wheel,
    flow_to_rgb,
    trails,
    warped_counts,
)
from emoflow_ros.core.types.estimate import FlowSampler
from emoflow_ros.evaluation.metrics import Mask, end_point_error
from emoflow_ros.evaluation.run_progress import Example
from emoflow_ros.report.figures import style
from emoflow_ros.truth import TrueFlow, Truth

_UNKNOWN = "#dddddd"
_MOVING = "#1f7fd8"
_ERRORS = mpl.colormaps["magma_r"].with_extremes(bad=_UNKNOWN)
_EVENTS = mpl.colormaps["gray_r"]
_PAGE_PX = 1000  # width of the page, which the panels share
_WIDEST = 700  # px; of wider images every n-th pixel is shown, and events of n x n pixels together

_COLORS = "plasma_r"
_TRUE_POSITION = "#0b8043"


@dataclass(frozen=True)
class WindowPictures:
    """One window in pictures.

    Attributes:
        panels: titles and images (H, W, 3) uint8 RGB.
        longest_px: length of the flow in full colour.
        error_limit_px: error in the darkest colour; None without a true flow.
    """

    panels: tuple[tuple[str, Image], ...]
    longest_px: float
    error_limit_px: float | None

    @property
    def columns(self) -> int:
        """Number of panels side by side on the page."""
        return 4 if self.error_limit_px is None else 3

    @property
    def enlarged(self) -> bool:
        """Whether the page shows the images larger than they are."""
        return self.panels[0][1].shape[1] * self.columns < _PAGE_PX


def window_pictures(example: Example, camera: Camera, truth: Truth) -> WindowPictures:
    """Draw one window: flow, events before and after the warp; truth and error where known."""
    window = example.window
    flow = example.estimate.flow
    assert flow is not None, "the gallery holds windows with a flow only"
    step = -(-camera.width // _WIDEST)
    shown = slice(None, None, step), slice(None, None, step)
    estimated = flow.displacement(window.t_start, window.t_end)[shown].astype(np.float64)
    true = truth.flows.displacement(window.t_start, window.t_end) if truth.flows else None
    longest = _longest(estimated, true)
    panels = [("Estimated flow", flow_to_rgb(estimated, longest))]
    limit = None
    if true is not None:
        known = np.where(true.valid[..., None], true.displacement, np.nan)[shown]
        panels.append(("True flow (black: unknown)", flow_to_rgb(known, longest)))
        outline = None if true.moving is None else _outline(true.moving)[shown]
        title, image, limit = _error_map(end_point_error(estimated, known), outline)
        panels.append((title, image))
    panels += _events(example, flow, camera, step)
    return WindowPictures(tuple(panels), longest, limit)


def flow_legend() -> Image:
    """Draw the colours of the flow: all directions and lengths up to the longest."""
    return color_wheel(201)


def error_legend() -> Image:
    """Draw the colours of the error, from none to the limit, as one row."""
    return _rgb(_ERRORS, np.linspace(0, 1, 256)[None])


def _longest(estimated: NDArray[np.float64], true: TrueFlow | None) -> float:
    """Length of full colour: nearly the longest of the truth, or of the estimate without one."""
    if true is not None and true.valid.any():
        judged = true.displacement[true.valid].astype(np.float64)
    else:
        judged = estimated[np.isfinite(estimated).all(axis=-1)]
    lengths = np.linalg.norm(judged, axis=-1)
    return max(float(np.percentile(lengths, 99.9)), 1e-3) if lengths.size else 1.0


def _outline(moving: Mask) -> Mask:
    """Mark the border of what moves, so wide that a panel of the page shows it."""
    width = -(-3 * moving.shape[1] // _PAGE_PX)
    inside: Mask = binary_erosion(moving, iterations=width, border_value=1)
    return moving & ~inside


def _error_map(error: NDArray[np.floating[Any]], outline: Mask | None) -> tuple[str, Image, float]:
    """Colour the error, and outline what moves by itself; title, image and the colours' limit."""
    known = error[np.isfinite(error)]
    limit = max(3.0, float(np.percentile(known, 95))) if known.size else 3.0
    image = _rgb(_ERRORS, error / limit)
    if outline is None or not outline.any():
        return "Error (grey: truth unknown)", image, limit
    image[outline] = np.rint(255 * np.array(to_rgb(_MOVING)))
    return "Error (outlined: moves by itself)", image, limit


def _events(
    example: Example, flow: FlowSampler, camera: Camera, step: int
) -> list[tuple[str, Image]]:
    """Events before and after the warp on one grey scale, so that sharpness can be compared."""
    window, size = example.window, (camera.width, camera.height)
    cells = window.events.y.astype(np.int64) * camera.width + window.events.x
    counts = np.bincount(cells, minlength=camera.width * camera.height)
    before = _together(counts.reshape(camera.height, camera.width), step)
    middle = (window.t_start + window.t_end) // 2
    after = _together(warped_counts(window, flow, middle, *size), step)
    limit = float(np.percentile(after[after > 0], 99.5)) if (after > 0).any() else 1.0
    return [
        ("Events before the warp", _rgb(_EVENTS, before / limit)),
        ("Events warped to the middle", _rgb(_EVENTS, after / limit)),
    ]


def _together(counts: NDArray[np.int64], step: int) -> NDArray[np.int64]:
    """Add up the counts of step x step pixels; at the right and below there may be fewer."""
    counts = np.pad(counts, [(0, -length % step) for length in counts.shape])
    rows, columns = (length // step for length in counts.shape)
    return counts.reshape(rows, step, columns, step).sum(axis=(1, 3))


def _rgb(colors: mpl.colors.Colormap, values: NDArray[np.floating[Any]]) -> Image:
    """Colour values from 0 to 1; those beyond get the colours of the ends."""
    return np.asarray(colors(np.ma.masked_invalid(values), bytes=True))[..., :3].copy()


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
