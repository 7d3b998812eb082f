"""A node under random faults: for seconds in `make test`, for `SOAK_S` seconds in `make soak`."""

import os
import signal
from pathlib import Path

import pytest
from harness import WAIT_S, Peer, Processes
from random_faults import PARAMETERS, Script
from rclpy.qos import ReliabilityPolicy

pytestmark = pytest.mark.dds

LONG_S = float(os.environ.get("SOAK_S", "3600"))


@pytest.mark.parametrize(
    "seconds", [1.0, pytest.param(LONG_S, marks=[pytest.mark.soak, pytest.mark.timeout(0)])]
)
def test_every_window_is_accounted_for_whatever_happens(
    processes: Processes, seconds: float, capsys: pytest.CaptureFixture[str]
) -> None:
    with Peer(reliability=ReliabilityPolicy.RELIABLE) as peer:
        node = processes.start_node("fake_estimators:Recorder", PARAMETERS)
        peer.connect()
        script = Script(peer, processes, node.pid, seed=16)
        script.run(seconds)
        threads, files, below, segments, memory = zip(*script.used, strict=True)
        assert max(threads) <= threads[0] + 1
        assert max(files) <= files[0] + 3
        assert set(below) == {below[0]}
        assert max(segments) <= segments[0] + 1
        assert memory[-1] < memory[len(memory) // 4] + 10
        shared = script.shared_memory()
        node.send_signal(signal.SIGINT)
        assert node.wait(WAIT_S) == 0
        assert [path for path in shared if Path(path).exists()] == []
        assert script.unexplained() == ["SIGINT: the node ends"]
    with capsys.disabled():
        if seconds == LONG_S:
            verdicts = list(script.verdicts.values())
            counts = {name: verdicts.count(name) for name in ("ok", "failed", "dropped")}
            print(f"\n{len(script.cut)} windows: {counts}; done: {dict(script.done)}")
            print(f"first and last use: {script.used[0]}, {script.used[-1]}")
            some = [round(mb) for mb in memory[:: len(memory) // 16 + 1]]
            print(f"MB of memory on the way: {some}")
