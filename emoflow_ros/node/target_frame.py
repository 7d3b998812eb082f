"""The frame that twists are expressed in: the camera's own, or one that it is mounted in."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time
from scipy.spatial.transform import Rotation

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.node.settings import OutputOptions

type Matrix = NDArray[np.float64]

LATEST = 0  # as a stamp: the latest rotation that is known
_DISORDER = NS_PER_S


class NoTransformError(Exception):
    """The rotation into the frame is not known at this time; the text says why."""


class TargetFrame(Protocol):
    """A frame to express twists in."""

    def name(self, optical_frame: str) -> str:
        """Name the frame."""
        ...

    def rotation(self, optical_frame: str, stamp: int) -> Matrix:
        """Rotation (3, 3) from the optical frame into this one, at ROS time in ns.

        Raises:
            NoTransformError: it is not known.
        """
        ...

    def close(self) -> None:
        """Stop listening."""
        ...


def make_target_frame(node: Node, options: OutputOptions) -> TargetFrame:
    """Make the frame that the options name.

    Raises:
        InputError: tf is asked for and not installed.
    """
    if not options.target_frame:
        return OpticalFrame()
    if options.target_source == "tf":
        return TfFrame(node, options.target_frame)
    angles = (options.target_roll, options.target_pitch, options.target_yaw)
    return FixedFrame(options.target_frame, Rotation.from_euler("xyz", angles).as_matrix())


class OpticalFrame:
    """The camera's own frame."""

    def name(self, optical_frame: str) -> str:
        """Name the frame."""
        return optical_frame

    def rotation(self, optical_frame: str, stamp: int) -> Matrix:
        """Rotate nothing."""
        return np.eye(3)

    def close(self) -> None:
        """Do nothing."""


class FixedFrame:
    """A frame that the camera is fixed to.

    Args:
        name: of the frame.
        rotation: (3, 3), from the optical frame into it.
    """

    def __init__(self, name: str, rotation: Matrix) -> None:
        self._name = name
        self._rotation = rotation

    def name(self, optical_frame: str) -> str:
        """Name the frame."""
        return self._name

    def rotation(self, optical_frame: str, stamp: int) -> Matrix:
        """Return the rotation that was given."""
        return self._rotation

    def close(self) -> None:
        """Do nothing."""


class TfFrame:
    """A frame that tf knows, fixed to the camera or not.

    Args:
        node: listens to tf.
        name: of the frame.
        parameter: the parameter that asks for tf, for the error.
        instead: what the user can do without tf, for the error.

    Raises:
        InputError: tf2_ros is not installed.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        parameter: str = "output.target_source",
        instead: str = "choose parameter and give output.target_roll, output.target_pitch and "
        "output.target_yaw",
    ) -> None:
        self._tf = _import_tf(parameter, instead)
        self._name = name
        self._buffer = self._tf.Buffer()
        self._listener = self._tf.TransformListener(self._buffer, node)
        self._last = LATEST

    def name(self, optical_frame: str) -> str:
        """Name the frame."""
        return self._name

    def rotation(self, optical_frame: str, stamp: int) -> Matrix:
        """Look the rotation up.

        Where stamps go back, as in a bag that is played again, what tf said before is forgotten:
        tf2 refuses transforms that are older than its buffer.
        """
        if stamp != LATEST:
            if stamp < self._last - _DISORDER:
                self._buffer.clear()
            self._last = stamp
        return self.between(self._name, optical_frame, stamp)

    def between(self, target: str, source: str, stamp: int) -> Matrix:
        """Rotation (3, 3) from one frame into another, at ROS time in ns or LATEST.

        Raises:
            NoTransformError: it is not known.
        """
        try:
            found = self._buffer.lookup_transform(target, source, Time(nanoseconds=stamp))
        except self._tf.TransformException as error:
            reason = f"no transform from {source} to {target}: {error}"
            raise NoTransformError(reason) from None
        q = found.transform.rotation
        return Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()

    def close(self) -> None:
        """Unsubscribe."""
        self._listener.unregister()


def _import_tf(parameter: str, instead: str) -> Any:
    try:
        import tf2_ros  # optional: not every installation of ROS has it
    except ImportError:
        raise InputError(
            parameter,
            "tf needs the package tf2_ros, which is not installed",
            f"install ros-jazzy-tf2-ros-py or {instead}",
        ) from None
    return tf2_ros
