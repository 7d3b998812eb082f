"""How much of each message is decoded, by how much waits."""

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.node.event_feed import Pressure


class Turns:
    """Turns, 10 ms one after another."""

    def __init__(self) -> None:
        self.now = 0.0
        self.pressure = Pressure(lambda: self.now)

    def note(self, seconds: float, share: float) -> list[int]:
        """Let so much time pass, and return each part that was asked for since."""
        parts = []
        for _ in range(round(seconds * 100)):
            self.now = round(self.now + 0.01, 2)
            self.pressure.note(share)
            parts.append(self.pressure.part)
        return list(dict.fromkeys(parts))


def test_parts_become_smaller_while_more_than_half_of_what_may_wait_does() -> None:
    turns = Turns()
    assert turns.note(10, 0.5) == [1]
    assert turns.note(0.03, 0.51) == [1]
    assert turns.note(0.04, 0.51) == [1, 2]
    assert turns.note(2, 0.51) == [2, 4, 8, 16]


def test_parts_become_smaller_until_little_waits() -> None:
    turns = Turns()
    turns.note(1, 0.0)
    assert turns.note(0.08, 0.6) == [1, 2]
    assert turns.note(0.06, 0.13) == [2, 4]
    assert turns.note(1, 0.12) == [4]


def test_second_loss_within_3_s_makes_parts_smaller() -> None:
    turns = Turns()
    turns.pressure.note_loss()
    turns.note(3.1, 0.0)
    turns.pressure.note_loss()
    assert turns.note(0.1, 0.0) == [1]
    turns.pressure.note_loss()
    assert turns.note(0.1, 0.0) == [2]


def test_bursts_that_are_soon_done_are_taken_whole() -> None:
    turns = Turns()
    for _ in range(20):
        assert turns.note(0.04, 1.0) == [1]
        assert turns.note(0.01, 0.0) == [1]


def test_parts_become_larger_again_after_3_s() -> None:
    turns = Turns()
    turns.note(0.15, 1.0)
    assert turns.pressure.part == 4
    assert turns.note(2.9, 0.0) == [4]
    assert turns.note(0.2, 0.0) == [4, 2]
    assert turns.note(2.7, 0.0) == [2]
    assert turns.note(4, 0.0) == [2, 1]
