"""The page docs/mvsec.md: its commands, with a bag shaped like MVSEC's, by rosbags' own command."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from emoflow_ros.core.types.events import Events
from emoflow_ros.readers import open_recording
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.simulation.recording_files import data_topics, write_bag
from emoflow_ros.simulation.simulated_truth import ImuModel, simulate_imu

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "mvsec.md").read_text()
COMMANDS = [
    shlex.split(command)
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    if not language
    for command in block.replace("\\\n", " ").strip().splitlines()
]
TOPIC = "/davis/left/events"


def the(program: str) -> list[str]:
    [command] = [c for c in COMMANDS if c[0] == program]
    return command


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mvsec") / "indoor_flying1_data.bag"
    recording = simulate("calm", duration_s=0.05, seed=1, fps=200, start_ns=10**18)
    encoder = MessageEncoder(ros1=True)
    imu = simulate_imu(recording.truth, recording.t_start, recording.t_end, ImuModel(), 0)
    topics = [t for t in data_topics(recording, encoder, imu) if not t.name.endswith("camera_info")]
    write_bag(path, encoder, topics, progress=False)
    return path


def read(path: Path) -> Events:
    with open_recording(path, topic=TOPIC) as recording:
        assert recording.camera is None
        return Events.concatenate(list(recording.event_chunks()))


def test_converted_bag_holds_the_same_events(bag: Path) -> None:
    program, *arguments = the("rosbags-convert")
    command = [str(Path(sys.executable).with_name(program)), *arguments]
    ran = subprocess.run(command, cwd=bag.parent, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    written, converted = read(bag), read(bag.parent / "indoor_flying1")
    assert len(written) > 1000
    for name in ("x", "y", "t", "p"):
        np.testing.assert_array_equal(getattr(converted, name), getattr(written, name))


def test_qos_file_names_the_topic_and_policies_of_rosbag2() -> None:
    [text] = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    overrides = yaml.safe_load(text)
    assert set(overrides) == {TOPIC}
    assert set(overrides[TOPIC]) == {"reliability", "durability", "history", "depth"}
    rclpy_qos = pytest.importorskip("rclpy.qos", reason="no ROS: run `make test`")
    policies = {
        "reliability": rclpy_qos.ReliabilityPolicy,
        "durability": rclpy_qos.DurabilityPolicy,
        "history": rclpy_qos.HistoryPolicy,
    }
    for policy, values in policies.items():
        assert overrides[TOPIC][policy].upper() in values.__members__
    assert overrides[TOPIC]["depth"] == 1000


def test_launch_commands_give_arguments_that_exist() -> None:
    for command in COMMANDS:
        if command[:3] != ["ros2", "launch", "emoflow_ros"]:
            continue
        file, *arguments = command[3:]
        text = (ROOT / "launch" / file).read_text()
        text += (ROOT / "launch" / "estimator.launch.py").read_text()
        for argument in arguments:
            assert f'"{argument.partition(":=")[0]}": (' in text
        assert f"events:={TOPIC}" in arguments
    assert sum(command[:2] == ["ros2", "launch"] for command in COMMANDS) == 2
