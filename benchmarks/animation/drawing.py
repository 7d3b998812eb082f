"""The pictures of the animation, the curves below them, and the file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image as Pillow

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import flow_to_rgb, warped_counts
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, Window
from emoflow_ros.truth.ground_truth import TwistSource

Image = NDArray[np.uint8]
Array = NDArray[np.float64]

BACKGROUND, TEXT, GRID = "#0f141b", "#d5dbe3", "#2a323d"
ON, OFF = (255, 170, 76), (86, 182, 255)
AXES = (("x", "#ff6b6b"), ("y", "#62d26f"), ("z", "#6ea8fe"))
PANEL_PX = 300  # width of a picture
WIDTH_PX, CHART_PX, GAP_PX, TITLE_PX = 3 * PANEL_PX + 40, 210, 10, 24
SHOWN_MS = 30  # of events as they come
FORMATS = {".webp": "WEBP", ".gif": "GIF", ".png": "PNG"}
_STYLE: Any = {
    "font.family": "DejaVu Sans", "font.size": 9, "text.color": TEXT, "axes.labelcolor": TEXT,
    "axes.edgecolor": GRID, "xtick.color": TEXT, "ytick.color": TEXT, "axes.facecolor": BACKGROUND,
    "figure.facecolor": BACKGROUND, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.6, "axes.titlesize": 9.5,
}  # fmt: skip


@dataclass(frozen=True)
class Flight:
    """What is shown: events of a camera, and its true velocity where that is known."""

    camera: Camera
    events: Events
    twists: TwistSource | None


@dataclass(frozen=True)
class Step:
    """One window and its estimate."""

    window: Window
    estimate: Estimate


def frame(flight: Flight, steps: Sequence[Step], i: int) -> Image:
    """Draw the pictures of step i, and the twists up to it: (H, W, 3) RGB."""
    pictures = panels(flight.camera, steps[i], longest(steps))
    height = round(PANEL_PX * flight.camera.height / flight.camera.width)
    total = TITLE_PX + height + GAP_PX + CHART_PX
    canvas = Pillow.new("RGB", (WIDTH_PX, total), BACKGROUND)
    for k, picture in enumerate(pictures):
        small = Pillow.fromarray(picture).resize((PANEL_PX, height), Pillow.Resampling.LANCZOS)
        canvas.paste(small, (GAP_PX + k * (PANEL_PX + GAP_PX), TITLE_PX))
    drawn = chart(flight, steps, i)
    canvas.paste(Pillow.fromarray(drawn), (0, TITLE_PX + height + GAP_PX))
    canvas.paste(Pillow.fromarray(titles()), (0, 0))
    return np.asarray(canvas)


def longest(steps: Sequence[Step]) -> float:
    """Length of the flow in full colour, px/s: the same in all frames."""
    flows = [s.estimate.flow.velocity(s.estimate.t) for s in steps if s.estimate.flow]
    return float(np.median([np.percentile(np.linalg.norm(f, axis=-1), 98) for f in flows]))


def panels(camera: Camera, step: Step, full: float) -> tuple[Image, Image, Image]:
    """Draw the events as they come, the window's where the flow carries them, and the flow."""
    size = camera.width, camera.height
    window, estimate = step.window, step.estimate
    raw = recent(window, estimate.t, camera)
    if estimate.flow is None:
        dark = np.full_like(raw, _rgb(BACKGROUND))
        return raw, dark, dark
    counts = warped_counts(window, estimate.flow, estimate.t, *size).astype(np.float64)
    light = np.minimum(counts / max(float(np.quantile(counts[counts > 0], 0.98)), 1.0), 1.0)
    sharp = mpl.colormaps["inferno"](0.06 + 0.94 * light**0.7)[..., :3]
    colors = flow_to_rgb(estimate.flow.velocity(estimate.t), full) / 255
    shade = 0.35 + 0.65 * light[..., None] ** 0.5
    return raw, _bytes(sharp), _bytes(colors * shade)


def recent(window: Window, t: int, camera: Camera) -> Image:
    """Draw the events of SHOWN_MS around t, ON and OFF in two colours."""
    half = SHOWN_MS * NS_PER_MS // 2
    events = window.events[abs(window.events.t - t) <= half]
    image = np.full((camera.height, camera.width, 3), _rgb(BACKGROUND), np.uint8)
    for polarity, color in ((False, OFF), (True, ON)):
        mine = events[events.p == polarity]
        image[mine.y, mine.x] = color
    return image


@mpl.rc_context(_STYLE)
def chart(flight: Flight, steps: Sequence[Step], i: int) -> Image:
    """Draw the twists of the windows up to step i."""
    figure = Figure(figsize=(WIDTH_PX / 100, CHART_PX / 100), dpi=100)
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.06, right=0.985, top=0.87, bottom=0.13, wspace=0.13)
    t = np.array([s.estimate.t for s in steps])
    seconds = (t - steps[0].window.t_start) / NS_PER_S
    angular = np.degrees([s.estimate.angular for s in steps])
    spread = np.degrees([_deviations(s.estimate.covariance[3:, 3:]) for s in steps])
    has_twist = np.array([s.estimate.motion is not None for s in steps])
    linear = np.array([s.estimate.linear for s in steps])
    across = np.array([_deviations(s.estimate.covariance[:3, :3]) for s in steps])
    has_linear = has_twist & (np.linalg.norm(linear, axis=1) > 0)
    truths = [flight.twists.twist(int(x)) if flight.twists else None for x in t]
    true_w = np.array([np.degrees(x.angular) if x else np.full(3, np.nan) for x in truths])
    true_v = np.array(
        [_unit(x.linear) if x and x.linear is not None else np.full(3, np.nan) for x in truths]
    )
    far = 1.3 * max(float(np.nanmax(np.abs([*angular[has_twist], *true_w]))), 5.0)
    _curves(left, seconds, angular, spread, true_w, has_twist, i)
    _curves(right, seconds, linear, across, true_v, has_linear, i)
    left.set(title="angular velocity, deg/s", ylim=(-far, far), xlim=(0, seconds[-1] + 0.05))
    title = "direction of translation (bands: 2 standard deviations"
    title += "; white: truth)" if flight.twists else ")"
    right.set(title=title, ylim=(-1.2, 1.2), xlim=(0, seconds[-1] + 0.05))
    right.legend(*left.get_legend_handles_labels(), loc=(0.02, 0.66), ncols=3, frameon=False)
    return _drawn(figure)


def _curves(
    axes: Axes, seconds: Array, values: Array, spread: Array, true: Array, known: Any, i: int
) -> None:
    """Draw three components with a band of 2 standard deviations, up to step i."""
    shown = known & (np.arange(len(seconds)) <= i)
    for k, (name, color) in enumerate(AXES):
        line = np.where(shown, values[:, k], np.nan)
        band = 2 * np.where(shown, spread[:, k], np.nan)
        axes.fill_between(seconds, line - band, line + band, color=color, alpha=0.25, lw=0)
        axes.plot(seconds, line, "o-", color=color, lw=1.6, ms=2.2, label=name)
        axes.plot(seconds[: i + 1], true[: i + 1, k], ".", color=TEXT, ms=2.2, alpha=0.9)
    axes.axvline(seconds[i], color=TEXT, lw=0.7, alpha=0.6)
    axes.xaxis.set_major_formatter("{x:.1f} s")


@mpl.rc_context(_STYLE)
def titles() -> Image:
    """Draw the names of the three pictures."""
    figure = Figure(figsize=(WIDTH_PX / 100, TITLE_PX / 100), dpi=100)
    for k, title in enumerate(("events", "sharpened by the flow", "optical flow")):
        middle = GAP_PX + k * (PANEL_PX + GAP_PX) + PANEL_PX / 2
        figure.text(middle / WIDTH_PX, 0.5, title, ha="center", va="center", fontsize=10)
    return _drawn(figure)


def _drawn(figure: Figure) -> Image:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _deviations(covariance: Array) -> Array:
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _rgb(color: str) -> Image:
    return _bytes(np.array(mpl.colors.to_rgb(color)))


def _bytes(image: Array) -> Image:
    return np.rint(255 * image).astype(np.uint8)


def save(path: Path, frames: Sequence[Image], frame_ms: float) -> None:
    """Write an animation that repeats for ever; the last frame stays for a second."""
    path.parent.mkdir(parents=True, exist_ok=True)
    images = [Pillow.fromarray(picture) for picture in frames]
    lasting = [round(frame_ms)] * (len(images) - 1) + [1000]
    kind = FORMATS[path.suffix]
    options = {"quality": 72, "method": 6} if kind == "WEBP" else {}
    images[0].save(
        path, kind, save_all=True, append_images=images[1:], duration=lasting, loop=0, **options
    )
