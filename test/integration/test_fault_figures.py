"""The figures of a run of random faults, and the events that it is made with."""

import numpy as np
from fault_figures import Figures, Use
from harness import CAMERA, MS
from moving_dots import MovingDots

TABLE = """\
100 s, load 2.5; 12 windows, each accounted for once: 10 ok, 2 dropped.

| fault | times | right again after, ms: median, 95 %, longest | over 500 ms |
|---|---|---|---|
| kill worker | 3 | 200, 650, 700 | 1 |
| pause | 1 | 100, 100, 100 | 0 |
| all | 4 | 150, 625, 700 | 1 |

| memory, MB | first quarter | last quarter | most |
|---|---|---|---|
| node | 101 | 113 | 114 |
| worker | 199 | 187 | 200 |"""


def test_table_holds_times_by_fault_and_memory_by_quarter() -> None:
    figures = Figures()
    figures.right_again["pause"] = [0.1]
    figures.right_again["kill_worker"] = [0.2, 0.1, 0.7]
    figures.uses = [Use(9, 30, 2, 3, 100.0 + 2 * k, 200.0 - 2 * k) for k in range(8)]
    assert figures.quarters("node_mb") == (101, 113)
    assert figures.table(100.0, 2.5, {"ok": 10, "dropped": 2, "failed": 0}) == TABLE


def test_dots_enter_columns_in_the_order_of_time_however_the_stream_is_cut() -> None:
    start = 10_000_000 * MS + 300
    dots = MovingDots()
    parts = [dots.events(CAMERA, start, start + k * 5 * MS, 5 * MS) for k in range(40)]
    for k, part in enumerate(parts):
        assert int(part.t[0]) == start + k * 5 * MS
        assert int(part.t[-1]) < start + (k + 1) * 5 * MS
        assert (np.diff(part.t) >= 0).all()
        assert part.x.max() < CAMERA.width
        assert part.y.max() < CAMERA.height
    # 400 dots enter 100 columns a second.
    assert sum(len(part) - 1 for part in parts) == 400 * 100 // 5
