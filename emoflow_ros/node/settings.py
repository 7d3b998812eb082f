"""All parameters as typed options with unit, range and meaning.

The node's own options are here, those of the estimation in `config`; `Settings` holds both.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name

from emoflow_ros.config import Config
from emoflow_ros.core.products.output_bounds import OutputBounds
from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import (
    NS_PER_S,
    SLICE_BIN_NS,
    SLICE_EVENTS,
    SLICE_MS,
    WindowPolicy,
)
from emoflow_ros.core.types.options import (
    OptionInfo,
    option,
    options_of,
    replace_options,
    unknown_option,
)
from emoflow_ros.errors import InputError
from emoflow_ros.node.linear_covariance import REP_145, WIDE
from msg_adapters import supported_types


@dataclass(frozen=True)
class InputOptions:
    """What the node listens to."""

    type: str = option(
        "", "message type of the topic `events`; empty takes the type that is published"
    )
    timestamps: str = option(
        "fused",
        "time of the output: the events' own times mapped to ROS time with their drift tracked "
        "(fused), mapped by each message's stamp (header), or unchanged (sensor)",
        choices=tuple(Timestamps),
    )
    queue_windows: int = option(
        1,
        "windows that may wait for the worker; when one more comes, the oldest is dropped; windows "
        "that one message completes are all kept; messages may wait for the decoder as long, and "
        "for one window more; a larger number estimates more windows, but later",
        minimum=1,
        maximum=100,
    )
    silence_s: float = option(
        2.0,
        "without events for this long the diagnostics warn",
        unit="s",
        minimum=0.1,
        maximum=3600.0,
    )

    def __post_init__(self) -> None:
        if self.type and self.type not in supported_types():
            raise InputError(
                "input.type",
                f"there is no decoder for messages of type '{self.type}'",
                f"use one of {', '.join(supported_types())}",
            )


@dataclass(frozen=True)
class CameraOptions:
    """Which camera the events come from."""

    calibration_file: str = option(
        "",
        "camera_info YAML, Kalibr camchain, OpenCV YAML or ECD calib.txt, as a path, file:// or "
        "package:// URL; empty listens to "
        "the topic `camera_info`",
    )
    frame_id: str = option(
        "", "optical frame of the camera; empty takes the frame of the event messages"
    )


@dataclass(frozen=True)
class OutputOptions:
    """What the node publishes, and how."""

    timeout_s: float = option(
        10.0,
        "a worker without an answer after this long is replaced, the window is lost",
        unit="s",
        minimum=0.1,
        maximum=600.0,
    )
    diagnostics_s: float = option(
        1.0, "time between two diagnostics", unit="s", minimum=0.1, maximum=60.0
    )
    flow_color_max: float = option(
        0.0,
        "flow that `flow/color` shows in full colour, longer flow is darkened; 0 takes the 99th "
        "percentile of each picture",
        unit="px/s",
        minimum=0.0,
        maximum=1e6,
    )
    flow_stride: int = option(
        1,
        "every so many-th pixel of every so many-th row is published on `flow/image`; 2 makes its "
        "messages a quarter as large",
        minimum=1,
        maximum=64,
    )
    twist_rate: float = option(
        60.0,
        "twists per second on `egomotion/twist`, each of the newest event; 0 gives one per window, "
        "at its middle",
        unit="Hz",
        minimum=0.0,
        maximum=1000.0,
    )
    tracks: int = option(
        150, "points that `flow/tracks` follows, spread over the image", minimum=1, maximum=2000
    )
    linear_covariance: str = option(
        WIDE,
        "covariance of linear where nothing is known of it: a variance of 1e6 (m/s)^2, also along "
        "a direction without a scale, whose length is no speed (wide), or covariance[0] -1 and 0 "
        "elsewhere (rep145)",
        choices=(WIDE, REP_145),
    )
    max_angular_sd: float = option(
        0.0,
        "a twist whose angular velocity has a larger standard deviation is held back; 0: none",
        unit="deg/s",
        minimum=0.0,
        maximum=1e5,
    )
    max_direction_sd: float = option(
        0.0,
        "a direction with a larger standard deviation is held back: linear is zero, as where it is "
        "not observable; 0 holds none back",
        unit="deg",
        minimum=0.0,
        maximum=180.0,
    )
    target_frame: str = option(
        "", "frame that twists are expressed in; empty is the camera's optical frame"
    )
    target_source: str = option(
        "tf",
        "rotation from the optical frame into output.target_frame: that of tf at the stamp, or "
        "the parameters output.target_roll, output.target_pitch and output.target_yaw",
        choices=("tf", "parameter"),
    )
    target_roll: float = option(
        0.0,
        "orientation of the optical frame in output.target_frame: roll about its x axis, first, "
        "as in URDF",
        unit="rad",
        minimum=-math.tau,
        maximum=math.tau,
    )
    target_pitch: float = option(
        0.0, "then pitch about its y axis", unit="rad", minimum=-math.tau, maximum=math.tau
    )
    target_yaw: float = option(
        0.0, "then yaw about its z axis", unit="rad", minimum=-math.tau, maximum=math.tau
    )

    @property
    def bounds(self) -> OutputBounds:
        """How wide a twist may be that is published."""
        return OutputBounds(math.radians(self.max_angular_sd), math.radians(self.max_direction_sd))


@dataclass(frozen=True)
class ScaleOptions:
    """The speed of the camera, which its events do not show."""

    source: str = option(
        "none",
        "scale of the linear velocity: none gives a unit direction, parameter multiplies it by "
        "scale.speed, topic by the speed on scale.topic",
        choices=("none", "parameter", "topic"),
    )
    speed: float = option(
        1.0,
        "speed of the camera, taken as exact, if scale.source is parameter",
        unit="m/s",
        minimum=0.0,
        maximum=1000.0,
    )
    topic: str = option(
        "odom",
        "topic of the camera's speed if scale.source is topic: nav_msgs/Odometry, "
        "geometry_msgs/TwistStamped or std_msgs/Float64, found from the graph",
    )
    max_age_s: float = option(
        0.5,
        "a window further than this from every speed on scale.topic gives a unit direction",
        unit="s",
        minimum=0.001,
        maximum=60.0,
    )

    def __post_init__(self) -> None:
        try:
            validate_full_topic_name(expand_topic_name(self.topic, "node", "/"))
        except (InvalidTopicNameException, ValueError):
            raise InputError(
                "scale.topic", f"'{self.topic}' is not the name of a topic", "correct the name"
            ) from None


@dataclass(frozen=True)
class NodeOptions:
    """Options of the node itself; those of the estimation are in `Config`."""

    autostart: bool = option(True, "configure and activate the node without being asked")
    on_missing_device: str = option(
        "cpu",
        "profiles paper*, where estimator.device is cuda and CUDA is missing or lost: estimate on "
        "the CPU, or refuse to configure and, when lost, try again",
        choices=("cpu", "refuse"),
    )
    worker_nice: int = option(
        0,
        "how much lower the worker's priority is than the node's (nice): above 0 the node keeps "
        "reading the newest events on a busy machine, and fewer windows are estimated",
        minimum=0,
        maximum=19,
    )
    input: InputOptions = field(default_factory=InputOptions)
    camera: CameraOptions = field(default_factory=CameraOptions)
    output: OutputOptions = field(default_factory=OutputOptions)
    scale: ScaleOptions = field(default_factory=ScaleOptions)


@dataclass(frozen=True)
class Settings:
    """The values of all parameters."""

    node: NodeOptions
    config: Config

    @property
    def budget(self) -> EventBudget:
        """How windows are cut, and how many events they may hold."""
        return self.config.event_budget

    @property
    def slices(self) -> EventBudget | None:
        """How slices of the newest events are cut for the latest twist; None if not wanted."""
        rate = self.node.output.twist_rate
        if rate == 0 or self.config.method != "lattice":
            return None
        policy = WindowPolicy(duration_ms=SLICE_MS, stride_ms=1e3 / rate)
        return EventBudget(policy, SLICE_EVENTS, SLICE_BIN_NS)

    @property
    def backlog_ns(self) -> int:
        """Event time that messages may cover while they wait to be decoded, ns.

        It is that of a window, or of a slice if that is longer, and of the windows that may wait.
        A window by count may cover any time: a second is taken for each.
        """
        window, slices = self.config.window, self.slices
        waiting = self.node.input.queue_windows
        if window.count:
            return (1 + waiting) * NS_PER_S
        slice_ns = slices.policy.duration_ns if slices else 0
        return max(window.duration_ns, slice_ns) + waiting * window.stride_ns

    def changed(self, values: Mapping[str, Any]) -> "Settings":
        """Return a copy with the parameters of these names changed.

        Raises:
            InputError: an unknown name, or a value of the wrong type or range.
        """
        own = [o.name for o in options_of(self.node)]
        config = [o.name for o in options_of(self.config)]
        if unknown := [n for n in values if n not in own and n not in config]:
            raise unknown_option(unknown[0], [*own, *config])
        return Settings(
            replace_options(self.node, {n: v for n, v in values.items() if n in own}),
            replace_options(self.config, {n: v for n, v in values.items() if n not in own}),
        )


def table(settings: Settings) -> Iterable[OptionInfo]:
    """List all parameters."""
    yield from options_of(settings.node)
    yield from options_of(settings.config)
