"""The scale of the linear velocity: from nowhere, a parameter or a topic."""

from dataclasses import dataclass

from rclpy.node import Node

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.node.settings import ScaleOptions
from emoflow_ros.node.speed_input import SpeedInput


@dataclass(frozen=True)
class Scaling:
    """The scale of one window.

    Attributes:
        factor: of the unit direction: a speed in m/s, or 1.
        source: where it comes from, as `scale.source` names it.
        problem: why it is not what was asked for; empty if it is.
    """

    factor: float = 1.0
    source: str = "none"
    problem: str = ""


class Scale:
    """Knows the scale at the time of a window.

    Args:
        node: listens to the topic, if there is one.
        options: where the scale comes from.
    """

    def __init__(self, node: Node, options: ScaleOptions) -> None:
        self._node = node
        self._options = options
        self._input: SpeedInput | None = None
        self.set_options(options)

    def set_options(self, options: ScaleOptions) -> None:
        """Take the scale from somewhere else from now on."""
        topic = options.topic if options.source == "topic" else None
        if self._input is not None and self._input.topic != topic:
            self.close()
        if self._input is None and topic is not None:
            self._input = SpeedInput(self._node, topic)
        self._options = options

    def at(self, stamp: int) -> Scaling:
        """Return the scale at this ROS time (ns): none where the topic's speed is too old."""
        options = self._options
        if options.source == "parameter":
            return Scaling(options.speed, "parameter")
        if self._input is None:
            return Scaling()
        speed = self._input.log.at(stamp, round(options.max_age_s * NS_PER_S))
        if speed is None:
            reason = self._input.problem or (
                f"no speed on {self._input.topic} within {options.max_age_s:g} s of the window"
            )
            return Scaling(problem=f"{reason}; linear is a unit direction")
        return Scaling(speed, "topic")

    def close(self) -> None:
        """Stop listening."""
        if self._input is not None:
            self._input.close()
            self._input = None
