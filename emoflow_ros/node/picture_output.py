"""The topics of the pictures, and the calibration beside them."""

import array
from contextlib import ExitStack
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.node.settings import OutputOptions
from emoflow_ros.node.tasks import Picture, Result, Wishes
from emoflow_ros.node.twist_output import make_publisher, to_header

_ENCODINGS = {Picture.FLOW: "32FC2", Picture.COLOR: "rgb8", Picture.EVENTS: "mono8"}
_TRACK_WIDTH = 0.004  # m, at a distance of 1 m: about a pixel
_TRACK_COLOR = (1.0, 0.75, 0.1)
_TRACK_LIFETIME = Duration(sec=2)
_NO_VIEWER = (
    "flow/image is the flow in px/s for programs (32FC2), which RViz and rqt_image_view do not "
    "show; flow/color is the picture of it"
)


class PictureOutput:
    """Publishes the pictures that somebody subscribes to, and `flow/camera_info` with the images.

    Args:
        node: to publish with.
        options: how they are drawn.
        made: gets the calls that take the topics away.
    """

    def __init__(self, node: LifecycleNode, options: OutputOptions, made: ExitStack) -> None:
        self._node = node
        self._options = options
        self._is_told = False
        self._publishers = {
            picture: make_publisher(
                node, Marker if picture is Picture.TRACKS else Image, picture, made
            )
            for picture in Picture
        }
        self._camera_info = make_publisher(node, CameraInfo, "flow/camera_info", made)

    @property
    def wishes(self) -> Wishes:
        """What results are to hold: only those pictures that somebody subscribes to now."""
        subscribed = [p for p in Picture if self._publishers[p].get_subscription_count() > 0]
        if Picture.FLOW in subscribed and not self._is_told:
            self._is_told = True
            self._node.get_logger().info(_NO_VIEWER)
        return Wishes(
            tuple(subscribed),
            flow_color_max=self._options.flow_color_max,
            flow_stride=self._options.flow_stride,
            tracks=self._options.tracks,
        )

    def publish(self, result: Result) -> None:
        """Publish the pictures of a window."""
        header = to_header(result.stamp, result.task.frame_id)
        for name, drawn in result.pictures.items():
            picture = Picture(name)
            if picture is Picture.TRACKS:
                message = to_tracks(drawn, header)
            else:
                message = to_image(drawn, _ENCODINGS[picture], header)
            self._publishers[picture].publish(message)
        if result.camera is not None and set(result.pictures) - {Picture.TRACKS}:
            self._camera_info.publish(to_camera_info(result.camera, header))


def to_image(pixels: NDArray[Any], encoding: str, header: Header) -> Image:
    """Build an image from pixels (height, width, ...) that are laid out as the encoding says."""
    height, width = pixels.shape[:2]
    return Image(
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels.nbytes // height,
        data=array.array("B", pixels.tobytes()),
    )


def to_tracks(lines: NDArray[np.float32], header: Header) -> Marker:
    """Build a marker of line segments (S, 2, 4): x, y, z in m and opacity; it replaces the last."""
    marker = Marker(header=header, ns="tracks", type=Marker.LINE_LIST, action=Marker.ADD)
    marker.pose.orientation.w = 1.0
    marker.scale.x = _TRACK_WIDTH
    marker.lifetime = _TRACK_LIFETIME
    marker.frame_locked = True
    ends = lines.reshape(-1, 4).tolist()
    red, green, blue = _TRACK_COLOR
    marker.points = [Point(x=x, y=y, z=z) for x, y, z, _ in ends]
    marker.colors = [ColorRGBA(r=red, g=green, b=blue, a=opacity) for *_, opacity in ends]
    return marker


def to_camera_info(camera: Camera, header: Header) -> CameraInfo:
    """Build the calibration of the sensor's images; they are not rectified."""
    k = camera.intrinsic_matrix
    without = camera.model == "none"
    return CameraInfo(
        header=header,
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob" if without else camera.model,
        d=[0.0] * 5 if without else list(camera.distortion),
        k=k.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([k, np.zeros((3, 1))]).ravel(),
    )
