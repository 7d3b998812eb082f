"""The executable `estimator`, which takes SIGINT and SIGTERM before the imports that take seconds.

So this module itself imports nothing but the standard library.
"""

import argparse
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing import resource_tracker
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_GRACE_S = 5.0

_EPILOG = """\
topics in:
  events       dvs_msgs, prophesee_event_msgs or dv_ros2_msgs EventArray,
               event_camera_msgs/EventPacket, event_array_msgs/EventArray (older drivers),
               sensor_msgs/PointCloud2; if nobody publishes `events`, the only event topic in
               the node's namespace is taken; PointCloud2 must be remapped
  camera_info  sensor_msgs/CameraInfo, the calibration, beside the events unless remapped
  imu          sensor_msgs/Imu, a gyro, beside the events unless remapped; with imu.use

topics out:
  egomotion/twist                                    camera velocity now: direction and rad/s
  egomotion/twist_now                                the same with its covariance
  egomotion/twist_with_covariance                    that in the middle of each window
  egomotion/status                                   the verdict on every window
  flow/image, flow/color, flow/iwe, flow/tracks      only while somebody subscribes
  flow/camera_info                                   the calibration beside the images
  /diagnostics                                       what is wrong, rates, latency, losses

Nothing is estimated without a calibration: where nobody publishes camera_info, give a
calibration file (camera_info YAML, Kalibr, OpenCV, ECD) by camera.calibration_file. Events
without a size of their own, as in PointCloud2, take that of the calibration.

Topics and parameters are given as ROS arguments:
  estimator --ros-args -r events:=/davis/left/events -p camera.calibration_file:=calib.yaml
  estimator --ros-args --params-file my.yaml -p window.duration_ms:=50.0
"""


def main(factory: str | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Args:
        factory: `module:function` that makes the estimator in the worker, if not the usual one.

    Returns:
        The exit code.
    """
    ending = Ending()
    from emoflow_ros.cli import run

    def command() -> None:
        from emoflow_ros.compiled_code import choose_folder

        choose_folder()
        from emoflow_ros.node.estimator_node import run_node
        from emoflow_ros.node.ros_arguments import own_arguments
        from emoflow_ros.node.supervisor import FACTORY

        parser().parse_args(own_arguments("estimator"))
        ending.imported()
        run_node(factory or FACTORY, ending.in_order)

    return run(command)


def parser() -> argparse.ArgumentParser:
    """Describe the command line. All of its arguments are for ROS."""
    return argparse.ArgumentParser(
        prog="estimator",
        description="ROS 2 node: event arrays in, egomotion and optical flow out.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


class Ending:
    """Takes the signals that end the process. Make one, in the main thread, before the imports.

    All threads block both signals, and a thread of this class takes them. So no signal interrupts
    an import or an end in order. Processes that are started inherit the block: they end with
    this one.

    The first signal prints one line. Before `imported` is called, it ends the process at once,
    with code 0. Afterwards it calls the function given to `in_order`; if the process is still
    there 5 s later, its children are killed and it ends. Further signals change nothing.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._importing = True
        self._asked = False
        self._end: Callable[[], None] | None = None
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        self._thread = threading.Thread(target=self._take, name="signals", daemon=True)
        self._thread.start()
        for number in _SIGNALS:
            signal.signal(number, self._pass_on)
        # multiprocessing unblocks both in the thread that starts its resource tracker. A worker
        # would inherit that, so the tracker is started now and the block is set again.
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)

    def imported(self) -> None:
        """End in order from now on."""
        with self._lock:
            self._importing = False

    def in_order(self, end: Callable[[], None]) -> None:
        """Let the first signal call `end`, once, in the thread of signals; or now if it came."""
        with self._lock:
            self._end = end
            if self._asked:
                end()

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        """Give a signal of a thread that has unblocked it to the thread that takes it."""
        assert self._thread.ident is not None
        signal.pthread_kill(self._thread.ident, number)

    def _take(self) -> None:
        name = signal.Signals(signal.sigwait(_SIGNALS)).name
        print(f"{name}: the node ends", file=sys.stderr, flush=True)
        with self._lock:
            if self._importing:
                os._exit(0)
            self._asked = True
            if self._end is not None:
                self._end()
        time.sleep(_GRACE_S)
        for child in multiprocessing.active_children():
            child.kill()
        os._exit(0)
