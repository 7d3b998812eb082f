"""The charts of a report: what is drawn stays inside its figure."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from emoflow_ros.core.types.estimate import MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS
from emoflow_ros.evaluation.metrics import FlowErrors
from emoflow_ros.evaluation.trajectory_errors import Trajectory
from emoflow_ros.evaluation.window_results import WindowResult
from emoflow_ros.report import figures
from emoflow_ros.truth import TrueTwist

LONG_NAME = "/a/robot/of/many/parts/front/event_camera/vicon/odometry (nav_msgs/msg/Odometry)"


def windows_of(size: float, truths: int = 1) -> list[WindowResult]:
    """Windows whose numbers, and their errors, are about of one size."""
    rng = np.random.default_rng(0)
    return [
        WindowResult(
            index,
            index * 100 * NS_PER_MS,
            (index + 1) * 100 * NS_PER_MS,
            30_000,
            Status.OK,
            MotionModel.FULL,
            rng.normal(size=3),
            size * rng.normal(size=3),
            np.full(6, 0.1 * size),
            TrueTwist(size * rng.normal(size=3), rng.normal(size=3)),
            FlowErrors(size * rng.random(), 0, 0, 0, 0, size, 100),
            Quality(30_000),
            other_truths=(TrueTwist(np.zeros(3), np.ones(3)),) * (truths - 1),
        )
        for index in range(20)
    ]


def outside_in(figure: Figure | None) -> float:
    """How far what is drawn goes beyond the figure, inches."""
    assert figure is not None
    FigureCanvasAgg(figure).draw()
    drawn = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    return float(max(-drawn.x0, -drawn.y0, drawn.x1 - width, drawn.y1 - height))


@pytest.mark.parametrize("size", [0.002, 0.3, 40.0, 2345.0])
@pytest.mark.parametrize(
    "draw", [figures.twist_over_time, figures.errors_over_time, figures.error_histograms]
)
def test_numbers_of_every_size_stay_in_the_figure(draw, size):
    assert outside_in(draw(windows_of(size))) <= 0


@pytest.mark.parametrize("size", [0.002, 0.3, 40.0, 123_456.0])
def test_paths_and_runs_of_every_size_stay_in_the_figure(size):
    poses = np.tile(np.eye(4), (20, 1, 1))
    poses[:, :3, 3] = size * np.random.default_rng(0).normal(size=(20, 3))
    path = Trajectory(np.arange(20) * 100 * NS_PER_MS, poses, poses[::-1])
    assert outside_in(figures.trajectory(path)) <= 0
    series = {(float(k), float(k + 1)): size * k for k in range(20)}
    assert outside_in(figures.runs_over_time([("a", series), ("b", series)], "EPE", "px")) <= 0


def test_the_path_is_drawn_beside_the_truth():
    """A way of another scale and world: a similarity brings it onto the true one."""
    positions = np.cumsum(np.random.default_rng(2).normal(size=(20, 3)), axis=0)
    true, ours = np.tile(np.eye(4), (2, 20, 1, 1))
    true[:, :3, 3], ours[:, :3, 3] = positions, 0.1 * positions[:, [1, 2, 0]] + 3.0
    path = Trajectory(np.arange(20) * 100 * NS_PER_MS, ours, true).scaled()
    above, over_time = figures.trajectory(path).axes
    lines = {line.get_label(): line.get_xydata() for line in above.lines}
    assert lines["ground truth"].shape == (20, 2)
    np.testing.assert_allclose(lines["estimate"], lines["ground truth"], atol=1e-9)
    np.testing.assert_allclose(over_time.lines[0].get_ydata(), 0, atol=1e-9)


@pytest.mark.parametrize("names", [["poses"], ["poses", "IMU"], ["poses", LONG_NAME, LONG_NAME]])
def test_the_names_of_truths_stay_in_the_figure(names):
    windows = windows_of(0.3, len(names))
    figure = figures.twist_over_time(windows, names)
    assert outside_in(figure) <= 0
    [legend] = figure.legends
    below_axes = min(ax.get_tightbbox().y0 for ax in figure.axes)
    assert legend.get_window_extent().y1 <= below_axes
    assert [text.get_text() for text in legend.get_texts()] == [
        "± 2 standard deviations",
        *(f"truth: {name}" for name in names),
        "estimate",
    ]
