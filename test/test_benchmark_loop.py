"""The events that the benchmark of the running node replays."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import _event_loop
from benchmarks._event_loop import (
    CALIBRATION,
    EVENTS,
    MARKS,
    START,
    Loop,
    Sensor,
    simulate_loops,
    write_loop,
)
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events, WindowPolicy, WindowSlicer
from emoflow_ros.readers.bag_files import open_bag
from msg_adapters import make_decoder

MS = 1_000_000
FRAME = 4_096_000  # ns
CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
POLICY = WindowPolicy(duration_ms=20, stride_ms=10)


def frame(index: int, count: int) -> Events:
    """Events of one frame, spread evenly over its microseconds."""
    rng = np.random.default_rng(index)
    us = index * 4096 + np.arange(count) * 4096 // count
    x, y = (rng.integers(0, size, count, dtype=np.uint16) for size in CAMERA.size)
    return Events(x, y, 1000 * us, rng.random(count) < 0.5)


def looped(frames: int, count: int, mev_per_s: float | None = None, per_frame: int = 1) -> Loop:
    loop = Loop(CAMERA, mev_per_s, per_frame)
    for index in range(frames):
        loop.add_frame(frame(index, count))
    return loop


def decoded(path: Path) -> list[Events]:
    """The events of a bag's packets, as the node decodes them."""
    with open_bag(path) as bag:
        decoder = make_decoder("event_camera_msgs/msg/EventPacket", "cdr")
        return [decoder.decode(data).events for c, _, data in bag.messages() if c.topic == EVENTS]


def test_bag_repeats_the_loop_with_later_times(tmp_path):
    """4200 frames: EVT3's time wraps after 4096 of them."""
    loop = looped(5, 40, per_frame=2)
    seconds = 4200 * FRAME / 1e9
    write_loop(tmp_path / "bag", loop, seconds, 1)
    packets = decoded(tmp_path / "bag")
    assert len(packets) == 8400
    for k in (0, 3, 4096, 4199):
        both = Events.concatenate(packets[2 * k : 2 * k + 2])
        expected = frame(k % 5, 40)
        np.testing.assert_array_equal(both.t, expected.t + k // 5 * 5 * FRAME)
        for name in ("x", "y", "p"):
            np.testing.assert_array_equal(getattr(both, name), getattr(expected, name))
    assert sum(map(len, packets)) == loop.events(seconds) == 4200 * 40


@pytest.mark.parametrize(("pace", "per_frame", "every"), [(1, 1, 1), (5, 1, 5), (1, 4, 4)])
def test_a_mark_comes_before_a_packet_every_4_ms_of_the_replay(tmp_path, pace, per_frame, every):
    loop = looped(5, 40, per_frame=per_frame)
    write_loop(tmp_path / "bag", loop, 10 * FRAME / 1e9, pace)
    with open_bag(tmp_path / "bag") as bag:
        order = [(c.topic, t - START) for c, t, _ in bag.messages()]
    assert order[0] == (CALIBRATION, -2_000 * MS * pace)  # subscribers find it meanwhile
    order = [(topic, t) for topic, t in order if topic != CALIBRATION]
    ends = [FRAME * (k + 1) // per_frame for k in range(10 * per_frame)]
    marks = {(MARKS, end) for end in ends[::every]}
    both = [(topic, end) for end in ends for topic in (MARKS, EVENTS)]
    assert order == [one for one in both if one[0] == EVENTS or one in marks]


def test_loop_counts_the_windows_that_its_events_give():
    loop = looped(10, 30)
    seconds = 25 * FRAME / 1e9
    slicer = WindowSlicer(POLICY)
    shifted = []
    for k in range(25):
        part = frame(k % 10, 30)
        shifted.append(Events(part.x, part.y, part.t + k // 10 * 10 * FRAME, part.p))
    windows = [window for part in shifted for window in slicer.push(part)]
    assert loop.windows(seconds, POLICY) == len(windows) == 9


def test_rate_is_bounded_by_leaving_out_events_evenly():
    loop = looped(2, 400, mev_per_s=100 / 4096)
    assert loop.counts == [100, 100]
    kept = frame(1, 400).t[::4]
    assert loop.spans[1] == (kept[0], kept[-1])


def test_a_packet_without_events_is_refused():
    loop = Loop(CAMERA, None, 2)
    early = frame(0, 40)
    with pytest.raises(ValueError, match="no events from 2048000 to 4096000 ns"):
        loop.add_frame(early[early.t < 2048_000])


def test_loops_are_of_one_turn(monkeypatch):
    monkeypatch.setattr(_event_loop, "_FRAMES", 100)
    [sparse, dense] = simulate_loops(Sensor(40, 30, 0.1), [(0.01, 1), (None, 1)])
    assert len(sparse.packets) == len(dense.packets) == 100
    assert sparse.counts == [min(count, 41) for count in dense.counts]  # 10 000 per second
    assert max(dense.counts) > 41
    assert 99 * FRAME <= dense.spans[-1][0] < dense.spans[-1][1] < 100 * FRAME


def test_camera_comes_back_where_it_began():
    trajectory = _event_loop.circle(4.0)
    for before, after in zip(trajectory.pose(0.1), trajectory.pose(4.1), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-12)
    speeds = [np.linalg.norm(trajectory.twist(t), axis=1) for t in np.linspace(0, 4, 100)]
    assert np.mean(speeds, axis=0) == pytest.approx([0.42, np.radians(10)], rel=0.05)
