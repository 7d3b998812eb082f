"""The other end of the node, and nodes that several tests use."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE))

pytest.importorskip("rclpy", reason="no ROS: run `make test`")
pytest.importorskip("dvs_msgs.msg", reason="no dvs_msgs: run scripts/build_test_messages.sh")

from harness import Peer, Processes  # noqa: E402
from shared_node import SharedNode  # noqa: E402

from emoflow_ros.node.supervisor import FACTORY  # noqa: E402


@pytest.fixture
def peer() -> Iterator[Peer]:
    with Peer() as made:
        yield made


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as made:
        yield made


@pytest.fixture(scope="module")
def recorder_node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedNode]:
    with Processes(tmp_path_factory.mktemp("shared")) as made:
        yield SharedNode(made, "fake_estimators:Recorder", "window.duration_ms:=10.0")


@pytest.fixture
def recorder(recorder_node: SharedNode, peer: Peer) -> Iterator[SharedNode]:
    """The node with the fake estimator `Recorder`; for the test to `start`, before `peer` ends."""
    yield recorder_node
    recorder_node.stop()


@pytest.fixture(scope="module")
def real_node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedNode]:
    with Processes(tmp_path_factory.mktemp("real")) as made:
        # The machine may be busy: windows wait, and a slow worker is none that hangs.
        patience = ("input.queue_windows:=50", "output.timeout_s:=600.0")
        yield SharedNode(made, FACTORY, *patience)


@pytest.fixture
def node(real_node: SharedNode, peer: Peer) -> Iterator[SharedNode]:
    """The node with the real estimator; for the test to `start`, before `peer` ends."""
    yield real_node
    real_node.stop()
