import threading
import time

from emoflow_ros.node.tasks import DropOldestQueue


def test_full_queue_drops_the_oldest_and_counts() -> None:
    queue = DropOldestQueue[int](3)
    assert [queue.put([item]) for item in range(5)] == [[], [], [], [0], [1]]
    assert queue.dropped == 2
    assert [queue.get(0) for _ in range(4)] == [2, 3, 4, None]


def test_items_that_come_together_are_all_kept_and_push_out_what_came_before() -> None:
    queue = DropOldestQueue[int](1)
    assert queue.put([0]) == []
    assert queue.put([1, 2, 3]) == [0]
    assert queue.get(0) == 1
    assert queue.put([4]) == [2, 3]
    assert queue.put([]) == []
    assert [queue.get(0), queue.get(0)] == [4, None]
    assert queue.dropped == 3


def test_clear_tells_how_many_it_forgets_and_counts_none_as_dropped() -> None:
    queue = DropOldestQueue[int](3)
    queue.put([1, 2])
    assert queue.clear() == 2
    assert queue.get(0) is None
    assert queue.dropped == 0


def test_get_returns_as_soon_as_an_item_comes() -> None:
    queue = DropOldestQueue[str](1)
    threading.Timer(0.05, queue.put, [["late"]]).start()
    started = time.monotonic()
    assert queue.get(600.0) == "late"
    assert time.monotonic() - started < 300.0
