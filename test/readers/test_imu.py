"""A recording's IMU, from every format that has one, and what `info` says of it and of truth."""

import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.typesys import Stores, get_typestore

from emoflow_ros.commands.info import inspect, main
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.bag_files import open_bag, read_messages
from emoflow_ros.readers.bag_imu import IMU_TYPE, choose_imu, read_imu
from emoflow_ros.readers.reader_base import Imu

AEDAT4 = Path(__file__).parents[1] / "recordings" / "events.aedat4"
N = 50


def readings(start: int = NS_PER_S) -> Imu:
    """50 readings at 200 Hz with values of their own in every cell."""
    k = np.arange(N)
    t = start + k.astype(np.int64) * 5_000_003
    angular = np.stack([0.01 * k, -0.02 * k, 0.5 + 0 * k], axis=1)
    force = np.stack([0.1 * k, 0.2 + 0.1 * k, -9.81 + 0 * k], axis=1)
    return Imu("/cam/imu", t, angular, force)


def write_imu(path: Path, imu: Imu, topics=("/cam/imu",), frame="imu", covariances=(0.0, 0.0)):
    """Write a bag with these readings on IMU topics; `covariances` begin those of the vectors."""
    ros1 = path.suffix == ".bag"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    make = types.types
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
    with rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=9) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, IMU_TYPE, typestore=types)
            for t, angular, force in zip(
                imu.t.tolist(), imu.angular, imu.acceleration, strict=True
            ):
                time = make["builtin_interfaces/msg/Time"](*divmod(t, NS_PER_S))
                head = (0, time, frame) if ros1 else (time, frame)
                vector = make["geometry_msgs/msg/Vector3"]
                first = np.zeros(9), np.zeros(9)
                for values, value in zip(first, covariances, strict=True):
                    values[0] = value
                message = make[IMU_TYPE](
                    make["std_msgs/msg/Header"](*head),
                    make["geometry_msgs/msg/Quaternion"](0.1, 0.2, 0.3, 0.4),
                    np.full(9, 7.0),
                    vector(*angular.tolist()),
                    first[0],
                    vector(*force.tolist()),
                    first[1],
                )
                writer.write(connection, t, serialize(message, IMU_TYPE))
    return path


def assert_same(read: Imu, expected: Imu) -> None:
    np.testing.assert_array_equal(read.t, expected.t)
    np.testing.assert_array_equal(read.angular, expected.angular)
    np.testing.assert_array_equal(read.acceleration, expected.acceleration)
    assert (read.t.dtype, read.angular.dtype) == (np.int64, np.float64)


def read_messages_of(path: Path) -> Imu:
    with open_bag(path) as bag:
        return read_imu(path, read_messages(path, bag, bag.connections))


@pytest.mark.parametrize("frame", ["", "i", "im", "imu", "imu4_", "a_long_frame_id"])
@pytest.mark.parametrize("name", ["a.bag", "a"])
def test_messages_of_bags_whatever_the_frames_length(tmp_path, name, frame):
    imu = readings()
    read = read_messages_of(write_imu(tmp_path / name, imu, frame=frame))
    assert_same(read, imu)
    assert read.name == "/cam/imu"
    assert read.rate == pytest.approx(200, rel=1e-5)


def test_big_endian_message():
    body = struct.pack(">iII", 3, 4, 4) + b"imu\0"
    body += struct.pack(">37d", *range(37))
    connection = SimpleNamespace(topic="/imu", ext=ConnectionExtRosbag2("cdr", []))
    imu = read_imu(Path("a"), [(connection, 0, b"\0\0\0\0" + body)])
    assert imu.t.tolist() == [3 * NS_PER_S + 4]
    assert imu.angular.tolist() == [[13, 14, 15]]
    assert imu.acceleration.tolist() == [[25, 26, 27]]
    assert np.isnan(imu.rate)
    for data in (b"", b"\0\1\0\0", b"\0\0\0\0" + body[:-1]):
        with pytest.raises(InputError, match="a: damaged message on /imu"):
            read_imu(Path("a"), [(connection, 0, data)])


def test_what_an_imu_does_not_measure(tmp_path):
    imu = readings()
    read = read_messages_of(write_imu(tmp_path / "a.bag", imu, covariances=(0.1, -1.0)))
    assert read.acceleration is None
    np.testing.assert_array_equal(read.angular, imu.angular)
    with pytest.raises(InputError, match="/cam/imu says that it has no gyroscope"):
        read_messages_of(write_imu(tmp_path / "b.bag", imu, covariances=(-1.0, 0.0)))


def test_topics_of_a_recording(calm_bag):
    """The simulator's gyroscope: its noise is 0.003 rad/s, at rest it would feel 9.81 m/s^2."""
    with open_recording(calm_bag.data) as recording:
        imu = recording.imu()
        assert recording.imu("/davis/left/imu").name == imu.name == "/davis/left/imu"
        with pytest.raises(InputError, match="no sensor_msgs/msg/Imu topic '/imu'; its IMU topics"):
            recording.imu("/imu")
    assert imu.rate == pytest.approx(1000)
    assert len(imu) == 400
    assert np.median(np.linalg.norm(imu.acceleration, axis=1)) == pytest.approx(9.81, abs=0.5)


def bag_connections(*topics: str) -> list[SimpleNamespace]:
    return [SimpleNamespace(topic=t, msgtype=IMU_TYPE) for t in topics]


def test_which_topic_counts():
    def chosen(*topics: str, asked: str | None = None) -> list[str]:
        found = choose_imu(Path("a.bag"), bag_connections(*topics), "/cam/events", asked)
        return [c.topic for c in found]

    assert chosen("/cam/imu", "/robot/imu") == ["/cam/imu"]
    assert chosen("/robot/imu") == ["/robot/imu"]
    assert chosen("/cam/imu", "/robot/imu", asked="/robot/imu") == ["/robot/imu"]
    assert chosen("/cam/imu", "/cam/imu") == ["/cam/imu", "/cam/imu"]
    assert chosen() == []
    with pytest.raises(InputError, match=r"a.bag: 2 IMU topics: /a, /b; name the camera's"):
        chosen("/b", "/a")
    with pytest.raises(InputError, match="no sensor_msgs/msg/Imu topic '/c'; its IMU topics: none"):
        chosen(asked="/c")


@pytest.fixture
def ecd(tmp_path) -> Path:
    (tmp_path / "events.txt").write_text("0.5 1 1 1\n0.6 2 2 0\n")
    (tmp_path / "calib.txt").write_text("60 60 31.5 23.5 0 0 0 0 0")
    return tmp_path


def test_ecd_folder(ecd):
    with open_recording(ecd) as recording:
        assert recording.imu() is None
        (ecd / "imu.txt").write_text("0.1 1 2 3 4 5 6\n0.2 7 8 9 10 11 12\n")
        imu = recording.imu()
        with pytest.raises(InputError, match="not a bag: no IMU topic '/imu'"):
            recording.imu("/imu")
    assert imu.t.tolist() == [100_000_000, 200_000_000]
    assert imu.acceleration.tolist() == [[1, 2, 3], [7, 8, 9]]
    assert imu.angular.tolist() == [[4, 5, 6], [10, 11, 12]]


def test_file_without_an_imu(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, **{name: np.arange(3) for name in "xytp"})
    with open_recording(path) as recording:
        assert recording.imu() is None
        with pytest.raises(InputError, match="not a bag: no IMU topic '/imu'"):
            recording.imu("/imu")


class FakeDecoder:
    """The interface of the package `aedat`, with an IMU in g and deg/s."""

    def __init__(self, path: str) -> None:
        names = [f"{kind}_{axis}" for kind in ("accelerometer", "gyroscope") for axis in "xyz"]
        rows = np.zeros(3, [("t", "<u8"), ("temperature", "<f4"), *((n, "<f4") for n in names)])
        rows["t"] = [1_000_000, 1_001_000, 1_002_000]
        rows["accelerometer_z"] = 1.0
        rows["gyroscope_x"] = [0.0, 90.0, 180.0]
        events = np.zeros(2, [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
        packets = ((1, "imus", rows[:2]), (0, "events", events), (1, "imus", rows[2:]))
        self._packets = iter([{"stream_id": i, name: of} for i, name, of in packets])

    def id_to_stream(self) -> dict:
        return {0: {"type": "events", "width": 346, "height": 260}, 1: {"type": "imus"}}

    def __iter__(self):
        return self._packets


def test_aedat4_in_si_units(monkeypatch):
    monkeypatch.setitem(sys.modules, "aedat", SimpleNamespace(Decoder=FakeDecoder))
    with open_recording(AEDAT4) as recording:
        imu = recording.imu()
        assert sum(map(len, recording.event_chunks())) == 2
    assert imu.t.tolist() == [1_000_000_000, 1_001_000_000, 1_002_000_000]
    np.testing.assert_allclose(imu.angular[:, 0], [0, np.pi / 2, np.pi])
    np.testing.assert_allclose(imu.acceleration, [[0, 0, 9.80665]] * 3)


def test_aedat4_without_an_imu():
    pytest.importorskip("aedat", reason="the optional package aedat is not installed")
    with open_recording(AEDAT4) as recording:
        assert recording.imu() is None


def test_info_of_bags(calm_bag):
    info = inspect(calm_bag.data)
    [imu] = info.imu
    assert (imu.name, imu.count, imu.rate) == ("/davis/left/imu", 400, pytest.approx(1000))
    assert imu.median_acceleration_m_s2 == pytest.approx(9.81, abs=0.5)
    assert 0 < imu.largest_angular_rad_s < 2
    assert (info.truth, info.missing) == ([], [])
    assert {t["name"] for t in info.other_topics} == {"/davis/left/camera_info"}
    info = inspect(calm_bag.truth)
    depth, pose = info.truth
    assert (depth.name, depth.kind) == ("/davis/left/depth_image_rect", "depth images")
    assert depth.count == 9
    assert (pose.name, pose.kind) == (
        "/davis/left/pose",
        "poses (geometry_msgs/msg/PoseStamped)",
    )
    assert (pose.count, pose.rate) == (41, pytest.approx(100))
    assert (pose.t_first, pose.t_last) == (1.0, 1.4)


def test_info_of_an_ecd_folder_in_words(monkeypatch, capsys, ecd):
    (ecd / "imu.txt").write_text("0.1 0 0 9.8 0 3 4\n0.2 0 0 9.8 0 0 0\n")
    (ecd / "groundtruth.txt").write_text("".join(f"{k}e-1 0 0 0 0 0 0 1\n" for k in range(3, 7)))
    monkeypatch.setattr(sys, "argv", ["info", str(ecd)])
    assert main() == 0
    out = capsys.readouterr().out
    assert "groundtruth.txt  poses" in out
    assert "4 at 10 Hz" in out
    assert "angular velocity up to 5.00 rad/s  acceleration 9.8 m/s^2 (median)" in out
    # The gyroscope ends before the first event.
    assert "missing: imu.txt: does not overlap with the events in time" in out


def test_info_names_what_cannot_be_used(ecd):
    (ecd / "imu.txt").write_text("1 2 3\n")
    (ecd / "motion.txt").write_text("0 0 1\n")
    info = inspect(ecd)
    assert [(t.name, t.kind) for t in info.truth] == [("motion.txt", "constant rotation")]
    assert info.imu == []
    assert len(info.missing) == 2
    assert all("lines of 3 numbers" in line for line in info.missing)


def test_info_of_hdf5_with_two_cameras(tmp_path):
    path = tmp_path / "events.h5"
    with h5py.File(path, "w") as file:
        for side, count in (("left", 2000), ("right", 1500)):
            for name in "xyp":
                file[f"prophesee/{side}/{name}"] = np.arange(count) % 40
            file[f"prophesee/{side}/t"] = np.arange(count) * 301
    (tmp_path / "stamped_groundtruth.txt").write_text("0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n")
    info = inspect(path)
    assert [(t.name, t.type, t.events) for t in info.topics] == [
        ("prophesee/left", "hdf5", 2000),
        ("prophesee/right", "hdf5", 1500),
    ]
    [truth] = info.truth
    assert (truth.name, truth.kind, truth.count) == ("stamped_groundtruth.txt", "poses", 2)
    assert len(info.missing) == 2
    assert info.missing[0].startswith("prophesee/left: no calibration")
