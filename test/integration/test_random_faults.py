"""A node under random faults: for seconds in `make test`, for `SOAK_S` seconds in `make soak`."""

import os
import signal
import time
from pathlib import Path

import pytest
from harness import WAIT_S, Peer, Processes
from random_faults import PARAMETERS, Script
from rclpy.qos import ReliabilityPolicy

from emoflow_ros.node.supervisor import FACTORY

pytestmark = pytest.mark.dds

LONG_S = float(os.environ.get("SOAK_S", "3600"))
REAL = ("estimator.min_events:=200",)  # in windows of a small sensor
SOAK = [pytest.mark.soak, pytest.mark.timeout(0)]


@pytest.mark.parametrize(
    ("factory", "parameters", "seconds"),
    [
        ("fake_estimators:Recorder", (), 1.0),
        pytest.param(FACTORY, REAL, LONG_S, marks=SOAK),
    ],
)
def test_every_window_is_accounted_for_whatever_happens(
    processes: Processes,
    factory: str,
    parameters: tuple[str, ...],
    seconds: float,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with Peer(reliability=ReliabilityPolicy.RELIABLE) as peer:
        node = processes.start_node(factory, (*PARAMETERS, *parameters))
        peer.connect()
        script = Script(peer, processes, node.pid, seed=16)
        began = time.monotonic()
        try:
            script.run(seconds)
        finally:
            if seconds == LONG_S and script.figures.uses:
                with capsys.disabled():
                    took, load = time.monotonic() - began, os.getloadavg()[2]
                    print(f"\n{script.figures.table(took, load, script.fates())}")
        uses = script.figures.uses
        assert max(use.threads for use in uses) <= uses[0].threads + 1
        assert max(use.files for use in uses) <= uses[0].files + 3
        assert {use.below for use in uses} == {uses[0].below}
        # The middleware maps a segment of each process that talks to the node: a subscriber that
        # leaves and the next one may be there at once, but they do not add up.
        assert max(use.segments for use in uses) <= uses[0].segments + 2
        for part, more in (("node_mb", 10), ("worker_mb", 10), ("segments", 1)):
            first, last = script.figures.quarters(part)
            assert last < first + more
        assert set(script.figures.right_again) == {"start", *script.done}
        shared = script.shared_memory()
        node.send_signal(signal.SIGINT)
        assert node.wait(WAIT_S) == 0
        assert [path for path in shared if Path(path).exists()] == []
        assert script.unexplained() == ["SIGINT: the node ends"]
