"""Queue between the stream and the worker: bounded, and full means the oldest goes."""

import threading
from collections import deque
from collections.abc import Sequence


class DropOldestQueue[T]:
    """Hand items from one thread to another without ever blocking the one that puts.

    Args:
        capacity: items kept; one more drops the oldest. Items that come together are all kept.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, items: Sequence[T]) -> list[T]:
        """Append items; return, and count as `dropped`, those that had to make room."""
        with self._changed:
            self._items.extend(items)
            excess = len(self._items) - max(self._capacity, len(items))
            oldest = [self._items.popleft() for _ in range(excess)]
            self.dropped += len(oldest)
            self._changed.notify()
        return oldest

    def get(self, timeout: float) -> T | None:
        """Remove the oldest item, or return None when none came within `timeout` seconds."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._items, timeout):
                return None
            return self._items.popleft()

    def clear(self) -> int:
        """Forget all items, which do not count as dropped, and return how many they were."""
        with self._changed:
            count = len(self._items)
            self._items.clear()
        return count
