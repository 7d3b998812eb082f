"""ROS on this machine only, on a domain of this test run's own."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE))
os.environ["ROS_DOMAIN_ID"] = str(10 + os.getpid() % 90)

pytest.importorskip("rclpy", reason="no ROS: run `make test`")
pytest.importorskip("dvs_msgs.msg", reason="no dvs_msgs: run scripts/build_test_messages.sh")

from harness import Peer, Processes  # noqa: E402


@pytest.fixture
def peer() -> Iterator[Peer]:
    with Peer() as made:
        yield made


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as made:
        yield made
