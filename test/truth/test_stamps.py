"""Truth whose stamps come twice: the first of each counts, and how many are left out is said."""

import numpy as np
import pytest
from rosbags import rosbag1

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.text_tables import read_imu_text
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.truth.bag_truth import load_bag_truth
from emoflow_ros.truth.flow_maps import PropagatedFlow
from emoflow_ros.truth.mvsec_truth import SmoothedOdometry
from emoflow_ros.truth.text_truth import load_poses, read_poses

CAMERA = Camera(8, 6, 6.0, 6.0, 4.0, 3.0)
N = 200  # poses at 200 Hz, 2 m/s to the right


def rows(digits: int = 9, twice: tuple[int, ...] = ()) -> list[str]:
    """Lines of poses; those in `twice` come again, somewhere else."""
    lines = []
    for k in range(N):
        lines.append(f"{5 + k / N:.{digits}f} {2 * k / N} 0 0 0 0 0 1")
        if k in twice:
            lines.append(f"{5 + k / N:.{digits}f} -77 0 0 0 0 0 1")
    return lines


def assert_velocity(truth, x: float = 2.0, atol: float = 1e-6) -> None:
    twist = truth.twists.twist(round(5.5 * NS_PER_S))
    np.testing.assert_allclose(twist.linear, [x, 0, 0], atol=atol)


def test_text(tmp_path, capsys):
    path = tmp_path / "poses.txt"
    path.write_text("\n".join(rows(twice=(3, 100, 101))))
    assert_velocity(load_poses(path, CAMERA))
    line = f"{path}: 3 of 203 rows left out, whose stamps come twice\n"
    assert capsys.readouterr().err == line


def test_stamps_of_few_digits(tmp_path, capsys):
    path = tmp_path / "poses.txt"
    path.write_text("\n".join(rows(digits=2)))
    track = read_poses(path)
    assert len(track.stamps) == 101  # of 0.01 s each
    assert_velocity(load_poses(path, CAMERA), atol=0.01)
    assert "99 of 200 rows left out" in capsys.readouterr().err
    path.write_text("\n".join("1.50466e+09 0 0 0 0 0 0 1" for _ in range(9)))
    with pytest.raises(InputError) as error:
        read_poses(path)
    assert str(error.value) == (
        f"{path}: all 9 stamps are 1504660000.000000 s; write them with more digits"
    )


def test_bag(tmp_path, capsys):
    encoder = MessageEncoder(ros1=True)
    path = tmp_path / "gt.bag"
    with rosbag1.Writer(path) as writer:
        name = "geometry_msgs/msg/PoseStamped"
        connection = writer.add_connection("/cam/pose", name, typestore=encoder.typestore)
        for line in rows(twice=(3, 100)):
            t, x = (float(word) for word in line.split()[:2])
            stamp, pose = round(t * NS_PER_S), np.eye(4)
            pose[0, 3] = x
            writer.write(connection, stamp, encoder.pose(stamp, pose))
    assert_velocity(load_bag_truth(path, CAMERA, "/cam"))
    line = f"{path} /cam/pose: 2 of 202 rows left out, whose stamps come twice\n"
    assert capsys.readouterr().err == line


def test_imu_of_a_text_file(tmp_path, capsys):
    path = tmp_path / "imu.txt"
    path.write_text("1.0 0 0 9 1 0 0\n1.0 0 0 9 8 0 0\n1.1 0 0 9 2 0 0\n")
    imu = read_imu_text(path)
    assert imu.t.tolist() == [10**9, 1_100_000_000]
    assert imu.angular[:, 0].tolist() == [1.0, 2.0]
    assert "1 of 3 rows left out" in capsys.readouterr().err


def test_odometry(tmp_path, capsys):
    path = tmp_path / "a_odom.npz"
    velocity = np.arange(4.0)[:, None] * (1.0, 0, 0)
    np.savez(path, timestamps=[1.0, 2, 2, 3], lin_vel=velocity, ang_vel=velocity)
    odometry = SmoothedOdometry(path)
    assert odometry.twist(1_500_000_000).linear.tolist() == [0.5, 0, 0]
    assert odometry.twist(2_500_000_000).linear.tolist() == [2.0, 0, 0]
    assert "1 of 4 rows left out" in capsys.readouterr().err


class Maps:
    """Map i moves every pixel by i + 1 px to the right."""

    stamps = np.array([0, 100, 100, 200], np.int64)
    name = "maps"

    def read(self, index):
        return np.full((6, 8, 2), (index + 1.0, 0.0), np.float32)

    def moving(self, index):
        return None


def test_flow_maps_lead_from_the_last_of_a_stamp_to_the_next(capsys):
    flow = PropagatedFlow(Maps())
    assert flow.stamps.tolist() == [0, 100, 200]
    found = flow.displacement(0, 200)
    assert found.valid[0, 0]
    assert found.displacement[0, 0].tolist() == [4.0, 0.0]  # 1 and 3
    assert capsys.readouterr().err == "maps: 1 of 4 rows left out, whose stamps come twice\n"
