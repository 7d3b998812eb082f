"""The executable `estimator`: runs the node until SIGINT or SIGTERM."""

import argparse
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import ok, remove_ros_args, try_shutdown

from emoflow_ros.cli import run
from emoflow_ros.node.estimator_node import EstimatorNode
from emoflow_ros.node.supervisor import FACTORY

_EPILOG = """\
The topic and all parameters are given as ROS arguments:
  estimator --ros-args -r events:=/davis/left/events -p camera.calibration_file:=calib.yaml
  estimator --ros-args --params-file my.yaml -p window.duration_ms:=50.0
With one event topic in the graph nothing needs to be given.
"""


def main(factory: str = FACTORY) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return run(lambda: _main(factory))


def _main(factory: str) -> int:
    argparse.ArgumentParser(
        prog="estimator",
        description="ROS 2 node: event arrays in, egomotion and optical flow out.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    ).parse_args(remove_ros_args(sys.argv)[1:])
    rclpy.init()
    node = None
    try:
        node = EstimatorNode(factory)
        _spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown()
    return 0


def _spin(node: EstimatorNode) -> None:
    """Spin until the end. rclpy raises on an impossible transition; that shall not be the end."""
    while ok():
        try:
            rclpy.spin(node)
        except rclpy_implementation.RCLError as error:
            node.get_logger().error(f"a request is refused: {error}")
