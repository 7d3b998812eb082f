"""Twist messages, and their scale: from parameters, and over DDS from all speed messages."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from ros_nodes import ros_context
from std_msgs.msg import Float64, String

from emoflow_ros.core.types.twist import Twist
from emoflow_ros.node.scale import Scale, Scaling, to_speed
from emoflow_ros.node.settings import ScaleOptions
from emoflow_ros.node.twist_output import make_publisher, to_header, to_twist_with_covariance

NS = 1_000_000_000
WAIT_S = 600.0  # only what hangs takes so long, also on a busy machine
TOPIC = ScaleOptions(source="topic", topic="speed", max_age_s=0.5)
HEADER = to_header(1_500_000_000_123_456_789, "camera")


class Peers:
    """A node that listens and one that publishes."""

    def __init__(self, context: Context) -> None:
        self._executor = SingleThreadedExecutor(context=context)
        self.listener = rclpy.create_node("listener", context=context)
        self.talker = rclpy.create_node("talker", context=context)
        self._executor.add_node(self.listener)

    def spin_until(self, condition: Callable[[], Any]) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < deadline
            self._executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        self._executor.shutdown()


@pytest.fixture
def peers() -> Iterator[Peers]:
    with ros_context() as context:
        made = Peers(context)
        yield made
        made.close()


def odometry(sec: int, x: float, y: float, z: float) -> Odometry:
    message = Odometry()
    message.header.stamp.sec = sec
    message.twist.twist.linear.x, message.twist.twist.linear.y = x, y
    message.twist.twist.linear.z = z
    return message


def twist(sec: int, x: float, y: float, z: float) -> TwistStamped:
    message = TwistStamped()
    message.header.stamp.sec = sec
    message.twist.linear.x, message.twist.linear.y, message.twist.linear.z = x, y, z
    return message


@pytest.fixture
def rotation() -> Twist:
    return Twist(
        t=5,
        linear=np.zeros(3),
        angular=np.array([0.1, -0.2, 0.3]),
    )


def test_publishers_add_nothing_that_the_executor_looks_at_in_each_turn() -> None:
    with ros_context() as context, ExitStack() as made:
        node = LifecycleNode("talker", context=context)
        before = len(list(node.waitables))
        make_publisher(node, TwistStamped, "twist", made)
        assert len(list(node.waitables)) == before
        assert "/twist" in {publisher.topic_name for publisher in node.publishers}


def test_header_splits_nanoseconds() -> None:
    assert (HEADER.stamp.sec, HEADER.stamp.nanosec) == (1_500_000_000, 123_456_789)
    assert to_header(-1, "").stamp == Time(sec=-1, nanosec=999_999_999)


def test_twist_of_a_rotation_has_no_direction(rotation: Twist) -> None:
    message = to_twist_with_covariance(rotation, np.zeros((6, 6)), HEADER)
    linear = message.twist.twist.linear
    assert (linear.x, linear.y, linear.z) == (0, 0, 0)
    assert message.twist.twist.angular.y == -0.2
    assert message.header == HEADER


def test_covariance_says_that_translation_is_not_observable(rotation: Twist) -> None:
    covariance = np.zeros((6, 6))
    covariance[0, 0] = -1
    message = to_twist_with_covariance(rotation, covariance, HEADER)
    assert message.twist.covariance[0] == -1
    np.testing.assert_array_equal(message.twist.covariance[1:], 0)


def test_speed_of_a_message_without_a_stamp_has_no_time() -> None:
    message = TwistStamped()
    message.twist.linear.x, message.twist.linear.z = -3.0, 4.0
    assert to_speed(message, "geometry_msgs/msg/TwistStamped") == (None, 5.0)
    message.header.stamp = Time(sec=2, nanosec=5)
    assert to_speed(message, "geometry_msgs/msg/TwistStamped") == (2_000_000_005, 5.0)
    assert to_speed(Float64(data=-2.0), "std_msgs/msg/Float64") == (None, 2.0)


def test_scale_from_parameters_needs_no_topic() -> None:
    scale = Scale(None, ScaleOptions())
    assert scale.at(5) == Scaling(None, "none")
    scale.set_options(ScaleOptions(source="parameter", speed=2.5))
    assert scale.at(5) == Scaling(2.5, "parameter")


@pytest.mark.dds
@pytest.mark.parametrize("make", [odometry, twist])
def test_speed_is_the_length_of_the_velocity_at_the_stamp(
    peers: Peers, make: Callable[..., Any]
) -> None:
    publisher = peers.talker.create_publisher(type(make(0, 0, 0, 0)), "/speed", 10)
    scale = Scale(peers.listener, TOPIC)
    peers.spin_until(publisher.get_subscription_count)
    publisher.publish(make(100, 2.0, -3.0, 6.0))
    peers.spin_until(lambda: scale.at(100 * NS).source == "topic")
    assert scale.at(100 * NS) == Scaling(7.0, "topic")
    assert scale.at(100 * NS + NS // 2) == Scaling(7.0, "topic")
    stale = scale.at(101 * NS)
    assert (stale.speed, stale.source) == (None, "none")
    assert (
        stale.problem == "no speed on speed within 0.5 s of the window; linear is a unit direction"
    )
    publisher.publish(make(101, 0.0, 0.0, 9.0))
    peers.spin_until(lambda: scale.at(101 * NS).source == "topic")
    assert scale.at(100 * NS + NS // 2) == Scaling(8.0, "topic")
    publisher.publish(make(102, float("nan"), 0.0, 9.0))
    publisher.publish(make(103, 0.0, 0.0, 1.0))
    peers.spin_until(lambda: scale.at(103 * NS).source == "topic")
    assert scale.at(102 * NS).source == "none"


@pytest.mark.dds
def test_number_without_a_stamp_counts_from_its_arrival(peers: Peers) -> None:
    publisher = peers.talker.create_publisher(Float64, "/speed", 10)
    scale = Scale(peers.listener, TOPIC)
    peers.spin_until(publisher.get_subscription_count)
    before = peers.listener.get_clock().now().nanoseconds
    publisher.publish(Float64(data=-1.5))
    peers.spin_until(lambda: scale.at(before).source == "topic")
    assert scale.at(before) == Scaling(1.5, "topic")
    assert scale.at(before - NS).source == "none"


@pytest.mark.dds
def test_topic_that_is_not_there_or_holds_no_speed_is_named(peers: Peers) -> None:
    scale = Scale(peers.listener, TOPIC)
    assert scale.at(0).problem == "nobody publishes /speed; linear is a unit direction"
    peers.talker.create_publisher(String, "/speed", 10)
    peers.spin_until(lambda: "std_msgs/msg/String holds no speed" in scale.at(0).problem)


@pytest.mark.dds
def test_another_topic_is_taken_while_running(peers: Peers) -> None:
    first = peers.talker.create_publisher(Float64, "/speed", 10)
    second = peers.talker.create_publisher(TwistStamped, "/other", 10)
    scale = Scale(peers.listener, TOPIC)
    peers.spin_until(first.get_subscription_count)
    scale.set_options(ScaleOptions(source="topic", topic="other", max_age_s=0.1))
    peers.spin_until(lambda: second.get_subscription_count() and not first.get_subscription_count())
    second.publish(twist(7, 0.0, 4.0, 0.0))
    peers.spin_until(lambda: scale.at(7 * NS).source == "topic")
    assert scale.at(7 * NS + NS // 5).source == "none"
    scale.set_options(ScaleOptions(source="topic", topic="speed"))
    peers.spin_until(first.get_subscription_count)
    scale.set_options(ScaleOptions())
    peers.spin_until(lambda: not first.get_subscription_count())
    assert scale.at(7 * NS) == Scaling()
