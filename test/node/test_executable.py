"""Signals at every stage of a process, and twice, as Ctrl-C in ros2 launch sends them."""

import signal
import subprocess
import sys
import time

import psutil
import pytest

IMPORTING = """
import time
from emoflow_ros.node.executable import Ending
ending = Ending()
print("now", flush=True)
time.sleep(60)
"""
STARTING = """
import threading, time
from emoflow_ros.node.executable import Ending
ending, end = Ending(), threading.Event()
ending.imported()
print("now", flush=True)
time.sleep(0.3)
ending.in_order(end.set)
print("ended in order", end.wait(60))
"""
RUNNING = """
import threading
from emoflow_ros.node.executable import Ending
ending, end = Ending(), threading.Event()
ending.imported()
ending.in_order(end.set)
print("now", flush=True)
print("ended in order", end.wait(60))
"""
HANGING = """
import multiprocessing, time
import emoflow_ros.node.executable as module
module._GRACE_S = 0.2
ending = module.Ending()
ending.imported()
child = multiprocessing.get_context("fork").Process(target=time.sleep, args=(60,))
child.start()
print("now", child.pid, flush=True)
time.sleep(60)
"""
COMMAND = """
import time
from emoflow_ros.cli import run
def command():
    try:
        print("now", flush=True)
        time.sleep(60)
    finally:
        time.sleep(0.3)
        print("cleaned up")
raise SystemExit(run(command))
"""


def interrupted(code: str, *signals: signal.Signals) -> tuple[int, str, str]:
    """Exit code, standard output and error of a process that gets these signals, 20 ms apart."""
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    first = process.stdout.readline()
    assert first.startswith("now")
    for wish in signals:
        process.send_signal(wish)
        time.sleep(0.02)
    output, error = process.communicate()
    return process.returncode, first + output, error


@pytest.mark.parametrize("wish", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("code", "said"),
    [(IMPORTING, ""), (STARTING, "ended in order True\n"), (RUNNING, "ended in order True\n")],
)
def test_two_signals_at_any_stage_end_in_one_line_and_code_0(
    code: str, said: str, wish: signal.Signals
) -> None:
    assert interrupted(code, wish, wish) == (0, f"now\n{said}", f"{wish.name}: the node ends\n")


def test_process_that_does_not_end_in_order_is_ended_with_its_children() -> None:
    code, output, error = interrupted(HANGING, signal.SIGINT)
    assert (code, error) == (0, "SIGINT: the node ends\n")
    child = int(output.split()[1])
    deadline = time.monotonic() + 600
    while psutil.pid_exists(child):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_second_ctrl_c_of_a_command_does_not_disturb_the_first() -> None:
    signals = (signal.SIGINT, signal.SIGINT, signal.SIGINT)
    assert interrupted(COMMAND, *signals) == (130, "now\ncleaned up\n", "interrupted\n")


@pytest.mark.parametrize("name", ["replay", "evaluate", "simulate", "info", "label"])
def test_command_interrupted_in_its_imports_ends_in_one_line(name: str) -> None:
    code = f"""
import sys, time
class Slow:
    def find_spec(self, name, path, target=None):
        if name in ("numpy", "rclpy"):
            print("now", flush=True)
            time.sleep(60)
sys.meta_path.insert(0, Slow())
from emoflow_ros.cli import {name}
raise SystemExit({name}())
"""
    assert interrupted(code, signal.SIGINT, signal.SIGINT) == (130, "now\n", "interrupted\n")
