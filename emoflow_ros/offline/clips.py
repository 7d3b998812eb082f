"""Windows that hold other events than the interval that they are compared over."""

from dataclasses import dataclass, field

from emoflow_ros.core.windows import Window


@dataclass(frozen=True, slots=True)
class Clip(Window):
    """A window whose estimate is compared over an interval inside it.

    Attributes:
        compared: the interval with all of its events, of which the window may hold more or fewer.
    """

    compared: Window = field(kw_only=True)

    def since(self, t: int) -> Window:
        """Return the part from time t (ns) on, at the least the interval that is compared."""
        return Window.since(self, min(t, self.compared.t_start))


def compared_part(window: Window) -> Window:
    """Return the interval that a window's estimate is compared over, with its events."""
    return window.compared if isinstance(window, Clip) else window
