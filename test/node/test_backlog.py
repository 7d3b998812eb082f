"""How much event time waits, and what is left out of it."""

from itertools import pairwise

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from headers import MS, message

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events
from emoflow_ros.node import backlog as module
from emoflow_ros.node.backlog import Backlog, LeftOut, stamp_of
from emoflow_ros.simulation.messages import MessageEncoder

CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
LENGTH = 20 * MS


def filled(*stamps_ms: float, taken_ms: int = 0) -> Backlog:
    """Messages with these stamps wait; messages of every ms before them have been taken."""
    backlog = Backlog()
    for stamp in range(int(stamps_ms[0]) - taken_ms, int(stamps_ms[0])):
        backlog.add(message(stamp))
        backlog.pop()
    for stamp in stamps_ms:
        backlog.add(message(stamp))
    return backlog


def popped(backlog: Backlog) -> list[bytes]:
    return [backlog.pop() for _ in range(len(backlog))]


@pytest.mark.parametrize("order", ["<", ">"])
def test_stamp_is_read_in_either_order_of_bytes(order: str) -> None:
    assert stamp_of(message(1_700_000_000_123, order)) == 1_700_000_000_123_000_000
    assert stamp_of(message(-1.5, order)) == -1_500_000


def test_stamp_is_that_of_a_whole_message() -> None:
    data = MessageEncoder(ros1=False).events(5_000_000_007, CAMERA, Events.empty())
    assert stamp_of(data) == 5_000_000_007


@pytest.mark.parametrize("data", [b"", b"\0\1", message(5)[:-1], b"\0\7" + message(5)[2:]])
def test_message_that_is_too_short_or_in_no_known_order_has_no_stamp(data: bytes) -> None:
    assert stamp_of(data) is None


def test_length_is_the_event_time_from_the_oldest_message_to_the_newest() -> None:
    backlog = filled(1000, 1004, 1003, 1015)
    assert backlog.length_ns == 15 * MS
    backlog.pop()
    assert backlog.length_ns == 11 * MS
    popped(backlog)
    assert backlog.length_ns == 0


def test_backlog_of_just_that_length_stays() -> None:
    backlog = filled(1000, 1020, taken_ms=50)
    assert backlog.shorten(LENGTH) is None
    assert popped(backlog) == [message(1000), message(1020)]


def test_longer_backlog_is_left_out_but_for_the_newest_message() -> None:
    backlog = filled(1000, 1010, 1020, 1021, taken_ms=50)
    assert backlog.shorten(LENGTH) == LeftOut(count=3, jump=0)
    assert popped(backlog) == [message(1021)]


def test_nothing_is_left_out_before_as_much_has_been_taken() -> None:
    backlog = filled(*range(1000, 1062))
    for stamp in range(1000, 1020):
        assert backlog.shorten(LENGTH) is None
        assert backlog.pop() == message(stamp)
    backlog.pop()  # that of 1020
    assert backlog.shorten(LENGTH) == LeftOut(count=40, jump=0)
    for stamp in range(1062, 1200):  # after the gap it begins anew
        backlog.add(message(stamp))
    for _ in range(21):
        assert backlog.shorten(LENGTH) is None
        backlog.pop()
    assert backlog.shorten(LENGTH) == LeftOut(count=117, jump=0)


def test_jump_takes_no_event_time_and_is_told_if_it_is_left_out() -> None:
    backlog = filled(7000, 7005, 7010, 2000, 2005, 2010, taken_ms=50)
    assert backlog.length_ns == 15 * MS  # the step after the jump confirms it
    assert backlog.shorten(LENGTH) is None
    backlog.add(message(2016))
    assert backlog.shorten(LENGTH) == LeftOut(count=6, jump=-5005 * MS)
    assert popped(backlog) == [message(2016)]


def test_jump_right_behind_what_is_left_out_is_told() -> None:
    backlog = filled(7000, 7021, 20_000, 20_001, taken_ms=50)
    assert backlog.shorten(LENGTH) == LeftOut(count=3, jump=12_980 * MS)


def test_run_begins_anew_at_a_jump() -> None:
    backlog = filled(7000, 2000, 2001, taken_ms=50)
    popped(backlog)
    for stamp in range(2002, 2050):
        backlog.add(message(stamp))
    assert backlog.shorten(LENGTH) is None


def test_stamp_of_one_bad_message_is_no_jump() -> None:
    backlog = filled(1000, 1005, 900_000, 1010, 1021, taken_ms=50)
    assert backlog.length_ns == 21 * MS
    assert backlog.shorten(LENGTH) == LeftOut(count=4, jump=0)


def test_messages_without_a_stamp_keep_their_place_and_take_no_time() -> None:
    backlog = Backlog()
    messages = [b"\0", message(1000), b"", message(1010), b"\0\1\0\0\7"]
    for data in messages:
        backlog.add(data)
    assert backlog.length_ns == 10 * MS
    assert popped(backlog) == messages


@pytest.mark.parametrize("data", [message(0), b""])
def test_messages_that_tell_no_time_are_bounded_in_number(data: bytes) -> None:
    backlog = Backlog()
    for _ in range(1000):
        backlog.add(data)
    assert backlog.shorten(LENGTH) is None
    backlog.add(data)
    assert backlog.shorten(LENGTH) == LeftOut(count=1000, jump=0)
    assert len(backlog) == 1


def test_messages_are_bounded_in_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_BYTES", 1000)
    backlog = Backlog()
    large = message(1000, rest=bytes(988))
    backlog.add(large)
    backlog.add(large)
    backlog.pop()
    assert backlog.shorten(LENGTH) is None  # 1000 bytes
    backlog.add(message(1001))
    assert backlog.shorten(LENGTH) == LeftOut(count=1, jump=0)
    assert popped(backlog) == [message(1001)]


@pytest.mark.parametrize(("cost_ms", "oldest_ms"), [(1.1, 21), (2, 21), (5, 85)])
def test_too_slow_a_node_takes_whole_runs_and_stays_close_behind(
    cost_ms: float, oldest_ms: float
) -> None:
    """Messages of 1 ms, each of which costs more than that."""
    backlog = Backlog()
    stamps: list[int] = []
    now, sent = 0.0, 0
    while now < 3000:
        while sent <= now:
            backlog.add(message(sent))
            sent += 1
        backlog.shorten(LENGTH)
        stamp = stamp_of(backlog.pop()) or 0
        stamps.append(stamp // MS)
        assert now - stamps[-1] <= oldest_ms
        now += cost_ms
    gaps = [i for i, (a, b) in enumerate(pairwise(stamps), 1) if b - a > 1]
    assert len(gaps) > 3
    for first, end in pairwise(gaps):
        assert stamps[end - 1] - stamps[first] >= 20
