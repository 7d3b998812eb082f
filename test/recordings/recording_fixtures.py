"""Small recordings for tests of all folders, as fixtures."""

import event_bags
import pytest

from emoflow_ros.simulation.recording import davis346, simulate
from emoflow_ros.simulation.recording_files import OutputPaths, write_recording


@pytest.fixture
def make_events():
    return event_bags.make_events


@pytest.fixture(scope="session")
def calm_bag(tmp_path_factory):
    """0.4 s of the simulator's scene `calm`, as rosbag2."""
    return _simulated(tmp_path_factory, "calm")


@pytest.fixture(scope="session")
def mover_bag(tmp_path_factory):
    """0.4 s of the same scene with a box that moves by itself."""
    return _simulated(tmp_path_factory, "mover")


def _simulated(tmp_path_factory, scene: str) -> OutputPaths:
    recording = simulate(
        scene, duration_s=0.4, seed=1, camera=davis346("plumb_bob"), fps=400, start_ns=10**9
    )
    files = OutputPaths.within(tmp_path_factory.mktemp("sim"), scene, "rosbag2")
    write_recording(recording, files, "rosbag2")
    return files


@pytest.fixture
def without_page(monkeypatch):
    """Leave the page of a report empty: it takes seconds to draw; report.json and the rest stay."""
    monkeypatch.setattr("emoflow_ros.report.report_writer.render_page", lambda *_: "")


@pytest.fixture
def write_event_bag():
    return event_bags.write_event_bag
