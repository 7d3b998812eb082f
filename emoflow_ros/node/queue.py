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

    def put(self, item: T) -> T | None:
        """Append an item; return, and count as `dropped`, the one that had to make room."""
        with self._changed:
            full = len(self._items) == self._items.maxlen
            oldest = self._items.popleft() if full else None
            self.dropped += full
            self._items.append(item)
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
