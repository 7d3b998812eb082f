"""When a replay sends its messages, on a clock of the test's own."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.commands.replay import Pace, Player
from emoflow_ros.readers.bag_files import open_bag


class Clock:
    """Time that passes in waits, and in what a test says."""

    def __init__(self) -> None:
        self.now = 100.0

    def time(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def sent(rate: float, costs: dict[int, float]) -> tuple[list[float], float]:
    """Times of 30 messages, recorded 10 ms apart, with what happens before some; the lag."""
    clock = Clock()
    pace = Pace(rate, clock.time, clock.sleep)
    times = []
    for i in range(30):
        clock.now += costs.get(i, 0.0)
        pace.wait(0.01 * i)
        times.append(round(clock.now - 100.0, 6))
    return times, pace.lag_s


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_messages_keep_their_distances_at_the_rate(rate: float) -> None:
    times, lag = sent(rate, {})
    assert times == pytest.approx([0.01 * i / rate for i in range(30)])
    assert lag == pytest.approx(0)


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_after_a_stop_the_replay_goes_on_from_where_it_was(rate: float) -> None:
    times, lag = sent(rate, {10: 7.0, 20: 3600.0})
    steps = [after - before for before, after in pairwise(times)]
    assert min(steps) == pytest.approx(0.01 / rate, abs=1e-5)  # no burst
    usual = [s for i, s in enumerate(steps) if i not in (9, 19)]
    assert usual == pytest.approx([0.01 / rate] * 27, abs=1e-5)
    assert lag == pytest.approx(0)


def test_a_slow_moment_is_made_up_for_and_told() -> None:
    times, lag = sent(1.0, {10: 0.1})
    assert times[10:18] == pytest.approx([0.19] * 8)  # in a short burst
    assert times[-1] == pytest.approx(0.29)
    assert lag == pytest.approx(0.09)


def test_a_stop_of_a_late_replay_leaves_it_as_late() -> None:
    times, lag = sent(1.0, {10: 0.3, 12: 50.0})
    assert lag == pytest.approx(0.29)
    assert times[12] == pytest.approx(50.39, abs=0.02)
    assert times[-1] == pytest.approx(50.39, abs=0.1)


@pytest.mark.parametrize("acknowledged", [True, False])
def test_rounds_follow_one_another_and_subscribers_are_waited_for_at_the_end_only(
    tmp_path: Path,
    make_events: Callable[..., Any],
    write_event_bag: Callable[..., Path],
    acknowledged: bool,
) -> None:
    """An acknowledgment may take 3 s, which is longer than a short recording."""
    published: list[bytes] = []
    waits: list[float] = []

    def wait(duration: Any) -> bool:
        waits.append(duration.nanoseconds / 1e9)
        return acknowledged

    publisher = SimpleNamespace(publish=published.append, wait_for_all_acked=wait)
    node: Any = SimpleNamespace(create_publisher=lambda *_: publisher)
    path = write_event_bag(tmp_path / "short.bag", [make_events(3)])
    with open_bag(path) as reader:
        player = Player(node, path, reader, topics=["/cam/camera_info"], with_clock=False)
        for _ in range(3):
            player.play(1000.0)
        assert (len(published), waits) == (3, [])
        assert player.finish() is acknowledged
    assert len(waits) == 1
    assert 3.0 < waits[0] <= 4.0
