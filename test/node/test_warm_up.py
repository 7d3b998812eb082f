"""The worker's warm-up: nothing is left to compile or to load when real events come."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMPILED = """
import pkgutil
from importlib import import_module

from numba.core.dispatcher import Dispatcher

import emoflow_ros.core


def compiled():
    return {
        f"{module}.{name}": len(value.signatures)
        for _, module, _ in pkgutil.walk_packages(emoflow_ros.core.__path__, "emoflow_ros.core.")
        for name, value in vars(import_module(module)).items()
        if isinstance(value, Dispatcher)
    }
"""


SCRIPT = f"""{COMPILED}
from emoflow_ros.config import load_config
from emoflow_ros.core.types.events import NS_PER_MS, SLICE_MS, WindowSlicer
from emoflow_ros.factory import make_estimator
from emoflow_ros.core.products.present_motion import PresentMotion
from emoflow_ros.node.worker import _Worker
from emoflow_ros.simulation.recording import simulate

assert _Worker(make_estimator)._warm_up().keys() == {{"compiled"}}
before = compiled()
assert before["emoflow_ros.core.front_end.appearance_kernels.cut_shaped"]  # that a turn needs
config = load_config()
for scene in ("calm", "rotation"):
    recording = simulate(scene, duration_s=0.9, seed=0)
    estimator = make_estimator(recording.camera, config)
    present = PresentMotion(recording.camera, config.estimator)
    windows = WindowSlicer(config.window).push(recording.events)
    ok = moved = 0
    for window in windows:
        estimate = estimator.estimate(window)
        present.know(estimate)
        ok += estimate.status == "ok"
        slice_start = window.t_end - int(SLICE_MS * NS_PER_MS)
        moved += present.estimate(window.since(slice_start)) is not None
    assert len(windows) > 8 and ok > 5 and moved > 5 and sum(before.values()) > 20
print([name for name, count in compiled().items() if count > before[name]])
"""


WARM_UP = """
from emoflow_ros.factory import make_estimator
from emoflow_ros.node.worker import _Worker
print(_Worker(make_estimator)._warm_up())
"""


def run(script):
    path = os.pathsep.join(
        p for p in (str(Path(__file__).parent), os.environ.get("PYTHONPATH")) if p
    )
    environment = os.environ | {"PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_real_windows_meet_nothing_that_is_not_compiled():
    assert run(SCRIPT) == "[]"


def test_the_next_worker_finds_everything_compiled():
    """Else each start would compile twice, and keep the compiler's memory."""
    run(WARM_UP)
    assert run(WARM_UP) == "{'compiled': False}"


PRELOADED = f"""{COMPILED}
import emoflow_ros.node.preloaded
from emoflow_ros.factory import make_estimator
from emoflow_ros.node.warm_up import warm_up

before = compiled()
warm_up(make_estimator)
print(sum(before.values()) > 20, sum(compiled().values()) > sum(before.values()))
"""


def test_workers_are_forked_from_a_process_that_has_loaded_what_is_compiled() -> None:
    run(WARM_UP)
    assert run(PRELOADED) == "True False"


REFUSED = f"""{COMPILED}
before = compiled()  # some functions are compiled where they are imported
import emoflow_ros.node.preloaded
print(sum(before.values()) > 5, compiled() == before)
"""


def test_process_that_workers_are_forked_from_compiles_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert run(REFUSED) == "True True"


KILLED = """
import os, signal, psutil
from supervisor_bench import Bench

b = Bench("emoflow_ros.factory:make_estimator")
b.supervisor.start()
b.put()
b.result()
os.kill(b.supervisor.pid, signal.SIGKILL)
assert "signal 9" in b.loss().reason
b.put()
b.result()
memory = psutil.Process(b.supervisor.pid).memory_full_info()
print(memory.uss // 2**20, memory.rss // 2**20)
b.supervisor.stop()
"""


def test_worker_shares_the_estimator_with_the_next_one() -> None:
    """Loaded by each for itself, code and libraries take 90 MB, and 0.3 s of a core."""
    own, resident = map(int, run(KILLED).split())
    assert own < 50
    assert resident > 100


THREADS = """
from dataclasses import asdict

from threadpoolctl import threadpool_info, threadpool_limits

from emoflow_ros.config import Config
from emoflow_ros.factory import make_estimator
from emoflow_ros.node.warm_up import WARM_UP_CAMERA
from emoflow_ros.node.worker import _Worker


def threads():
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


worker = _Worker(make_estimator)
worker._warm_up()
threadpool_limits(2, "blas")
before = threads()
request = {"kind": "configure", "camera": asdict(WARM_UP_CAMERA), "config": Config().flat()}
print(worker.answer(request, {})[0], before, threads())
"""


def test_the_linear_algebra_of_a_worker_has_one_thread():
    """Else its second thread waits busily between the small products, on a core of its own."""
    assert run(THREADS) == "{} {2} {1}"
