from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from emoflow_ros.commands import simulate as executable
from emoflow_ros.core.geometry.calibration import load_calibration
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events
from emoflow_ros.readers import open_recording
from emoflow_ros.simulation.factors import draw_factors
from emoflow_ros.simulation.messages import (
    EVENT_ARRAY,
    OPTICAL_FRAME,
    POINT_CLOUD,
    MessageEncoder,
)
from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from emoflow_ros.simulation.recording_files import FORMATS, OutputPaths, write_recording
from emoflow_ros.simulation.sensor import SensorModel
from emoflow_ros.simulation.simulated_truth import PERFECT, ImuModel

# Few events, so that rosbags can make an object of each.
QUIET = SensorModel(threshold_on=1.0, threshold_off=1.0, noise_hz=0.5)


@pytest.fixture(scope="module")
def quiet() -> SimulatedRecording:
    camera = Camera(80, 60, 50.0, 51.0, 40.0, 30.0, "equidistant", (-0.04, 0.01, -0.05, 0.02))
    return simulate(
        "agile",
        duration_s=0.105,
        seed=0,
        camera=camera,
        sensor=QUIET,
        start_ns=1_500_000_000_000_000_000,
    )


@pytest.fixture(scope="module", params=FORMATS)
def written(request, quiet, tmp_path_factory) -> OutputPaths:
    paths = OutputPaths.within(tmp_path_factory.mktemp("out"), "shaky", request.param)
    write_recording(quiet, paths, request.param, imu=ImuModel(**PERFECT))
    return paths


def read(path: Path, topic: str) -> list[tuple[int, object]]:
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [
            (t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages(connections)
        ]


def stamp(message) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def test_events_read_back_column_by_column(quiet, written) -> None:
    messages = read(written.data, "/davis/left/events")
    events = [event for _, message in messages for event in message.events]
    assert len(events) == len(quiet.events) > 500
    np.testing.assert_array_equal([e.x for e in events], quiet.events.x)
    np.testing.assert_array_equal([e.y for e in events], quiet.events.y)
    times = [e.ts.sec * 1_000_000_000 + e.ts.nanosec for e in events]
    np.testing.assert_array_equal(times, quiet.events.t)
    np.testing.assert_array_equal([e.polarity for e in events], quiet.events.p)


def test_event_messages_cover_10_ms_and_arrive_when_complete(quiet, written) -> None:
    messages = read(written.data, "/davis/left/events")
    assert len(messages) == 11
    for k, (arrival, message) in enumerate(messages):
        assert stamp(message) == quiet.t_start + k * 10_000_000
        assert arrival == stamp(message) + 10_000_000
        assert (message.width, message.height) == (80, 60)
        assert message.header.frame_id == OPTICAL_FRAME


@pytest.mark.parametrize("ros1", [True, False])
@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_event_bytes_are_those_of_the_serialiser(ros1: bool, count: int) -> None:
    """Raw packing against rosbags' own, which makes an object of each event."""
    encoder, rng = MessageEncoder(ros1=ros1), np.random.default_rng(count)
    camera = Camera(80, 60, 50.0, 51.0, 40.0, 30.0)
    events = Events(
        rng.integers(0, 80, count, dtype=np.uint16),
        rng.integers(0, 60, count, dtype=np.uint16),
        1_500_000_000_123_456_000 + np.arange(count),
        rng.random(count) < 0.5,
    )
    types = encoder.typestore.types
    time = types["builtin_interfaces/msg/Time"]
    objects = [
        types["dvs_msgs/msg/Event"](
            int(x), int(y), time(*map(int, divmod(t, 1_000_000_000))), bool(p)
        )
        for x, y, t, p in zip(events.x, events.y, events.t, events.p, strict=True)
    ]
    first = {"seq": 0} if ros1 else {}
    header = types["std_msgs/msg/Header"](**first, stamp=time(7, 8), frame_id=OPTICAL_FRAME)
    message = types[EVENT_ARRAY](header, 60, 80, objects)
    serialize = encoder.typestore.serialize_ros1 if ros1 else encoder.typestore.serialize_cdr
    assert encoder.events(7_000_000_008, camera, events) == bytes(serialize(message, EVENT_ARRAY))


@pytest.mark.parametrize("bag_format", FORMATS)
def test_clouds_hold_the_same_events(quiet, bag_format: str, tmp_path) -> None:
    paths = OutputPaths.within(tmp_path, "cloud", bag_format)
    write_recording(quiet, paths, bag_format, event_type=POINT_CLOUD)
    clouds = read(paths.data, "/davis/left/events")
    assert [stamp(cloud) for _, cloud in clouds] == [
        quiet.t_start + k * 10_000_000 for k in range(11)
    ]
    with open_recording(paths.data) as recording:
        assert recording.camera == quiet.camera
        events = Events.concatenate(list(recording.event_chunks()))
    assert len(events) == len(quiet.events) > 500
    for name in ("x", "y", "t", "p"):
        np.testing.assert_array_equal(getattr(events, name), getattr(quiet.events, name))


def test_camera_info_and_calibration_file_are_the_camera(quiet, written) -> None:
    assert load_calibration(written.calibration) == quiet.camera
    _, info = read(written.data, "/davis/left/camera_info")[0]
    k, d = (info.K, info.D) if hasattr(info, "K") else (info.k, info.d)
    camera = Camera.from_intrinsic_matrix(info.width, info.height, k, info.distortion_model, d)
    assert camera == quiet.camera


def test_imu_measures_rotation_and_gravity(quiet, written) -> None:
    messages = read(written.data, "/davis/left/imu")
    assert len(messages) == 105
    for t, message in messages[::20]:
        _, angular = quiet.truth.twist(t)
        gyro, force = message.angular_velocity, message.linear_acceleration
        np.testing.assert_allclose((gyro.x, gyro.y, gyro.z), angular, atol=1e-9)
        # At rest an accelerometer shows 9.81 m/s^2 upwards, which is -y.
        world = quiet.truth.pose(t)[:3, :3] @ (force.x, force.y, force.z)
        np.testing.assert_allclose(world - quiet.truth.acceleration(t), (0, -9.81, 0), atol=1e-6)


def test_truth_bag_holds_rectified_depth_and_pose(quiet, written) -> None:
    depths = read(written.truth, "/davis/left/depth_image_rect")
    assert [stamp(m) - quiet.t_start for _, m in depths] == [0, 50_000_000, 100_000_000]
    t, image = depths[1]
    assert (image.encoding, image.step) == ("32FC1", 320)
    depth = image.data.view("<f4").reshape(60, 80)
    np.testing.assert_allclose(depth, quiet.truth.rectified().depth(t), rtol=1e-6)
    assert np.abs(depth - quiet.truth.depth(t)).max() > 0.01  # the lens makes a difference
    poses = read(written.truth, "/davis/left/pose")
    assert len(poses) == 11
    t, message = poses[7]
    position = message.pose.position
    np.testing.assert_allclose((position.x, position.y, position.z), quiet.truth.pose(t)[:3, 3])
    q = message.pose.orientation
    forward = (2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x))
    np.testing.assert_allclose(forward, quiet.truth.pose(t)[:2, 2], atol=1e-12)


def test_flow_file_is_shaped_as_mvsecs(quiet, written) -> None:
    with np.load(written.flow) as flow:
        assert set(flow) == {"timestamps", "x_flow_dist", "y_flow_dist", "moving"}
        np.testing.assert_allclose(flow["timestamps"] - 1.5e9, (0, 0.05, 0.1), atol=1e-6)
        assert flow["x_flow_dist"].shape == flow["y_flow_dist"].shape == (3, 60, 80)
        t = quiet.t_start + 50_000_000
        expected = quiet.truth.displacement(t, t + 50_000_000)
        np.testing.assert_allclose(flow["x_flow_dist"][1], expected[..., 0], atol=1e-4)
        np.testing.assert_allclose(flow["y_flow_dist"][1], expected[..., 1], atol=1e-4)
        assert flow["moving"].dtype == bool
        assert not flow["moving"].any()  # nothing moves by itself there


def test_flow_file_marks_what_moves_by_itself(mover, tmp_path) -> None:
    paths = OutputPaths.within(tmp_path, "mover", "rosbag1")
    write_recording(mover, paths, "rosbag1")
    with np.load(paths.flow) as flow:
        marked = flow["moving"]
    assert len(marked) >= 2
    for k, mask in enumerate(marked):
        truth = mover.truth.moving_mask(mover.t_start + k * 50_000_000)
        np.testing.assert_array_equal(mask, truth)
        assert 0.05 < mask.mean() < 0.2


def command(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    monkeypatch.setattr("sys.argv", ["simulate", *map(str, words)])
    return executable.main()


def test_executable_writes_refuses_and_overwrites(monkeypatch, capsys, tmp_path) -> None:
    options = ("static", "--out", tmp_path, "--name", "a", "--duration", 0.02, "--noise", 0.1)
    assert command(monkeypatch, *options) == 0
    names = {"a_data.bag", "a_gt.bag", "a_gt_flow_dist.npz", "a_calib.yaml"}
    assert {path.name for path in tmp_path.iterdir()} == names
    printed = capsys.readouterr().out
    assert "events (" in printed
    assert "20 readings of the IMU, bias of its gyro (" in printed
    before = (tmp_path / "a_data.bag").read_bytes()

    assert command(monkeypatch, *options) == 2
    assert "a_data.bag: exists already; give --force" in capsys.readouterr().err

    assert command(monkeypatch, *options, "--force", "--fps", 1) == 2
    assert (tmp_path / "a_data.bag").is_file()  # bad values cost no recording
    assert command(monkeypatch, *options, "--force") == 0
    assert (tmp_path / "a_data.bag").read_bytes() == before


def test_executable_overwrites_bags_but_no_other_folder(monkeypatch, capsys, tmp_path) -> None:
    options = ("static", "--out", tmp_path, "--duration", 0.01, "--format", "rosbag2", "--force")
    assert command(monkeypatch, *options) == 0
    assert command(monkeypatch, *options) == 0
    precious = tmp_path / "other_data"
    precious.mkdir()
    assert command(monkeypatch, *options, "--name", "other") == 2
    assert "is a folder, but not a bag" in capsys.readouterr().err
    assert precious.is_dir()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--duration", "-1"), "error: --duration: -1.0 s; give"),
        (("--fps", "1"), "error: --fps: 1; give"),
        (("--imu-rate-hz", "0"), "--imu-rate-hz: 0.0 is out of range; use 1 to 10000"),
        (("--seed", "-1"), "--seed: -1; give"),
        (("--name", "a/b"), "--name: 'a/b' is a path; give"),
        (("--start-time", "-5"), "--start-time: -5.0 s; give"),
        (
            ("--events", "PointCloud2", "--start-time", "0.5"),
            "--start-time: 0.5 s with --events PointCloud2; give 1 or more",
        ),
        (("--imu-noise", "-1"), "--imu-noise: -1.0 is out of range; use 0 to 100"),
        (("--threshold", "0"), "error: --threshold: on 0.0, off 0.0; give"),
    ],
)
def test_executable_answers_bad_values_in_one_line(
    monkeypatch, capsys, tmp_path, words, line
) -> None:
    assert command(monkeypatch, "calm", "--out", tmp_path, *words) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("error: ")
    assert line in error
    assert "\n" not in error
    assert not list(tmp_path.iterdir())


def test_executable_writes_random_recordings_and_what_was_drawn(
    monkeypatch, capsys, tmp_path
) -> None:
    fixed = ("--set", "sensor=240x180", "--set", "motion=slider", "--set", "texture=text")
    options = ("random", "--out", tmp_path, "--seed", 3, "--duration", 0.02, *fixed)
    assert command(monkeypatch, *options) == 0
    printed = capsys.readouterr().out
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "random_data.bag",
        "random_gt.bag",
        "random_gt_flow_dist.npz",
        "random_calib.yaml",
        "random_factors.yaml",
    }
    factors = yaml.safe_load((tmp_path / "random_factors.yaml").read_text())
    given = {"sensor": "240x180", "motion": "slider", "texture": "text"}
    assert factors == draw_factors(3, given).as_dict()
    assert "motion: slider" in printed
    assert load_calibration(tmp_path / "random_calib.yaml").size == (240, 180)
    assert command(monkeypatch, *options) == 2
    assert "exists already; give --force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("calm", "--set", "motion=calm"), "--set: the scene calm has no factors; use the scene"),
        (("random", "--set", "motion"), "--set: 'motion'; give FACTOR=VALUE"),
        (("random", "--set", "motoin=calm"), "unknown name 'motoin'; did you mean 'motion'?"),
        (("random", "--noise", "1"), "--noise: is not for the scene random; fix a factor"),
        (("random", "--refractory-us", "1"), "--refractory-us: is not for the scene random"),
    ],
)
def test_executable_keeps_factors_and_options_apart(
    monkeypatch, capsys, tmp_path, words, line
) -> None:
    assert command(monkeypatch, *words, "--out", tmp_path) == 2
    assert line in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
