"""Runs the node until its end is asked for: the executable `estimator` after its imports."""

import argparse
import contextlib
from collections.abc import Callable

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from emoflow_ros.cli import run
from emoflow_ros.node.ending import Ending
from emoflow_ros.node.estimator_node import EstimatorNode
from emoflow_ros.node.ros_arguments import own_arguments, refused_in_one_line
from emoflow_ros.node.supervisor import FACTORY

_EPILOG = """\
topics in:
  events       dvs_msgs or prophesee_event_msgs EventArray, event_camera_msgs/EventPacket,
               event_array_msgs/EventArray (older drivers),
               sensor_msgs/PointCloud2; if nobody publishes `events`, the only event topic in
               the node's namespace is taken; PointCloud2 must be remapped
  camera_info  sensor_msgs/CameraInfo, the calibration, beside the events unless remapped
  imu          sensor_msgs/Imu, a gyro, beside the events unless remapped; with imu.use

topics out:
  egomotion/twist, egomotion/twist_with_covariance   camera velocity: direction and rad/s
  egomotion/status                                   the verdict on every window
  flow/image, flow/color, flow/iwe, flow/tracks      only while somebody subscribes
  /diagnostics                                       what is wrong, rates, latency, losses

Nothing is estimated without a calibration: where nobody publishes camera_info, give a
camera_info YAML (or ECD calib.txt) by camera.calibration_file. Events without a size of their
own, as in PointCloud2, take that of the calibration.

Topics and parameters are given as ROS arguments:
  estimator --ros-args -r events:=/davis/left/events -p camera.calibration_file:=calib.yaml
  estimator --ros-args --params-file my.yaml -p window.duration_ms:=50.0
"""


def run_node(ending: Ending, factory: str | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Args:
        ending: where the two arrive.
        factory: `module:function` that makes the estimator in the worker, if not the usual one.

    Returns:
        The exit code.
    """
    return run(lambda: _main(ending, factory or FACTORY))


def parser() -> argparse.ArgumentParser:
    """Describe the command line, whose arguments are all for ROS."""
    return argparse.ArgumentParser(
        prog="estimator",
        description="ROS 2 node: event arrays in, egomotion and optical flow out.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def spin_until_asked(node: Node, give_end: Callable[[Callable[[], None]], None]) -> None:
    """Run a node's callbacks until the end is asked for.

    rclpy's spin_until_future_complete keeps a function for every callback that it has run.

    Args:
        node: whose callbacks are run.
        give_end: gets the function that asks for the end, from any thread.
    """
    is_asked = False

    def end() -> None:
        nonlocal is_asked
        is_asked = True

    wish = node.create_guard_condition(end)

    def ask() -> None:
        with contextlib.suppress(InvalidHandle):  # the node is gone already
            wish.trigger()

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    give_end(ask)
    while not is_asked:
        executor.spin_once()


def _main(ending: Ending, factory: str) -> int:
    parser().parse_args(own_arguments())
    ending.imported()
    node = None
    try:
        with refused_in_one_line():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = EstimatorNode(factory)
        spin_until_asked(node, ending.in_order)
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown()
    return 0
