"""Poses of other data sets: text files of TUM's format, and topics of any name."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.truth import load_truth, truth_beside
from emoflow_ros.truth.bag_truth import load_bag_truth
from emoflow_ros.truth.text_truth import is_tum, load_poses

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
RATE, SPEED = np.array([0.2, -0.4, 0.1]), np.array([0.3, 0.0, 0.1])
POSE, ODOMETRY = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"


def poses(start: float = 0.0, rate: float = 200.0) -> np.ndarray:
    """Rows t tx ty tz qx qy qz qw of a constant velocity in the world and a constant rate, 1 s."""
    t = np.arange(0, 1, 1 / rate)
    turned = Rotation.from_rotvec(np.outer(t, RATE)).as_quat()
    return np.column_stack([start + t, np.outer(t, SPEED), turned])


def write_text(path: Path, rows: np.ndarray, unit: float = 1.0) -> Path:
    scaled = rows.copy()
    scaled[:, 0] *= unit
    np.savetxt(path, scaled, fmt="%.9f", header="timestamp tx ty tz qx qy qz qw")
    return path


def assert_motion(truth, t: int, seconds: float = 0.5, atol: float = 1e-4) -> None:
    twist = truth.twists.twist(t)
    np.testing.assert_allclose(twist.angular, RATE, atol=atol)
    world = Rotation.from_rotvec(RATE * seconds)
    np.testing.assert_allclose(twist.linear, world.inv().apply(SPEED), atol=atol)


@pytest.mark.parametrize(
    ("start", "unit"),
    [(0.0, 1), (1.64e9, 1), (0.0, 1e6), (1.64e9, 1e6), (0.0, 1e9), (1.64e9, 1e9)],
)
def test_text_in_any_unit_of_time(tmp_path, start, unit):
    path = write_text(tmp_path / "mocap.txt", poses(start), unit)
    truth = load_poses(path, CAMERA)
    assert_motion(truth, round((start + 0.5) * NS_PER_S), atol=1e-3)
    assert "mocap.txt, slope of a cubic least-squares fit" in truth.description[0]
    assert "taken as those of the event camera's optical frame" in truth.description[0]


def test_any_name_is_told_by_its_first_line(tmp_path):
    assert is_tum(write_text(tmp_path / "traj.tum", poses()))
    for name, text in (
        ("events.txt", "0.1 1 2 1\n"),
        ("euroc.csv", "1,2,3,4,5,6,7,8\n"),
        ("words.txt", "t tx ty tz qx qy qz qw\n"),
        ("empty.txt", "# nothing\n"),
    ):
        (tmp_path / name).write_text(text)
        assert not is_tum(tmp_path / name)
    assert not is_tum(tmp_path)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (["0 0 0 0 0 0 0", "1 0 0 0 0 0 0"], "lines of 7 numbers; give lines 't tx ty tz qx"),
        (["0.2 0 0 0 0 0 0 1", "0.1 0 0 0 0 0 0 1"], "times are not increasing"),
        (["0.1 0 0 0 0 0 0 1", "0.2 0 0 0 0 0 0 0"], "the quaternion at 0.200000 s is zero"),
        (["0.1 0 0 0 0 0 0 1", "0.2 nan 0 0 0 0 0 1"], "not finite"),
        (["0 0 0 0 0 0 0 1", "20 0 0 0 0 0 0 1"], "poses are 20 units of time apart"),
        (["0 0 0 0 0 0 0 1", "500000 0 0 0 0 0 0 1"], "poses are 500000 units of time apart"),
    ],
)
def test_text_that_cannot_be_used(tmp_path, rows, words):
    path = tmp_path / "poses.txt"
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match=words):
        load_poses(path, CAMERA)


def test_poses_beside_hdf5_columns_and_given_by_any_name(tmp_path):
    path = tmp_path / "events.h5"
    n = 2000
    with h5py.File(path, "w") as file:
        for name in "xyp":
            file[name] = np.arange(n) % 40
        file["t"] = 200_000 + np.arange(n) * 301
    with open_recording(path) as recording:
        recording.camera = CAMERA
        assert truth_beside(recording) == []
        assert load_truth(recording).twists is None
        beside = write_text(tmp_path / "stamped_groundtruth.txt", poses())
        assert truth_beside(recording) == [beside]
        assert_motion(load_truth(recording), NS_PER_S // 2)
        other = write_text(tmp_path / "mocap_data.txt", poses(), 1e6)
        assert_motion(load_truth(recording, [other]), NS_PER_S // 2)
        (tmp_path / "notes.md").write_text("nothing")
        with pytest.raises(InputError, match="not ground truth of a known format"):
            load_truth(recording, [tmp_path / "notes.md"])


def write_poses(path: Path, topics: dict[str, str], child: str = "base_link") -> Path:
    """Write a bag with the same poses on topics of the given types."""
    ros1 = path.suffix == ".bag"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    make = {name.rpartition("/")[2]: kind for name, kind in types.types.items()}
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
    writer = rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=9)
    with writer:
        for topic, kind in topics.items():
            connection = writer.add_connection(topic, kind, typestore=types)
            for t, x, y, z, *q in poses().tolist():
                stamp = round(t * NS_PER_S)
                time = types.types["builtin_interfaces/msg/Time"](*divmod(stamp, NS_PER_S))
                header = make["Header"](0, time, "w") if ros1 else make["Header"](time, "w")
                pose = make["Pose"](make["Point"](x, y, z), make["Quaternion"](*q))
                message = make["PoseStamped"](header, pose)
                if kind == ODOMETRY:
                    zero = make["Vector3"](9.0, 9.0, 9.0)
                    twist = make["TwistWithCovariance"](make["Twist"](zero, zero), np.zeros(36))
                    covered = make["PoseWithCovariance"](pose, np.zeros(36))
                    message = make["Odometry"](header, child, covered, twist)
                writer.write(connection, stamp, serialize(message, kind))
    return path


@pytest.mark.parametrize("name", ["a.bag", "a"])
@pytest.mark.parametrize(
    ("topics", "chosen", "words"),
    [
        ({"/optitrack/davis": POSE}, "/optitrack/davis", "taken as those of the event camera"),
        ({"/odom": ODOMETRY}, "/odom", "poses of 'base_link' taken as those of the event camera"),
        ({"/odom": ODOMETRY, "/gt": POSE}, "/gt", "taken as"),
        ({"/cam/odometry": ODOMETRY, "/a": POSE, "/b": POSE}, "/cam/odometry", "base_link"),
        ({"/other/pose": POSE, "/a": POSE}, "/other/pose", ""),
        ({"/other/pose": POSE, "/cam/pose": POSE}, "/cam/pose", ""),
    ],
)
def test_topics_of_any_name(tmp_path, name, topics, chosen, words):
    path = write_poses(tmp_path / name, topics)
    truth = load_bag_truth(path, CAMERA, "/cam")
    assert_motion(truth, NS_PER_S // 2)
    [description] = truth.description
    assert description.startswith(f"velocity: {name}{chosen}, slope")
    assert words in description
    assert ("taken as" in description) == bool(words)


@pytest.mark.parametrize(
    "topics", [{"/a": POSE, "/b": POSE}, {"/a": ODOMETRY, "/b": ODOMETRY}], ids=["pose", "odom"]
)
def test_several_topics_of_which_none_is_the_cameras(tmp_path, topics):
    path = write_poses(tmp_path / "a.bag", topics)
    with pytest.raises(InputError, match="several of /a, /b; give a bag with one of them only"):
        load_bag_truth(path, CAMERA, "/cam")
