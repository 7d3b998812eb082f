"""Messages between the middleware and the decoder: turns of a few milliseconds, and gaps."""

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

import rclpy
from graph import Graph
from headers import MS, message
from ros_nodes import ros_context

from emoflow_ros.node.backlog import LeftOut, stamp_of
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.estimator_node import spin_until_asked
from emoflow_ros.node.event_feed import EventFeed

LENGTH_NS = 20 * MS


class Bench:
    """A feed, whose messages take 2 ms each, and what it did."""

    def __init__(self) -> None:
        self.graph = Graph({})
        self.statistics = Statistics()
        self.now = 0.0
        self.cost_s = 0.002  # of a whole message
        self.fetch_s = 0.0
        self.parts: list[int] = []
        self.waiting: list[bytes] = []
        self.done: list[bytes | LeftOut] = []
        self.turns: list[int] = []  # length of `done` at the end of each
        self.feed = EventFeed(
            self.graph,  # type: ignore[arg-type]
            "/cam/events",
            fetch=self._fetch,
            length_ns=lambda: LENGTH_NS,
            take=self._take,
            end_turn=lambda: self.turns.append(len(self.done)),
            skip=self.done.append,
            statistics=self.statistics,
            clock=lambda: self.now,
        )
        [self.go_on] = self.graph.guards

    def _fetch(self) -> list[bytes]:
        self.now += self.fetch_s
        fetched = list(self.waiting)
        self.waiting.clear()
        return fetched

    def _take(self, data: bytes, part: int) -> None:
        self.now += self.cost_s / part
        self.done.append(data)
        self.parts.append(part)

    def run(self) -> int:
        """Do what the executor does until nothing waits; return the number of turns."""
        turns = 0
        while self.graph.triggered:
            self.graph.triggered = 0
            turns += 1
            self.go_on()
        return turns


def messages(first_ms: int, last_ms: int) -> list[bytes]:
    return [message(t) for t in range(first_ms, last_ms)]


def test_turn_ends_after_5_ms_and_the_rest_comes_in_later_ones() -> None:
    bench = Bench()
    sent = messages(0, 8)
    bench.waiting += sent[1:]
    bench.feed.receive(sent[0])
    assert bench.done == sent[:3]
    assert bench.graph.triggered == 1
    bench.graph.triggered = 0
    bench.go_on()
    assert bench.done == sent[:6]
    assert bench.run() == 1
    assert bench.done == sent
    assert bench.turns == [3, 6, 8]
    assert bench.statistics.counts["messages_skipped"] == 0


def test_message_that_comes_while_others_wait_is_taken_behind_them() -> None:
    bench = Bench()
    sent = messages(0, 8)
    bench.waiting += sent[1:4]
    bench.feed.receive(sent[0])
    bench.waiting += sent[5:]
    bench.feed.receive(sent[4])
    assert bench.done == sent[:3]  # the turn of those that wait is still to come
    assert bench.run() == 2
    assert bench.done == sent


def test_messages_beyond_the_length_are_left_out_counted_and_said() -> None:
    bench = Bench()
    for data in messages(0, 21):
        bench.feed.receive(data)
    bench.waiting += messages(22, 65)
    bench.feed.receive(message(21))
    assert bench.done == [*messages(0, 21), LeftOut(43, jump=0), message(64)]
    assert bench.statistics.counts["messages_skipped"] == 43
    assert bench.graph.log == [
        (
            "warning",
            "/cam/events: 43 messages are left out, because events come faster than the node "
            "decodes them; lower the event rate of the camera or the rate of the replay, or give "
            "the node more of the processor",
        )
    ]


def far_behind() -> Bench:
    """More than half of what may wait has waited for 60 ms."""
    bench = Bench()
    bench.feed.receive(message(0))
    bench.waiting += messages(2, 17)
    bench.cost_s = 0.06  # of the first one
    bench.feed.receive(message(1))
    bench.cost_s = 0.002
    bench.run()
    return bench


def test_messages_that_are_far_behind_are_taken_in_part_and_counted() -> None:
    bench = far_behind()
    assert bench.done == messages(0, 17)
    assert bench.parts == [1] * 2 + [2] * 15
    assert bench.statistics.counts["messages_in_part"] == 15


def test_messages_of_more_than_6_ms_and_those_without_a_stamp_are_taken_whole() -> None:
    bench = far_behind()
    for data in (message(18), message(25), b"", message(31)):
        bench.feed.receive(data)
    assert bench.parts[17:] == [2, 1, 1, 2]


def test_node_that_is_too_slow_for_whole_messages_takes_parts_and_stays_close_behind() -> None:
    """Messages of 1 ms, each of which costs 3 ms and a quarter of it 0.75 ms."""
    bench = Bench()
    bench.cost_s = 0.003
    sent = 0
    behind_ms = []
    while bench.now < 10:
        while sent <= bench.now * 1000:
            bench.waiting.append(message(sent))
            sent += 1
        if not bench.waiting and not bench.graph.triggered:
            bench.now += 0.001
            continue
        if not bench.graph.triggered:
            bench.feed.receive(bench.waiting.pop(0))
        else:
            bench.graph.triggered = 0
            bench.go_on()
        taken = [data for data in bench.done if isinstance(data, bytes)]
        behind_ms.append(sent - 1 - (stamp_of(taken[-1]) or 0) // MS)
    settled = bench.parts[len(bench.parts) // 2 :]
    assert set(settled) == {2, 4}  # half of a message is tried again from time to time
    assert settled.count(4) > 0.8 * len(settled)
    later = behind_ms[len(behind_ms) // 2 :]
    assert max(later) <= 62  # three times the length that may wait
    assert float(np.median(later)) <= 6
    skipped = bench.statistics.counts["messages_skipped"]
    assert skipped < 0.05 * sent


def test_node_decodes_for_as_long_as_it_fetches() -> None:
    bench = Bench()
    bench.fetch_s = 0.02
    sent = messages(0, 16)
    bench.waiting += sent[1:]
    bench.feed.receive(sent[0])
    assert bench.done == sent[:10]  # of 2 ms each


def test_jump_among_what_is_left_out_is_told() -> None:
    bench = Bench()
    for data in messages(5000, 5021):
        bench.feed.receive(data)
    bench.waiting += messages(1000, 1040)
    bench.feed.receive(message(5021))
    assert bench.done[21:] == [LeftOut(40, jump=(1001 - 5021) * MS), message(1039)]


def test_what_waits_in_the_middleware_counts_in_every_turn() -> None:
    bench = Bench()
    for data in messages(0, 18):
        bench.feed.receive(data)
    bench.waiting += messages(19, 24)
    bench.feed.receive(message(18))
    assert bench.done == messages(0, 21)
    bench.waiting += messages(24, 60)
    assert bench.run() == 1
    assert bench.done == [*messages(0, 21), LeftOut(38, jump=0), message(59)]


def test_nothing_is_taken_after_the_end() -> None:
    bench = Bench()
    bench.waiting += messages(1, 8)
    bench.feed.receive(message(0))
    bench.feed.close()
    assert bench.graph.guards == []
    bench.waiting += messages(8, 9)
    bench.go_on()
    assert bench.done == messages(0, 3)
    assert len(bench.waiting) == 1


def test_executor_publishes_results_between_the_turns_and_comes_back() -> None:
    sent = messages(0, 4)
    waiting = sent[1:]
    done: list[bytes | str] = []
    asks: list[Callable[[], None]] = []
    with ros_context() as context:
        node = rclpy.create_node("feeding", context=context)
        results = node.create_guard_condition(lambda: done.append("result"))

        def fetch() -> list[bytes]:
            fetched = list(waiting)
            waiting.clear()
            return fetched

        def take(data: bytes, part: int) -> None:
            assert part == 1
            done.append(data)
            results.trigger()
            if data == sent[-1]:
                asks[0]()
            time.sleep(0.006)  # longer than a turn

        feed = EventFeed(
            node,
            "/cam/events",
            fetch=fetch,
            length_ns=lambda: LENGTH_NS,
            take=take,
            end_turn=lambda: None,
            skip=pytest.fail,
            statistics=Statistics(),
        )
        feed.receive(sent[0])
        spin_until_asked(node, asks.append)
        guards = len(list(node.guards))
        feed.close()
        assert len(list(node.guards)) == guards - 1
    for before, behind in pairwise(sent):
        assert "result" in done[done.index(before) : done.index(behind)]
