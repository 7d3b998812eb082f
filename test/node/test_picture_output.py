"""The topics of the pictures: who gets them, and what they say."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_estimators import Recorder
from fake_node import FakeNode
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image
from visualization_msgs.msg import Marker

from emoflow_ros.config import Config, load_config
from emoflow_ros.core.geometry.calibration import camera_from_info
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.node.picture_output import PictureOutput, to_camera_info, to_image, to_tracks
from emoflow_ros.node.settings import NodeOptions, Settings
from emoflow_ros.node.tasks import Picture, Result, Task
from emoflow_ros.node.twist_output import to_header

MS = 1_000_000
CAMERA = Camera(8, 6, 5.0, 5.0, 4.0, 3.0)
LENS = replace(CAMERA, model="equidistant", distortion=(0.1, 0.02, -0.03, 0.004))
HEADER = to_header(1_500_000_000_123_456_789, "camera")


class Bench:
    """Pictures of a node without DDS."""

    def __init__(self, **values: Any) -> None:
        self.node = FakeNode()
        given = {name.replace("__", "."): value for name, value in values.items()}
        options = Settings(NodeOptions(), load_config()).changed(given).node.output
        node: Any = self.node
        self.pictures = PictureOutput(node, options, ExitStack())

    def publish(self, pictures: dict[str, Any], camera: Camera = CAMERA) -> None:
        window = Window(1000 * MS, 1010 * MS, Events.empty())
        estimate = Recorder(CAMERA, Config()).estimate(window)
        task = Task(window, 0, 0, "optical", 0.0)
        self.pictures.publish(Result(task, estimate, pictures, camera=camera))


@pytest.fixture
def bench() -> Callable[..., Bench]:
    return Bench


def vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def test_only_what_somebody_subscribes_to_is_wished_for(bench: Callable[..., Bench]) -> None:
    b = bench(
        output__tracks=7,
        output__flow_color_max=3.0,
        output__flow_stride=4,
    )
    assert b.pictures.wishes.pictures == ()
    for picture in Picture:
        b.node.publishers[picture].subscribers = 1
        assert b.pictures.wishes.pictures == (picture,)
        b.node.publishers[picture].subscribers = 0
    wishes = b.pictures.wishes
    assert (wishes.tracks, wishes.flow_color_max) == (7, 3.0)
    assert wishes.flow_stride == 4


def test_tracks_are_a_marker_in_front_of_the_camera(bench: Callable[..., Bench]) -> None:
    b = bench()
    lines = np.float32([[[0, 0.5, 1, 0], [0.25, 0.5, 1, 0.5]], [[-1, 0, 1, 0.5], [-1, 0.5, 1, 1]]])
    b.publish({Picture.TRACKS: lines})
    [marker] = b.node.messages("flow/tracks")
    assert (marker.type, marker.action, marker.ns) == (marker.LINE_LIST, marker.ADD, "tracks")
    assert marker.header.frame_id == "optical"
    assert (marker.header.stamp.sec, marker.header.stamp.nanosec) == (1, 5 * MS)
    assert [vector(p) for p in marker.points] == lines.reshape(4, 4)[:, :3].tolist()
    assert [c.a for c in marker.colors] == [0.0, 0.5, 0.5, 1.0]
    assert (marker.pose.orientation.w, marker.frame_locked) == (1.0, True)


@pytest.mark.parametrize("camera", [CAMERA, LENS])
def test_images_have_their_calibration_beside_them(
    bench: Callable[..., Bench], camera: Camera
) -> None:
    b = bench()
    b.publish({Picture.COLOR: np.zeros((6, 8, 3), np.uint8)}, camera)
    [info], [image] = b.node.messages("flow/camera_info"), b.node.messages("flow/color")
    assert info.header == image.header
    assert camera_from_info(info, "flow/camera_info", "") == camera
    assert (info.width, info.height) == (image.width, image.height)
    b.publish({Picture.TRACKS: np.zeros((0, 2, 4), np.float32)})
    b.publish({})
    assert len(b.node.messages("flow/camera_info")) == 1


def test_first_subscriber_of_the_flow_learns_what_viewers_show(
    bench: Callable[..., Bench],
) -> None:
    b = bench()
    b.node.publishers["flow/color"].subscribers = 1
    assert b.pictures.wishes.pictures == (Picture.COLOR,)
    assert b.node.log == []
    for subscribers in (1, 2):
        b.node.publishers["flow/image"].subscribers = subscribers
        assert Picture.FLOW in b.pictures.wishes.pictures
    [(level, line)] = b.node.log
    assert level == "info"
    assert line.endswith("RViz and rqt_image_view do not show; flow/color is the picture of it")


def test_calibration_survives_as_a_driver_s_does() -> None:
    info = to_camera_info(LENS, HEADER)
    assert (info.distortion_model, list(info.d)) == ("equidistant", list(LENS.distortion))
    assert info.p.reshape(3, 4)[:, :3].tolist() == info.k.reshape(3, 3).tolist()


def test_flow_image_survives_serialisation() -> None:
    flow = np.arange(24, dtype=np.float32).reshape(3, 4, 2)
    flow[1, 2] = np.nan
    message = to_image(flow, "32FC2", HEADER)
    message = deserialize_message(serialize_message(message), Image)
    assert (message.encoding, message.height, message.width) == ("32FC2", 3, 4)
    assert message.step == 4 * 2 * 4
    back = np.frombuffer(message.data, "<f4").reshape(3, 4, 2)
    np.testing.assert_array_equal(back, flow)


def test_track_marker_survives_serialisation() -> None:
    lines = np.float32([[[0.1, -0.2, 1.0, 0.25], [0.3, -0.2, 1.0, 0.75]]])
    message = to_tracks(lines, HEADER)
    message = deserialize_message(serialize_message(message), Marker)
    assert (message.type, message.id, message.header) == (Marker.LINE_LIST, 0, HEADER)
    points = [(p.x, p.y, p.z) for p in message.points]
    np.testing.assert_array_equal(np.float32(points), lines[0, :, :3])
    assert [c.a for c in message.colors] == [0.25, 0.75]
    assert len({(c.r, c.g, c.b) for c in message.colors}) == 1
    assert message.lifetime.sec == 2
    assert to_tracks(np.empty((0, 2, 4), np.float32), HEADER).points == []
