"""Queue between the stream and the worker: bounded, and full means the oldest goes."""

import threading
from collections import deque


class DropOldestQueue[T]:
    """Hand items from one thread to another without ever blocking the one that puts.

    Args:
        capacity: items kept; one more drops the oldest.
    """

    def __init__(self, capacity: int) -> None:
        self._items: deque[T] = deque(maxlen=capacity)
        self._changed = threading.Condition()
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> None:
        """Append an item; `dropped` counts what had to make room for it."""
        with self._changed:
            self.dropped += len(self._items) == self._items.maxlen
            self._items.append(item)
            self._changed.notify()

    def get(self, timeout: float) -> T | None:
        """Remove the oldest item, or return None when none came within `timeout` seconds."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._items, timeout):
                return None
            return self._items.popleft()

    def clear(self) -> None:
        """Forget all items; they do not count as dropped."""
        with self._changed:
            self._items.clear()
