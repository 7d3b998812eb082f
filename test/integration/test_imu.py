"""A gyro at 1000 Hz beside events, over DDS."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from harness import MS, Peer, Processes
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

from emoflow_ros.simulation.messages import ImuSample, MessageEncoder

pytestmark = pytest.mark.dds

START_MS = 1_000_000
WINDOW_MS = 50
ENOUGH, MOST = 28, 300  # windows with a twist, and windows that are published for that
W = np.array([0.1, -0.2, 0.3])


def test_windows_have_the_readings_of_a_fast_imu(peer: Peer, processes: Processes) -> None:
    """As many windows are published as it takes: a busy machine may lose some messages."""
    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    imu = peer.node.create_publisher(Imu, "/imu", qos)
    said: list[DiagnosticStatus] = []
    peer.node.create_subscription(DiagnosticStatus, "/egomotion/status", said.append, 100)
    encoder, rng = MessageEncoder(ros1=False), np.random.default_rng(0)
    lengths = (f"window.duration_ms:={WINDOW_MS}.0", f"window.stride_ms:={WINDOW_MS}.0")
    parameters = ("output.diagnostics_s:=0.1", "imu.use:=auto", *lengths)
    processes.start_node("fake_estimators:GyroRecorder", parameters)
    peer.connect()
    peer.publish_camera()
    peer.spin_until(imu.get_subscription_count, "the IMU is heard")
    for window in range(MOST):
        for ms in range(START_MS + window * WINDOW_MS, START_MS + (window + 1) * WINDOW_MS):
            imu.publish(encoder.imu(ms * MS, ImuSample(W + rng.normal(0, 1e-3, 3), np.zeros(3))))
            if ms % 5 == 0:
                peer.publish_events(ms * MS)
        # The node says something of each window; of one whose messages are lost it says nothing.
        peer.spin_while_alive(lambda window=window: len(said) >= window)
        if len(peer.twists) >= ENOUGH:
            break
    peer.spin_until(lambda: len(peer.twists) >= ENOUGH, "twists")
    angular = [t.twist.angular for t in peer.twists]
    errors = np.array([[a.x, a.y, a.z] for a in angular]) - W
    assert (np.abs(errors).max(axis=1) < 1e-3).mean() > 0.8
    peer.spin_until(lambda: peer.status().get("gyro") == "used", "the gyro is used")
