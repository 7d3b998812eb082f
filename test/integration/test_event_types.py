"""The node over DDS, with the same events as every message type, from both kinds of publishers."""

import array
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import dv_ros2_msgs.msg
import dvs_msgs.msg
import event_array_msgs.msg
import event_camera_msgs.msg
import numpy as np
import prophesee_event_msgs.msg
import pytest
from builtin_interfaces.msg import Time
from harness import MS, ROOT, Peer, Processes
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField
from shared_node import SharedNode
from std_msgs.msg import Header

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import Events, WindowSlicer
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

sys.path.append(str(ROOT / "test" / "msg_adapters"))
from encoders import COUNT_FROM_TIME_BASE, ENCODERS

pytestmark = pytest.mark.dds

CAMERA = Camera(120, 90, 110.0, 110.0, 60.0, 45.0)
START = 2_000_000_000
ENCODER = MessageEncoder(ros1=False)
BATCH = 10 * MS
BEST_EFFORT, RELIABLE = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
# One topic for all: a node follows what is published there after each activation, the type and
# the reliability.
TOPIC = "/events"

type ToMessage = Callable[[Events, int], Any]


def header(events: Events) -> Header:
    """A header stamped with the first event's time."""
    sec, nanosec = divmod(int(events.t[0]), 10**9)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id="cam_optical")


def as_event_array(events: Events, seq: int) -> bytes:
    """Serialised dvs_msgs/EventArray, which prophesee_event_msgs/EventArray is, too."""
    return ENCODER.events(int(events.t[0]), CAMERA, events)


def as_packet(encoding: str, kind: Any = event_camera_msgs.msg.EventPacket) -> ToMessage:
    def convert(events: Events, seq: int) -> Any:
        time_base = int(events.t[0]) if encoding in COUNT_FROM_TIME_BASE else 0
        return kind(
            header=header(events),
            width=CAMERA.width,
            height=CAMERA.height,
            seq=seq,
            time_base=time_base,
            encoding=encoding,
            events=array.array("B", ENCODERS[encoding](events, time_base).tobytes()),
        )

    return convert


def as_cloud(events: Events, seq: int) -> PointCloud2:
    points = np.empty(len(events), [("p", "u1"), ("t", "<f8"), ("y", "<f4"), ("x", "<f4")])
    points["x"], points["y"], points["p"], points["t"] = (
        events.x,
        events.y,
        events.p,
        events.t / 1e9,
    )
    datatypes = {"|u1": PointField.UINT8, "<f8": PointField.FLOAT64, "<f4": PointField.FLOAT32}
    return PointCloud2(
        header=header(events),
        height=1,
        width=len(points),
        fields=[
            PointField(name=name, offset=offset, datatype=datatypes[dtype.str], count=1)
            for name, (dtype, offset) in points.dtype.fields.items()
        ],
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=array.array("B", points.tobytes()),
    )


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    return simulate("calm", duration_s=0.47, seed=5, camera=CAMERA, fps=250, start_ns=START)


@pytest.fixture(scope="module")
def batches(recording: SimulatedRecording) -> list[Events]:
    events = recording.events
    cuts = np.arange(START + BATCH, recording.t_end, BATCH)
    bounds = [0, *np.searchsorted(events.t, cuts), len(events)]
    return [events[first:last] for first, last in pairwise(bounds)]


@pytest.fixture(scope="module")
def expected(recording: SimulatedRecording) -> list[Estimate]:
    """The estimates of the same windows without ROS."""
    from emoflow_ros.factory import make_estimator

    config = load_config("realtime")
    estimator = make_estimator(CAMERA, config)
    return [estimator.estimate(w) for w in WindowSlicer(config.window).push(recording.events)]


def twists(peer: Peer) -> tuple[list[int], np.ndarray]:
    """Stamps in ns, and (N, 6) of linear and angular velocity."""
    stamps = [t.header.stamp.sec * 10**9 + t.header.stamp.nanosec for t in peer.twists]
    vectors = [(t.twist.linear, t.twist.angular) for t in peer.twists]
    return stamps, np.array([[v.x, v.y, v.z, w.x, w.y, w.z] for v, w in vectors])


@pytest.fixture
def peer(message_type: Any, reliability: ReliabilityPolicy) -> Iterator[Peer]:
    with Peer(TOPIC, message_type, reliability) as made:
        yield made


@pytest.mark.parametrize(
    ("message_type", "to_message", "reliability"),
    [
        pytest.param(dvs_msgs.msg.EventArray, as_event_array, BEST_EFFORT, id="dvs-best_effort"),
        pytest.param(dvs_msgs.msg.EventArray, as_event_array, RELIABLE, id="dvs-reliable"),
        pytest.param(
            prophesee_event_msgs.msg.EventArray, as_event_array, BEST_EFFORT, id="prophesee"
        ),
        pytest.param(dv_ros2_msgs.msg.EventArray, as_event_array, BEST_EFFORT, id="dv_ros2"),
        *(
            pytest.param(
                event_camera_msgs.msg.EventPacket,
                as_packet(encoding),
                reliability,
                id=f"{encoding}-{reliability.name.lower()}",
            )
            for encoding, reliability in (
                ("evt3", BEST_EFFORT),
                ("evt3", RELIABLE),
                ("libcaer_cmp", BEST_EFFORT),
            )
        ),
        pytest.param(
            event_array_msgs.msg.EventArray,
            as_packet("evt3", event_array_msgs.msg.EventArray),
            BEST_EFFORT,
            id="evt3-older_driver",
        ),
        pytest.param(PointCloud2, as_cloud, RELIABLE, id="point_cloud"),
    ],
)
def test_every_type_gives_the_twists_of_the_same_windows_offline(
    peer: Peer,
    node: SharedNode,
    batches: Sequence[Events],
    expected: Sequence[Estimate],
    message_type: Any,
    to_message: ToMessage,
    reliability: ReliabilityPolicy,
    request: pytest.FixtureRequest,
) -> None:
    assert [e.status for e in expected] == [Status.OK] * 5
    node.start(peer)
    peer.connect()
    name = message_type.__name__
    package = message_type.__module__.partition(".")[0]
    assert f"listening to {TOPIC} ({package}/msg/{name})" in node.output
    [subscription] = peer.node.get_subscriptions_info_by_topic(TOPIC)
    assert subscription.qos_profile.reliability == reliability

    peer.publish_camera(CAMERA)
    for seq, events in enumerate(batches):
        peer.events.publish(to_message(events, seq))
        peer.spin_for(BATCH / 1e9)
    count = str(sum(map(len, batches)))
    peer.spin_until(lambda: peer.status().get("events") == count, "all events")
    peer.spin_until(lambda: peer.status()["windows_ok"] == "5", "all windows")
    peer.spin_until(lambda: twists(peer)[0][-1:] == [expected[-1].t], "the last twist")

    encodings = re.findall(r"events are encoded as (\w+)", node.output)
    named = request.node.callspec.id.partition("-")[0]
    assert encodings == ([named] if hasattr(message_type(), "encoding") else [])

    # The node may match this subscriber after its first answer, which then reaches nobody.
    assert len(peer.twists) >= 4
    stamps, values = twists(peer)
    received = expected[-len(stamps) :]
    assert stamps == [e.t for e in received]
    np.testing.assert_allclose(values[:, :3], [e.linear for e in received], atol=1e-6)
    np.testing.assert_allclose(values[:, 3:], [e.angular for e in received], atol=1e-6)


def test_events_on_two_topics_are_listed(processes: Processes) -> None:
    first, second = "/cam/events", "/second/events"
    question = f"2 event topics: {first}, {second}; choose with --ros-args -r events:={first}"
    with Peer(first) as peer:
        packets = peer.node.create_publisher(event_camera_msgs.msg.EventPacket, second, 10)
        node = processes.start_fake("Recorder")
        peer.hear()
        peer.spin_until(lambda: question in peer.status()["message"], "the question")
        assert question in processes.output(node)
        assert peer.events.get_subscription_count() == packets.get_subscription_count() == 0

        peer.node.destroy_publisher(packets)  # an answer, too
        peer.connect()
        assert f"listening to {first} (dvs_msgs/msg/EventArray)" in processes.output(node)


def test_type_that_is_not_installed_names_its_package(processes: Processes) -> None:
    without = "import sys; sys.modules['prophesee_event_msgs'] = None; "
    main = "from emoflow_ros.node.executable import main; main('fake_estimators:Recorder')"
    with Peer("/events", prophesee_event_msgs.msg.EventArray) as peer:
        node = processes.start(sys.executable, "-c", without + main)
        peer.hear()
        peer.spin_until(lambda: "is not installed" in peer.status()["message"], "the refusal")
        assert (
            "prophesee_event_msgs/msg/EventArray: the message package prophesee_event_msgs is not "
            "installed; build prophesee_event_msgs in your workspace, source its setup file"
        ) in processes.output(node)
        assert peer.events.get_subscription_count() == 0
        assert node.poll() is None
