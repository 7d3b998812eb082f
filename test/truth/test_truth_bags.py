"""Ground truth read back from a simulated recording, against the simulator's exact truth."""

import numpy as np
import pytest

from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.simulation.recording import davis346, simulate
from emoflow_ros.simulation.recording_files import OutputPaths, write_recording
from emoflow_ros.truth import load_truth

START = 100 * NS_PER_S


@pytest.fixture(scope="module")
def recording():
    """0.4 s of the calm scene seen through MVSEC's lens."""
    camera = davis346("equidistant")
    return simulate("calm", duration_s=0.4, seed=3, camera=camera, fps=50, start_ns=START)


@pytest.fixture(scope="module", params=["rosbag1", "rosbag2"])
def simulated(request, recording, tmp_path_factory):
    paths = OutputPaths.within(tmp_path_factory.mktemp("sim"), "calm", request.param)
    write_recording(recording, paths, request.param)
    return recording, paths


def truth_of(paths, *files):
    with open_recording(paths.data) as recording:
        return load_truth(recording, files)


def test_velocity_from_poses(simulated):
    recording, paths = simulated
    twists = truth_of(paths, paths.truth).twists
    for t in (START + 50 * NS_PER_MS, START + 250 * NS_PER_MS, START + 333 * NS_PER_MS):
        linear, angular = recording.truth.twist(t)
        found = twists.twist(t)
        np.testing.assert_allclose(found.angular, angular, atol=np.radians(0.2))
        np.testing.assert_allclose(found.linear, linear, atol=0.005)


@pytest.mark.parametrize(("source", "share"), [("flow", 0.85), ("truth", 0.6)])
def test_displacement_over_a_window(simulated, source, share):
    """From the flow maps; and from depth and poses, where the rectified image covers less."""
    recording, paths = simulated
    t0, t1 = START + 30 * NS_PER_MS, START + 120 * NS_PER_MS
    found = truth_of(paths, getattr(paths, source)).flows.displacement(t0, t1)
    exact = recording.truth.displacement(t0, t1)
    known = found.valid & np.isfinite(exact).all(axis=-1)
    assert known.mean() > share
    error = np.linalg.norm(found.displacement - exact, axis=-1)[known]
    length = np.linalg.norm(exact, axis=-1)[known].mean()
    assert length > 2
    assert np.median(error) < 0.05 * length
    assert np.percentile(error, 90) < 0.3 * length  # edges of objects are off by a pixel


def test_flow_maps_count_before_depth(simulated):
    _, paths = simulated
    truth = truth_of(paths, paths.truth, paths.flow)
    assert paths.flow.name in truth.flows.description
    assert "pose" in truth.twists.description


def test_bag_without_poses(simulated):
    _, paths = simulated
    with pytest.raises(
        InputError,
        match=r"no geometry_msgs/msg/PoseStamped or nav_msgs/msg/Odometry topic; it holds /davis",
    ):
        truth_of(paths, paths.data)
