"""MVSEC's truth in HDF5 and its own odometry."""

import h5py
import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.truth import load_truth
from emoflow_ros.truth.mvsec_truth import SmoothedOdometry, load_mvsec_truth

CAMERA = Camera(6, 4, 5.0, 5.0, 2.5, 1.5)
SPEED = 0.5


class Recorded:
    """A recording of the left camera."""

    def __init__(self, path):
        self.path, self.topic, self.camera, self.duration = path, "davis/left/events", CAMERA, None

    def event_chunks(self, since=None):
        yield Events.empty()


def write_odom(path, **columns):
    n = 4
    default = {
        "timestamps": 10 + 0.05 * np.arange(n),
        "lin_vel": np.outer(np.arange(n), (1.0, 2.0, 3.0)),
        "ang_vel": np.outer(np.arange(n), (0.1, 0.0, -0.1)),
    }
    np.savez(path, **default | columns)
    return path


def write_truth(path, *, flow=False, poses=None):
    """Poses of SPEED m/s to the right at 100 Hz, depth of 2 m."""
    times = 10 + 0.01 * np.arange(50)
    transforms = np.tile(np.eye(4), (50, 1, 1))
    transforms[:, 0, 3] = SPEED * (times - 10)
    with h5py.File(path, "w") as file:
        left = file.create_group("davis/left")
        left["pose"] = transforms if poses is None else poses
        left["pose_ts"] = times
        left["depth_image_raw"] = np.full((3, 4, 6), 2.0, np.float32)
        left["depth_image_raw_ts"] = 10 + 0.05 * np.arange(3)
        if flow:
            maps = np.zeros((3, 2, 4, 6))
            maps[:, 0], maps[:, 1] = 3.0, -1.0
            left["flow_dist"] = maps
            left["flow_dist_ts"] = 10 + 0.05 * np.arange(3)
    return path


class TestOdometry:
    def test_linear_between_the_stamps(self, tmp_path):
        twists = SmoothedOdometry(write_odom(tmp_path / "a_odom.npz"))
        twist = twists.twist(round(10.06 * NS_PER_S))
        np.testing.assert_allclose(twist.linear, [1.2, 2.4, 3.6])
        np.testing.assert_allclose(twist.angular, [0.12, 0, -0.12])
        np.testing.assert_allclose(twists.twist(10 * NS_PER_S).linear, np.zeros(3))

    @pytest.mark.parametrize("t", [9.9999, 10.1501])
    def test_nothing_outside(self, tmp_path, t):
        twists = SmoothedOdometry(write_odom(tmp_path / "a_odom.npz"))
        assert twists.twist(round(t * NS_PER_S)) is None

    @pytest.mark.parametrize(
        ("columns", "words"),
        [
            ({"lin_vel": np.zeros((3, 3))}, "differ in length"),
            ({"ang_vel": np.zeros((4, 2))}, "differ in length"),
            ({"timestamps": np.array([1.0, 3, 2, 4])}, "not increasing"),
        ],
    )
    def test_bad_files(self, tmp_path, columns, words):
        with pytest.raises(InputError, match=words):
            SmoothedOdometry(write_odom(tmp_path / "a_odom.npz", **columns))

    def test_other_files(self, tmp_path):
        path = tmp_path / "a_odom.npz"
        path.write_bytes(b"no archive")
        with pytest.raises(InputError, match="not an odometry file"):
            SmoothedOdometry(path)


class TestHdf5:
    def test_velocity_from_the_poses(self, tmp_path):
        truth = load_mvsec_truth(write_truth(tmp_path / "a_gt.hdf5"), CAMERA)
        twist = truth.twists.twist(round(10.2 * NS_PER_S))
        np.testing.assert_allclose(twist.linear, [SPEED, 0, 0], atol=1e-9)
        np.testing.assert_allclose(twist.angular, np.zeros(3), atol=1e-9)
        at = truth.poses.transform(round(10.305 * NS_PER_S))
        np.testing.assert_allclose(at[:3, 3], [0.305 * SPEED, 0, 0], atol=1e-9)

    def test_flow_from_depth(self, tmp_path):
        """-f v dt / Z."""
        truth = load_mvsec_truth(write_truth(tmp_path / "a_gt.hdf5"), CAMERA)
        flow = truth.flows.displacement(10 * NS_PER_S, round(10.05 * NS_PER_S))
        assert flow.valid.all()
        np.testing.assert_allclose(flow.displacement[..., 0], -5 * SPEED * 0.05 / 2, rtol=1e-5)

    def test_stored_flow_counts_before_depth(self, tmp_path):
        truth = load_mvsec_truth(write_truth(tmp_path / "a_gt.hdf5", flow=True), CAMERA)
        flow = truth.flows.displacement(10 * NS_PER_S, round(10.05 * NS_PER_S))
        np.testing.assert_allclose(flow.displacement[flow.valid], np.tile([3.0, -1.0], (24, 1)))
        assert "flow_dist" in truth.flows.description

    def test_other_shapes(self, tmp_path):
        path = write_truth(tmp_path / "a_gt.hdf5", poses=np.zeros((50, 7)))
        with pytest.raises(InputError, match=r"davis/left/pose of shape \(50, 7\)"):
            load_mvsec_truth(path, CAMERA)
        wide = Camera(7, 4, 5.0, 5.0, 2.5, 1.5)
        path = write_truth(tmp_path / "b_gt.hdf5")
        with pytest.raises(InputError, match=r"depth_image_raw of shape \(3, 4, 6\)"):
            load_mvsec_truth(path, wide)


def test_poses_count_before_the_smoothed_velocity(tmp_path):
    """In whatever order they are given."""
    odom = write_odom(tmp_path / "a_odom.npz")
    poses = write_truth(tmp_path / "a_gt.hdf5")
    for files in ([odom, poses], [poses, odom]):
        truth = load_truth(Recorded(tmp_path), files)
        assert "a_gt.hdf5, slope of a cubic" in truth.twists.description
        assert [source.name for source in truth.other_twists] == ["MVSEC's odometry"]
        assert len(truth.description) == 3


def test_smoothed_velocity_alone(tmp_path):
    truth = load_truth(Recorded(tmp_path), [write_odom(tmp_path / "a_odom.npz")])
    assert truth.twists.name == "MVSEC's odometry"
    assert truth.other_twists == ()
