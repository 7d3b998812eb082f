"""Pictures are dropped before windows are."""

from typing import Any

import numpy as np
import pytest
from fake_clock import Clock

from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.node.picture_budget import PictureBudget
from emoflow_ros.node.tasks import Picture, Result, Task

STRIDE_S = 0.0675
ALL = tuple(Picture)


class Worker:
    """One worker and windows at their rate, in simulated time; one window may wait.

    Args:
        estimate_s: time for a window.
        costs: of the pictures, s.
    """

    def __init__(self, estimate_s: float, costs: dict[str, float]) -> None:
        self.clock = Clock()
        self.budget = PictureBudget(self.clock)
        self.estimate_s = estimate_s
        self.costs = costs
        self.drawn: list[tuple[str, ...]] = []
        self.waits: list[float] = []
        self.dropped = 0

    def run(self, windows: int) -> None:
        first = received = self.clock.now
        for number in range(windows):
            received = first + number * STRIDE_S
            if self.clock.now > received + STRIDE_S:  # the next one has replaced it
                self.dropped += 1
                continue
            self.clock.now = max(self.clock.now, received)
            self.waits.append(self.clock.now - received)
            chosen = self.budget.choose(ALL, received, STRIDE_S)
            costs = {name: self.costs[name] for name in chosen}
            self.clock.now += self.estimate_s + sum(costs.values())
            self.budget.note(result(self.estimate_s), costs)
            self.drawn.append(chosen)

    def count(self, picture: str, of: int) -> int:
        return sum(picture in chosen for chosen in self.drawn[-of:])


def result(wall_s: float) -> Result:
    window = Window(0, 1, Events.empty())
    estimate: Any = Estimate(0, 1, 0, Status.OK, Quality(events=1), linear=np.zeros(3))
    return Result(Task(window, 0, 0, "", 0.0), estimate, wall_s=wall_s)


def costs(image: float, color: float, events: float, tracks: float) -> dict[str, float]:
    return dict(zip(ALL, (image, color, events, tracks), strict=True))


def test_pictures_that_fit_are_all_drawn() -> None:
    worker = Worker(0.013, costs(0.001, 0.012, 0.010, 0.002))
    worker.run(200)
    assert worker.drawn == [ALL] * 200
    assert max(worker.waits) == pytest.approx(0, abs=1e-9)


def test_costly_pictures_take_turns_and_cost_no_window() -> None:
    """As those of 1280x720."""
    worker = Worker(0.025, costs(0.002, 0.080, 0.075, 0.003))
    worker.run(10)
    worker.dropped = 0
    worker.waits.clear()
    worker.run(300)
    assert worker.dropped == 0
    assert max(worker.waits) < 0.06
    assert worker.count("flow/image", 300) == worker.count("flow/tracks", 300) == 300
    for picture in ("flow/color", "flow/iwe"):
        assert 50 < worker.count(picture, 300) < 90


def test_no_costly_picture_is_drawn_for_a_window_that_has_waited() -> None:
    worker = Worker(0.080, costs(0.0001, 0.050, 0.050, 0.0001))
    worker.run(20)
    worker.drawn.clear()
    worker.run(100)
    assert worker.count("flow/color", 100) + worker.count("flow/iwe", 100) < 10


def test_a_picture_that_nobody_wants_any_more_is_not_drawn() -> None:
    budget = PictureBudget(Clock())
    assert budget.choose(("flow/iwe",), 100.0, STRIDE_S) == ("flow/iwe",)
    assert budget.choose((), 100.0, STRIDE_S) == ()
