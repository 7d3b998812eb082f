"""ROS on this machine only, on a domain of this test run's own."""

import fcntl
import os
import socket
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE))

_LOCKS: list[IO[str]] = []  # open for as long as this process has the domain


def _free_domain() -> int:
    """Find a domain without participants: the port of a first one (DDSI-RTPS 9.6.2.4) is free.

    Another run of the tests may have found it, too, and have no participant yet: it is locked.
    """
    for attempt in range(90):
        domain = 10 + (os.getpid() + attempt) % 90
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10))
            except OSError:
                continue
        try:
            lock = (Path(tempfile.gettempdir()) / f"emoflow_ros_domain_{domain}.lock").open("w")
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            continue
        _LOCKS.append(lock)
        return domain
    raise RuntimeError("all ROS domains are in use")


os.environ["ROS_DOMAIN_ID"] = str(_free_domain())

pytest.importorskip("rclpy", reason="no ROS: run `make test`")
pytest.importorskip("dvs_msgs.msg", reason="no dvs_msgs: run scripts/build_test_messages.sh")

from harness import Peer, Processes  # noqa: E402
from shared_node import SharedNode  # noqa: E402


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
