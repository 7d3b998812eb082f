from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_estimators import Recorder
from fake_node import FakeNode, install_fake_tf

from emoflow_ros.config import Config, load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import MotionModel, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.core.types.twist import PresentTwist, Twist
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.outputs import Outputs
from emoflow_ros.node.reports import Level
from emoflow_ros.node.settings import NodeOptions, ScaleOptions, Settings
from emoflow_ros.node.tasks import Picture, Present, Result, Task
from emoflow_ros.node.twist_output import to_header

MS = 1_000_000
CAMERA = Camera(8, 6, 5.0, 5.0, 4.0, 3.0)
HEADER = to_header(1_500_000_000_123_456_789, "camera")
# The optical frame in a body with x forward, y left and z up, as URDFs have it.
BODY = {
    "output.target_frame": "base",
    "output.target_source": "parameter",
    "output.target_roll": -np.pi / 2,
    "output.target_yaw": -np.pi / 2,
}


def options(**values: Any) -> NodeOptions:
    given = {name.replace("__", "."): value for name, value in values.items()}
    return Settings(NodeOptions(), load_config()).changed(given).node


class Bench:
    """Outputs of a node without DDS."""

    def __init__(self, **values: Any) -> None:
        self.node = FakeNode()
        self.statistics = Statistics()
        self.made = ExitStack()
        present = bool(values.pop("present", False))
        self.outputs = Outputs(
            self.node, options(**values), self.statistics, self.made, present=present
        )

    def publish(self, start_ms: int = 1000, **changes: Any) -> None:
        self.outputs.publish(result(start_ms, **changes))

    def last(self, topic: str) -> Any:
        return self.node.messages(f"egomotion/{topic}")[-1]

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        last = self.last("status")
        return last.level, last.message, {v.key: v.value for v in last.values}


@pytest.fixture
def bench() -> Callable[..., Bench]:
    return Bench


def result(start_ms: int = 1000, pictures: Any = None, **changes: Any) -> Result:
    """Directions (0, 0.6, 0.8) and an angular velocity of (4, 1, 8)."""
    events = Events(*(np.zeros(4, np.uint16),) * 2, np.arange(4), np.ones(4, bool))
    window = Window(start_ms * MS, (start_ms + 10) * MS, events)
    estimate = replace(Recorder(CAMERA, Config()).estimate(window), **changes)
    task = Task(window, 0, 0, "optical", 0.0)
    return Result(task, estimate, pictures or {})


WIDE_NOW = PresentTwist(Twist(1, np.array([0.0, 0.6, 0.8]), np.array([4.0, 1.0, 8.0])), np.eye(6))


def vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def test_twists_are_in_the_target_frame_and_pictures_are_not(bench: Callable[..., Bench]) -> None:
    body = {name.replace(".", "__"): value for name, value in BODY.items()}
    b = bench(**body, output__linear_covariance="rep145")
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    b.publish(covariance=covariance, pictures={Picture.FLOW: np.zeros((6, 8, 2), np.float32)})
    for topic in ("twist", "twist_with_covariance"):
        message = b.last(topic)
        assert message.header.frame_id == "base"
        twist = message.twist if topic == "twist" else message.twist.twist
        np.testing.assert_allclose(vector(twist.linear), [0.8, 0.0, -0.6], atol=1e-12)
        np.testing.assert_allclose(vector(twist.angular), [8.0, -4.0, -1.0], atol=1e-12)
    found = np.reshape(b.last("twist_with_covariance").twist.covariance, (6, 6))
    np.testing.assert_allclose(found, np.diag([3.0, 1.0, 2.0, 6.0, 4.0, 5.0]), atol=1e-12)
    assert b.node.messages("flow/image")[-1].header.frame_id == "optical"


def test_unobservable_translation_stays_marked_when_scaled_and_rotated(
    bench: Callable[..., Bench],
) -> None:
    b = bench(
        scale__source="parameter",
        scale__speed=3.0,
        output__linear_covariance="rep145",
        **{name.replace(".", "__"): value for name, value in BODY.items()},
    )
    covariance = np.diag([-1.0, 0.0, 0.0, 4.0, 5.0, 6.0])
    b.publish(covariance=covariance, linear=np.zeros(3), model=MotionModel.ROTATION)
    message = b.last("twist_with_covariance")
    assert vector(message.twist.twist.linear) == [0.0, 0.0, 0.0]
    found = np.reshape(message.twist.covariance, (6, 6))
    np.testing.assert_allclose(found, np.diag([-1.0, 0, 0, 6.0, 4.0, 5.0]), atol=1e-12)
    assert b.status()[1] == "ok, translation not observable, wide: start"


def test_covariance_is_wide_along_a_direction_without_a_scale(bench: Callable[..., Bench]) -> None:
    b = bench(**{name.replace(".", "__"): value for name, value in BODY.items()})
    for scale in ("none", "parameter"):
        b.outputs.set_scale(ScaleOptions(source=scale, speed=2.0))
        b.publish(1000 if scale == "none" else 1010, covariance=np.diag([1.0, 2, 3, 4, 5, 6]))
        twist = b.last("twist_with_covariance").twist
        found = np.reshape(twist.covariance, (6, 6))[:3, :3]
        linear = np.array(vector(twist.twist.linear))
        if scale == "none":
            np.testing.assert_allclose(linear @ found @ linear, 1e6, rtol=1e-5)
            found -= 1e6 * np.outer(linear, linear)
        np.testing.assert_allclose(found, np.diag([3.0, 1, 2]) * (linear @ linear), atol=1e-8)
    b.publish(1020, covariance=np.diag([-1.0, 0, 0, 4, 5, 6]), linear=np.zeros(3))
    found = np.reshape(b.last("twist_with_covariance").twist.covariance, (6, 6))
    np.testing.assert_allclose(found, np.diag([1e6, 1e6, 1e6, 6, 4, 5]), atol=1e-8)


def test_status_tells_the_scale_that_was_applied(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.publish()
    assert b.status()[2]["scale"] == "none"
    b.outputs.set_scale(ScaleOptions(source="parameter", speed=5.0))
    b.publish(1010)
    assert b.status()[2]["scale"] == "parameter"
    assert vector(b.last("twist").twist.linear) == [0.0, 3.0, 4.0]


def test_status_carries_observability_quality_and_lag(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.node.now = 1300 * MS
    b.publish()
    level, message, values = b.status()
    assert (level, message) == (b"\x00", "ok, wide: start")
    assert values["lag_ms"] == "295.0"
    assert values["translation_observable"] == "true"
    assert {"contrast_gain", "residual_px", "inlier_fraction", "iterations"} <= set(values)


def test_window_without_an_estimate_publishes_its_status_only(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.publish(status=Status.NO_MOTION)
    assert b.status()[0] == b"\x01"
    counts = {topic: len(p.messages) for topic, p in b.node.publishers.items()}
    assert sum(counts.values()) == counts["egomotion/status"] == 1


def test_twists_never_go_back(bench: Callable[..., Bench]) -> None:
    b = bench()
    for start_ms in (1000, 990, 1010):
        b.publish(start_ms)
    stamps = [m.header.stamp.nanosec for m in b.node.messages("egomotion/twist")]
    assert stamps == [5 * MS, 15 * MS]


def present(t_ms: int) -> Present:
    task = Task(Window(0, t_ms * MS, Events.empty()), 0, 5, "optical", 0.0, is_slice=True)
    twist = Twist(t_ms * MS, np.array([0.0, 0.6, 0.8]), np.array([4.0, 1.0, 8.0]))
    return Present(task, PresentTwist(twist, np.eye(6)))


def test_twists_of_now_have_their_own_covariance_and_never_go_back(
    bench: Callable[..., Bench],
) -> None:
    b = bench(present=True, scale__source="parameter", scale__speed=2.0)
    for t_ms in (100, 120, 110, 130):
        b.outputs.publish_present(present(t_ms))
    stamps = [m.header.stamp.nanosec for m in b.node.messages("egomotion/twist")]
    assert stamps == [100 * MS + 5, 120 * MS + 5, 130 * MS + 5]
    now = b.node.messages("egomotion/twist_now")
    assert [m.header.stamp.nanosec for m in now] == stamps
    assert now[-1].twist.twist == b.last("twist").twist
    assert vector(now[-1].twist.twist.linear) == [0.0, 1.2, 1.6]
    np.testing.assert_array_equal(now[-1].twist.covariance, np.diag([4, 4, 4, 1, 1, 1]).ravel())
    b.publish()
    assert len(b.node.messages("egomotion/twist")) == 3
    assert len(b.node.messages("egomotion/twist_with_covariance")) == 1


def test_twists_are_withheld_without_a_transform(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    tf = install_fake_tf(monkeypatch)
    b = bench(output__target_frame="base")
    b.publish(pictures={Picture.FLOW: np.zeros((6, 8, 2), np.float32)})
    assert b.node.messages("egomotion/twist") == []
    assert b.node.messages("egomotion/twist_with_covariance") == []
    assert len(b.node.messages("flow/image")) == 1
    reason = "no transform from optical to base: not yet; no twist is published"
    assert b.status()[:2] == (b"\x01", f"ok, wide: start; {reason}")
    assert b.statistics.problems == {"frame": (Level.WARN, reason)}
    tf.known = True
    b.publish(1010)
    assert b.last("twist").header.frame_id == "base"
    assert b.statistics.problems == {}
    b.made.close()
    assert b.node.publishers == {}
    assert tf.listening == 0


def test_a_twist_that_is_wider_than_the_user_wants_is_held_back(
    bench: Callable[..., Bench],
) -> None:
    b = bench(present=True, output__max_angular_sd=10.0, output__max_direction_sd=20.0)
    degree = np.radians(1.0) ** 2
    narrow = np.diag([300.0, 300.0, 0.0, 90.0, 90.0, 90.0]) * degree
    b.publish(covariance=narrow)
    assert b.status()[:2] == (b"\x00", "ok, wide: start")
    wide = np.diag([300.0, 300.0, 0.0, 90.0, 90.0, 110.0]) * degree
    b.publish(1010, covariance=wide)
    b.outputs.publish_present(replace(present(100), found=replace(WIDE_NOW, covariance=wide)))
    assert b.status()[:2] == (
        b"\x00",
        "ok, wide: start; held back: wider than output.max_angular_sd",
    )
    assert len(b.node.messages("egomotion/twist_with_covariance")) == 1
    assert b.node.messages("egomotion/twist_now") == []
    vague = np.diag([300.0, 500.0, 0.0, 90.0, 90.0, 90.0]) * degree
    b.publish(1020, covariance=vague)
    b.outputs.publish_present(replace(present(130), found=replace(WIDE_NOW, covariance=vague)))
    assert (
        b.status()[1] == "ok, wide: start; direction held back: wider than output.max_direction_sd"
    )
    for topic in ("twist_with_covariance", "twist_now"):
        twist = b.last(topic).twist
        assert vector(twist.twist.linear) == [0.0, 0.0, 0.0]
        assert vector(twist.twist.angular) == [4.0, 1.0, 8.0]
        np.testing.assert_allclose(np.diag(np.reshape(twist.covariance, (6, 6)))[:3], 1e6)


def test_only_twists_that_are_published_count_as_given(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    tf = install_fake_tf(monkeypatch)
    b = bench(present=True, output__target_frame="base")
    given: list[str] = []
    monkeypatch.setattr(b.statistics.stream, "give", lambda: given.append("twist"))
    b.publish()  # without a transform
    b.outputs.publish_present(present(100))
    assert given == []
    tf.known = True
    b.publish(1010, status=Status.NO_MOTION)
    assert given == []
    for t_ms in (120, 110):  # the second one is not the newest
        b.outputs.publish_present(present(t_ms))
    assert given == ["twist"]
    b.publish(1020)
    assert given == ["twist"] * 2
