"""The benchmark of the running node: its events, and its figures by hand."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import _event_loop
from benchmarks._event_loop import EVENTS, MARKS, START, Loop, Sensor, simulate_loops, write_loop
from benchmarks._node_figures import (
    MACHINE,
    Observed,
    Sample,
    Sent,
    Targets,
    ages_ms,
    drop_runs,
    figures,
    process_table,
    rows,
    usage,
)
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import Events, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_files import open_bag
from msg_adapters import make_decoder

MS = 1_000_000
FRAME = 4_096_000  # ns
CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
SENT = Sent(messages=2500, events=1000, windows=100)
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
        order = [(c.topic, t - START) for c, t, _ in bag.messages() if c.topic in (EVENTS, MARKS)]
    ends = [FRAME * (k + 1) // per_frame for k in range(10 * per_frame)]
    expected = []
    for k, end in enumerate(ends):
        if k % every == 0:
            expected.append((MARKS, end))
        expected.append((EVENTS, end))
    assert order == expected


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


def test_age_is_from_the_stamp_to_the_publication():
    """The recording runs at twice its pace: 100 ms of it take 50 ms."""
    marks = [(START, 100.0), (START + 100 * MS, 100.05), (START + 200 * MS, 100.1)]
    twists = [(START + 50 * MS, 100.045), (START + 200 * MS, 100.13)]
    assert ages_ms(marks, twists) == pytest.approx([20, 30], abs=1e-3)


def test_runs_of_dropped_windows():
    statuses = ["ok", "dropped", "dropped", "ok", "dropped", "no_motion", "dropped"]
    assert drop_runs(statuses) == {"mean": pytest.approx(4 / 3), "longest": 2, "ratio": 1.5}
    assert drop_runs(["ok"]) == {"mean": None, "longest": 0, "ratio": None}


def samples(mb: float, cores: float, mb_per_s: float = 0.0) -> list[Sample]:
    """Eleven samples from 100 to 110 s, and one each before and after the events."""
    return [Sample(99 + k, mb + mb_per_s * k, 5 + cores * k) for k in range(13)]


def observed() -> Observed:
    """Ten seconds at 1x; a twist each 10 ms, 25 ms old, but for a gap of 200 ms."""
    twists = [(START + k * 10 * MS, 100 + k / 100 + 0.025) for k in range(1000)]
    return Observed(
        marks=[(START + k * 4 * MS, 100 + k / 250) for k in range(2501)],
        twists=twists[:500] + twists[519:],
        with_covariance=95,
        statuses=["ok"] * 95 + ["dropped"] * 2 + ["no_motion"] + ["dropped"],
        diagnostics={
            "status": "ok",
            "messages": "2500",
            "seq_gaps": "0",
            "events": "990",
            "events_dropped": "40",
            "windows": "100",
            "windows_ok": "95",
            "windows_no_motion": "1",
            "windows_dropped": "3",
            "windows_failed": "0",
            "windows_forgotten": "0",
        },
        samples={
            "node": samples(250, 0.3),
            "worker": samples(180, 0.5, 1.0),
            "replay": samples(90, 0.1),
            MACHINE: samples(4000, 1.4),
        },
    )


def test_figures_of_a_run():
    found = figures(observed(), SENT)
    assert found["replayed_at"] == pytest.approx(1)
    assert found["twists_per_s"] == pytest.approx(881 / 9)  # of 9 s without the first one
    assert found["longest_gap_ms"] == pytest.approx(200)
    assert found["age_ms"] == pytest.approx({"p50": 25, "p95": 25, "max": 25}, abs=1e-3)
    assert found["windows"] == {
        "expected": 100,
        "answered": 96,
        "with a twist": 95,
        "dropped": 3,
        "not accounted for": 1,
        "drop runs": {"mean": 1.5, "longest": 2, "ratio": pytest.approx(4 / 3)},
    }
    assert found["messages"] == {
        "sent": 2500,
        "lost": 0,
        "skipped": 0,
        "in part": 0,
        "not accounted for": 0,
    }
    assert found["events"] == {
        "sent": 1000,
        "counted": 990,
        "miscounted": 10,
        "in dropped windows": 40,
    }
    processes = found["processes"]
    assert processes["node + worker"]["resident_mb_max"] == pytest.approx(430 + 11)
    assert processes["node + worker"]["growth_mb_per_min"] == pytest.approx(60)
    assert processes["node + worker"]["cpu_s_per_recorded_s"] == pytest.approx(0.8)
    assert processes["all others"]["cores"] == pytest.approx(0.5)
    others = process_table(processes).splitlines()[-1].split()
    assert others == [
        "all",
        "others",
        "-",
        "-",
        "0.50",
        "0.500",
    ]


def test_processor_time_is_per_second_of_the_recording():
    taken = {role: samples(1, 1.0) for role in ("node", "worker", MACHINE)}
    used = usage(taken, 99, 111, pace=5.0)
    assert used["node"]["cores"] == pytest.approx(1.0)
    assert used["node"]["cpu_s_per_recorded_s"] == pytest.approx(0.2)


def test_every_figure_of_a_case_is_judged():
    found = figures(observed(), SENT)
    targets = Targets(50, age_p50_ms=20, age_p95_ms=45, lost=0, longest_run=3)
    judged = {row.figure: row.verdict for row in rows("fresh", 1, targets, found)}
    assert judged == {
        "fresh: replayed at": "met",
        "fresh: twists per second": "met",
        "fresh: age of a twist, median, ms": "missed",
        "fresh: age of a twist, 95 %, ms": "met",
        "fresh: age of a twist, longest, ms": "",
        "fresh: longest gap between twists, ms": "",
        "fresh: windows": "",
        "fresh: windows with a twist": "",
        "fresh: windows lost": "missed",
        "fresh: longest run of dropped windows, over the mean": "met",
        "fresh: windows not accounted for": "missed",
        "fresh: messages lost before the node": "met",
        "fresh: messages left out by the node": "met",
        "fresh: messages decoded in part": "met",
        "fresh: messages not accounted for": "met",
        "fresh: events miscounted": "missed",
        "fresh: memory of node + worker, MB": "met",
        "fresh: its growth in the later half, MB/min": "",  # from five minutes on
    }
    slow = rows("overload", 5, Targets(), found)[0]
    assert (slow.at_least, slow.verdict) == (pytest.approx(4.95), "missed")


def test_messages_that_the_queue_lost_are_gaps():
    run = observed()
    run.diagnostics |= {"messages": "2400", "seq_gaps": "90"}
    found = figures(run, SENT)
    assert found["messages"] == {
        "sent": 2500,
        "lost": 100,
        "skipped": 0,
        "in part": 0,
        "not accounted for": 10,
    }
    assert found["events"]["miscounted"] is None  # nobody knows which are missing


def test_messages_that_the_node_left_out_are_no_gaps():
    run = observed()
    run.diagnostics |= {"messages": "2400", "messages_skipped": "95", "seq_gaps": "3"}
    found = figures(run, SENT)
    assert found["messages"] == {
        "sent": 2500,
        "lost": 5,
        "skipped": 95,
        "in part": 0,
        "not accounted for": 2,
    }
    assert found["events"]["miscounted"] is None


def test_events_of_messages_in_part_are_not_miscounted():
    run = observed()
    run.diagnostics |= {"messages_in_part": "1000", "events": "900000"}
    found = figures(run, SENT)
    assert found["messages"]["in part"] == 1000
    assert found["events"]["miscounted"] is None
    assert "fresh: messages decoded in part" in [
        row.figure for row in rows("fresh", 1, Targets(lost=0), found) if row.verdict == "missed"
    ]


def test_a_run_that_is_too_short_is_refused():
    with pytest.raises(InputError, match="no events came over DDS"):
        figures(Observed(), SENT)
    short = Observed(marks=[(START, 100.0), (START + MS, 100.5)])
    with pytest.raises(InputError, match=r"--seconds: 0\.5 s of replay"):
        figures(short, SENT)
