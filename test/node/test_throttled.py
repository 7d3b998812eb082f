"""Log lines that are throttled: by steady time, all of them."""

import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.impl.rcutils_logger import Throttle

from emoflow_ros.node.throttled import throttled

NODE = Path(__file__).resolve().parents[2] / "emoflow_ros" / "node"


def test_host_clock_that_is_set_back_silences_no_line() -> None:
    clock = throttled()["throttle_time_source_type"]
    assert isinstance(clock, Clock)
    assert clock.clock_type is ClockType.STEADY_TIME
    ahead_s = clock.now().nanoseconds / 1e9 - time.monotonic()
    assert ahead_s == pytest.approx(3600, abs=1.0)  # the first line, also right after booting


def test_line_comes_again_after_its_time() -> None:
    context = {"throttle_last_logged": 0, **throttled(30.0)}
    assert Throttle.should_log(context)
    assert not Throttle.should_log(context)
    context["throttle_last_logged"] -= 31 * 10**9
    assert Throttle.should_log(context)


def test_no_line_is_throttled_by_another_clock() -> None:
    others = [f.name for f in NODE.glob("*.py") if "throttle_duration_sec" in f.read_text()]
    assert others == ["throttled.py"]
