"""A gyro at 1000 Hz beside events, over DDS."""

import time

import numpy as np
import pytest
from harness import MS, Peer, Processes
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from emoflow_ros.simulation.messages import ImuSample, MessageEncoder

pytestmark = pytest.mark.dds

START_MS = 1_000_000
LENGTH_MS = 1500
W = np.array([0.1, -0.2, 0.3])


def test_windows_have_the_readings_of_a_fast_imu(peer: Peer, processes: Processes) -> None:
    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    imu = peer.node.create_publisher(Imu, "/imu", qos)
    encoder, rng = MessageEncoder(ros1=False), np.random.default_rng(0)
    messages = [
        encoder.imu((START_MS + ms) * MS, ImuSample(W + rng.normal(0, 1e-3, 3), np.zeros(3)))
        for ms in range(LENGTH_MS)
    ]
    parameters = ("imu.use:=auto", "window.duration_ms:=50.0", "window.stride_ms:=50.0")
    processes.start_node("fake_estimators:GyroRecorder", ("output.diagnostics_s:=0.1", *parameters))
    peer.connect()
    peer.publish_camera()
    peer.spin_until(imu.get_subscription_count, "the IMU is heard")
    began = time.monotonic()
    for ms, message in enumerate(messages):
        imu.publish(message)
        if ms % 5 == 0:
            peer.publish_events((START_MS + ms) * MS)
        time.sleep(max(0.0, began + 1e-3 * ms - time.monotonic()))
    peer.spin_until(lambda: len(peer.twists) >= LENGTH_MS // 50 - 2, "twists")
    angular = [t.twist.angular for t in peer.twists]
    errors = np.array([[a.x, a.y, a.z] for a in angular]) - W
    # A busy machine may lose some messages.
    assert (np.abs(errors).max(axis=1) < 1e-3).mean() > 0.8
    peer.spin_until(lambda: peer.status().get("gyro") == "used", "the gyro is used")
