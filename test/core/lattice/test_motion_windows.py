"""Windows by motion on streams that leave an exact number of events per pixel they move."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_paths import CAMERA, MS, PER_PX, START, ExactEstimator, Path, policy

from emoflow_ros.config import Config, load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.lattice.motion_windows import MotionWindows
from emoflow_ros.core.products.continuous import ContinuousEstimator
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.stream.bounded_windows import BoundedWindows
from emoflow_ros.core.stream.cleaning import CleanWindows
from emoflow_ros.core.types.events import NS_PER_S, Events, Window, WindowPolicy, WindowSlicer
from emoflow_ros.core.types.expected import Expected
from emoflow_ros.factory import make_estimator


def run(path: Path, policy: WindowPolicy, fails=lambda k: False) -> list[Window]:
    """The parts that are estimated."""
    exact = ExactEstimator(path, fails)
    estimator = MotionWindows(exact, CAMERA, policy)
    for window in WindowSlicer(policy).push(path.events):
        estimate = estimator.estimate(window)
        part = exact.windows[-1]
        assert (estimate.t_start, estimate.t_end) == (part.t_start, part.t_end)
        assert part.t_end == window.t_end
        assert part.events.t[-1] == window.events.t[-1]
    return exact.windows


def test_the_first_window_is_taken_whole():
    exact = ExactEstimator(path := Path([200.0] * 3))
    windows = WindowSlicer(policy()).push(path.events)
    MotionWindows(exact, CAMERA, policy()).estimate(windows[0])
    assert exact.windows == windows[:1]


def test_the_displacement_is_the_length_of_the_path():
    """There and back: 0, 3, 0, -3, 0 px."""

    class Shake:
        def tracks(self, points, times):
            assert len(times) == 5
            return points + np.array([0.0, 3.0, 0.0, -3.0, 0.0])[:, None, None] * [1.0, 0.0]

    class Shaken(ExactEstimator):
        def estimate(self, window):
            return replace(super().estimate(window), flow=Shake())

    inner = Shaken(Path([200.0] * 3))
    estimator = MotionWindows(inner, CAMERA, policy(bound=8.0))
    window = Window(START, START + 100 * MS, Path([200.0] * 3).events[:1000])
    for _ in range(2):
        estimator.estimate(window)
    assert [len(w.events) for w in inner.windows] == [1000, 667]  # 12 px, two thirds next


@pytest.mark.parametrize(("px_s", "events"), [(60.0, 1000), (160.0, 500), (800.0, 100)])
def test_where_no_motion_was_seen_a_part_is_as_long_as_the_expected_flow_allows(px_s, events):
    """8 px, and 100 events at least; where nothing is expected the third part has 250."""
    path = Path([200.0] * 3)
    inner = ExactEstimator(path, lambda k: True)
    estimator = MotionWindows(inner, CAMERA, policy(bound=8.0, min_count=100))
    flow = np.array([0.6 * px_s, -0.8 * px_s])
    expected = Expected(lambda points: np.tile(flow, (len(points), 1)), np.zeros(3), np.zeros(3))
    window = Window(START, START + 100 * MS, path.events[:1000])
    for _ in range(2):
        estimator.estimate(window)
    estimator.estimate(replace(window, expected=expected))
    assert [len(w.events) for w in inner.windows] == [1000, 1000, events]


@pytest.mark.parametrize(("change_px", "events"), [(2.0, 1000), (8.0, 500), (32.0, 250)])
def test_a_change_that_the_fit_leaves_out_shortens_the_next_part(change_px, events):
    """By the square root of what it is over 2 px; the displacement would allow twice the events."""

    class Changing(ExactEstimator):
        def estimate(self, window):
            found = super().estimate(window)
            return replace(found, quality=replace(found.quality, change_px=change_px))

    path = Path([200.0] * 3)
    inner = Changing(path)
    estimator = MotionWindows(inner, CAMERA, policy(bound=40.0, min_count=50))
    window = Window(START, START + 100 * MS, path.events[:1000])
    for _ in range(2):
        estimator.estimate(window)
    assert [len(w.events) for w in inner.windows] == [1000, events]


def test_the_displacement_is_the_bound():
    path = Path([200.0] * 6)
    for part in run(path, policy(8.0))[1:]:
        assert path.between(part.t_start, part.t_end) == pytest.approx(8.0, abs=1.5 / PER_PX)
        assert part.duration == pytest.approx(0.04, abs=1e-4)


@pytest.mark.parametrize("change", [0.25, 4.0])
def test_a_change_of_speed_counts_at_once(change):
    """Also in the window in which it happens, and with the old estimate."""
    path = Path([200.0] * 4 + [200.0 * change] * 4)
    parts = run(path, policy(8.0, stride_ms=23.0))[1:]
    assert [p for p in parts if p.t_start < START + 400 * MS < p.t_end]
    for part in parts:
        assert path.between(part.t_start, part.t_end) == pytest.approx(8.0, abs=2 / PER_PX)


def test_slow_motion_gets_the_whole_window():
    parts = run(Path([30.0] * 8), policy(8.0, duration_ms=200.0, stride_ms=100.0))
    assert [round(p.duration, 6) for p in parts[2:]] == [0.2] * (len(parts) - 2)


def test_few_events_lengthen_a_part():
    """5 events per pixel: 8 px hold 40 of them, 100 are wanted."""
    parts = run(Path([200.0] * 6, per_px=5), policy(8.0, min_count=100, stride_ms=50.0))
    assert [len(p.events) for p in parts[1:]] == [100] * (len(parts) - 1)
    assert parts[-1].duration == pytest.approx(0.1, abs=0.002)


def test_texture_is_learnt_in_one_window():
    """Ten times as many events per pixel from one moment on."""
    weak, strong = Path([200.0] * 4), Path([200.0] * 4, per_px=10 * PER_PX)
    offset = int(weak.events.t[-1] - START)
    later = Events(strong.events.x, strong.events.y, strong.events.t + offset, strong.events.p)
    path = Path([200.0] * 8)
    path.events = Events.concatenate([weak.events, later])
    moved = [path.between(p.t_start, p.t_end) for p in run(path, policy(8.0))]
    first = next(k for k in range(2, len(moved)) if moved[k] < 7.9)
    assert moved[first] == pytest.approx(0.8, abs=0.02)
    assert moved[-1] == pytest.approx(8.0, abs=2 / PER_PX)


def test_without_an_estimate_windows_are_whole_and_every_other_one_shorter():
    path = Path([100.0] * 10)
    given = policy(8.0, min_count=50, duration_ms=200.0, stride_ms=100.0)
    parts = run(path, given, fails=lambda k: k < 7)
    assert [len(p.events) for p in parts[:7]] == [1000, 1000, 250, 1000, 60, 1000, 250]
    last = parts[-1]
    assert path.between(last.t_start, last.t_end) == pytest.approx(8.0, abs=1.5 / PER_PX)


def test_reset_forgets_the_motion_and_resets_the_estimator():
    path = Path([400.0] * 4)
    exact = ExactEstimator(path)
    estimator = MotionWindows(exact, CAMERA, policy(8.0, min_count=120))
    windows = WindowSlicer(policy()).push(path.events)
    for window in windows[:2]:
        estimator.estimate(window)
    assert len(exact.windows[-1].events) == pytest.approx(400, abs=2)
    estimator.reset()
    assert exact.resets == 1
    estimator.estimate(windows[0])  # time has gone back
    assert exact.windows[-1] == windows[0]


def test_windows_whose_last_events_lie_at_their_end_have_a_length():
    t = np.full(300, START, np.int64)
    t[50:] += MS
    x = np.zeros(300, np.uint16)
    window = Window(START, START + MS, Events(x, x, t, np.ones(300, np.bool_)))
    exact = ExactEstimator(Path([100.0]))
    estimator = MotionWindows(exact, CAMERA, policy(bound=0.01))
    for _ in range(2):
        estimator.estimate(window)
    assert exact.windows[1].duration == 1 / NS_PER_S


@settings(max_examples=60)
@given(
    st.lists(st.floats(5.0, 2000.0), min_size=3, max_size=10),
    st.floats(2.0, 40.0),
    st.sets(st.integers(0, 30)),
    st.integers(1, 3),
)
def test_parts_move_on_and_depend_on_the_past_only(speeds, bound, failing, kept):
    def parts(path):
        """The part of each window, and whether it has an estimate."""
        estimated = run(path, policy(bound), fails=lambda k: k in failing)
        return [(p, k not in failing) for k, p in enumerate(estimated)]

    whole = parts(Path(speeds))
    for a, b in pairwise(p for p, succeeds in whole if succeeds):
        assert a.t_start <= b.t_start < b.t_end
        assert a.t_end < b.t_end
    early = parts(Path(speeds[: -kept or None]))
    ends = [(p.t_start, p.t_end, len(p.events)) for p, _ in early]
    assert [(p.t_start, p.t_end, len(p.events)) for p, _ in whole][: len(ends)] == ends


def test_nine_tenths_of_the_image_keep_to_the_bound():
    """A shear: a pixel in column x moves by x / 100 px in each part."""

    class Shear:
        def tracks(self, points, times):
            return np.stack([points, points + np.outer(points[:, 0] / 100, [0.0, 1.0])])

    class Sheared(ExactEstimator):
        def estimate(self, window):
            return replace(super().estimate(window), flow=Shear())

    camera = Camera(1600, 16, 100.0, 100.0, 800.0, 8.0)
    path = Path([200.0] * 3)
    inner = Sheared(path)
    bound = 7.2 * 345 / 1599  # is in pixels of a sensor that is 346 wide
    estimator = MotionWindows(inner, camera, policy(bound=bound, min_count=100))
    window = Window(START, START + 100 * MS, path.events[:1000])
    for _ in range(2):
        estimator.estimate(window)
    # Columns 8, 24, ... 1592: nine tenths are left of 1433.6, which moves by 14.336 px.
    assert [len(w.events) for w in inner.windows] == [1000, round(1000 * 7.2 / 14.336)]


def test_windows_are_taken_whole_unless_a_bound_is_set():
    outer = [BoundedWindows, CleanWindows, ContinuousEstimator, RememberingEstimator]
    whole = load_config(overrides={"window.max_displacement_px": 0.0})
    assert layers(whole) == [*outer, LatticeEstimator]
    assert layers(load_config()) == [*outer, MotionWindows, LatticeEstimator]


def test_a_fixed_motion_model_needs_no_memory():
    fixed = load_config(overrides={"estimator.model": "rotation"})
    assert RememberingEstimator not in layers(fixed)


def layers(config: Config) -> list[type]:
    """Return the classes of the estimator and of what it wraps, from the outside."""
    found, estimator = [], make_estimator(CAMERA, config)
    while estimator is not None:
        found.append(type(estimator))
        estimator = getattr(estimator, "_estimator", None)
    return found


@pytest.mark.parametrize("stride_ms", [25.0, 100.0])
def test_estimates_by_the_gyro_alone_come_in_order_of_time(stride_ms):
    """Their parts are long and short in turn, but the middle of one is after the last one's."""
    path = Path([100.0] * 10)
    fails = lambda k: k % 7 < 5  # noqa: E731
    exact = ExactEstimator(path, fails, gyro=True)
    given = policy(8.0, duration_ms=200.0, stride_ms=stride_ms)
    estimator = MotionWindows(exact, CAMERA, given)
    windows = WindowSlicer(given).push(path.events)
    times = [estimator.estimate(w).t for w in windows]
    assert len(times) > 8
    assert (np.diff(times) > 0).all()
    estimator.reset()
    again = estimator.estimate(windows[0])  # time has gone back: what came later counts no more
    assert again.t_end - again.t_start > 50 * MS
