"""A small filter of angular velocity and direction of translation, as users have it."""

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from numpy.typing import NDArray

from emoflow_ros.node.linear_covariance import UNKNOWN

Array = NDArray[np.float64]


class SmallFilter:
    """An extended Kalman filter; w and the direction are random walks.

    Args:
        of_w: variance of each component of w that is added per second, (rad/s)^2.
        of_v: the same of the direction, across it, rad^2.
    """

    def __init__(self, of_w: float, of_v: float) -> None:
        self._of_w, self._of_v = of_w, of_v
        self._t: float | None = None
        self.w, self.v = np.zeros(3), np.zeros(3)
        self.w_covariance, self._v_covariance = 10.0 * np.eye(3), np.eye(2)

    def take(self, message: TwistWithCovarianceStamped) -> None:
        """Take a twist as it is published, with its covariance."""
        self._advance(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
        twist = message.twist.twist
        covariance = np.reshape(message.twist.covariance, (6, 6))
        angular = np.array([twist.angular.x, twist.angular.y, twist.angular.z])
        self._correct(angular, covariance[3:, 3:])
        linear = np.array([twist.linear.x, twist.linear.y, twist.linear.z])
        if linear.any():
            self._turn_to(linear / np.linalg.norm(linear), covariance[:3, :3])

    def take_gyro(self, t: float, angular: Array, sigma: float) -> None:
        """Take a gyro's reading (3,), rad/s, with its standard deviation."""
        self._advance(t)
        self._correct(angular, sigma**2 * np.eye(3))

    def _advance(self, t: float) -> None:
        if self._t is not None:
            seconds = max(0.0, t - self._t)
            self.w_covariance = self.w_covariance + self._of_w * seconds * np.eye(3)
            self._v_covariance = self._v_covariance + self._of_v * seconds * np.eye(2)
        self._t = t

    def _correct(self, angular: Array, covariance: Array) -> None:
        gain = self.w_covariance @ np.linalg.inv(self.w_covariance + covariance)
        self.w = self.w + gain @ (angular - self.w)
        self.w_covariance = (np.eye(3) - gain) @ self.w_covariance

    def _turn_to(self, v: Array, covariance: Array) -> None:
        """Correct the direction on its tangent plane; what is wide along v does not count."""
        if not self.v.any():
            self.v = v
        across = np.linalg.svd(self.v[None])[2][1:]  # (2, 3)
        own = np.linalg.svd(v[None])[2][1:]
        turned, _, back = np.linalg.svd(across @ own.T)
        turn = turned @ back @ own
        noise = turn @ covariance @ turn.T
        assert np.trace(noise) < UNKNOWN / 10
        towards = across @ v
        length = float(np.linalg.norm(towards))
        angle = np.arctan2(length, float(self.v @ v))
        error = angle * towards / length if length > 0 else np.zeros(2)
        gain = self._v_covariance @ np.linalg.inv(self._v_covariance + noise)
        step = across.T @ (gain @ error)
        self._v_covariance = (np.eye(2) - gain) @ self._v_covariance
        self.v = self.v + step
        self.v = self.v / np.linalg.norm(self.v)
