"""What all tests share: ROS on this machine only, on a domain of each process; recordings."""

import fcntl
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:  # NumPy must find the number of threads below when it is imported
    import numpy as np
    from xdist.scheduler import LoadFileScheduling

ROOT = Path(__file__).resolve().parents[1]
MOST_WORK_S = 180.0  # of processor time, of a test

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

os.environ.setdefault("ROS_LOG_DIR", str(ROOT / ".pytest_cache" / "ros_log"))

# Each process that tests start imports hundreds of modules. Where no bytecode is wanted beside
# the sources it would compile them all, for seconds, so it finds it in a folder of the tests.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    sys.dont_write_bytecode = False
    sys.pycache_prefix = os.environ.setdefault(
        "PYTHONPYCACHEPREFIX", str(ROOT / ".pytest_cache" / "bytecode")
    )

# A shell ignores SIGINT for its background jobs, and children inherit that: tests that interrupt
# a process would wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)

# By default an example of hypothesis that takes 200 ms fails, as any does on a busy machine.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")

sys.path.insert(0, str(ROOT / "test" / "recordings"))
pytest_plugins = ["recording_fixtures"]

# Of the first process, which compiles.
_COMPILE = """
from emoflow_ros.factory import make_estimator
from emoflow_ros.node.worker import _Worker

_Worker(make_estimator)._warm_up()
"""
FIRST_PROCESS = "EMOFLOW_TESTS_FIRST_PROCESS"  # names its folder to the processes of the tests
COMPILES_NOTHING = "msg_adapters"  # tests of this folder need nothing of the estimator
_locks: list[IO[str]] = []  # open for as long as this process has the domain
_first_process: list[Any] = []  # it and its folder


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
        _locks.append(lock)
        return domain
    raise RuntimeError("all ROS domains are in use")


os.environ["ROS_DOMAIN_ID"] = str(_free_domain())


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_setupnodes() -> None:
    """Compile the estimator in one process, beside the tests that need nothing of it.

    Else each of pytest's processes would compile it. A lock is held for as long as it runs.
    """
    folder = tempfile.TemporaryDirectory(prefix="emoflow_ros_tests_")
    os.environ[FIRST_PROCESS] = folder.name
    with (Path(folder.name) / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command = [sys.executable, "-c", _COMPILE]
        process = subprocess.Popen(command, cwd=ROOT, pass_fds=[lock.fileno()])
    _first_process.extend([folder, process])


def pytest_sessionfinish() -> None:
    """Wait for it, before its folder is removed."""
    for process in _first_process[1:]:
        process.wait()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Wait until the estimator is compiled, before pytest-timeout begins to count."""
    wait_until_compiled(item)
    return (yield)


def wait_until_compiled(item: pytest.Item) -> None:
    """Wait for the first process of this run to end, unless the test needs nothing of it."""
    folder = os.environ.get(FIRST_PROCESS)
    if folder and COMPILES_NOTHING not in item.path.parts:
        with (Path(folder) / "lock").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH)


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> "LoadFileScheduling":
    """Give each process whole files, so that the fixtures of a module are made once.

    The files of `integration/` stay together: they wait for other processes most of the time, so
    that they belong beside tests that compute, and not beside one another.
    """
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return "integration" if "integration/" in nodeid else super()._split_scope(nodeid)

    config.option.loadscopereorder = False  # first come those that take the longest: see below
    return Scheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what compiles nothing, then with what takes minutes and cannot be divided."""
    first = (COMPILES_NOTHING, "integration")
    items.sort(key=lambda item: [folder not in item.path.parts for folder in first])


@contextmanager
def bounded_work(most_s: float) -> Iterator[None]:
    """Fail what takes more processor time, that of the children that end in it included."""
    before = sum(os.times()[:4])
    yield
    if (spent := sum(os.times()[:4]) - before) > most_s:
        pytest.fail(f"{spent:.3g} s of processor time, at most {most_s:g} s are allowed")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Bound the work of a test and not its time, to which a busy machine adds.

    `make test` gives pytest-timeout a limit that only a hang reaches.
    """
    with bounded_work(math.inf if item.get_closest_marker("soak") else MOST_WORK_S):
        yield


@pytest.fixture(autouse=True)
def _every_test_hears_every_line() -> None:
    from emoflow_ros.errors import say

    say.cache_clear()


@pytest.fixture(scope="session", autouse=True)
def _textures_are_painted_once() -> Iterator[None]:
    """Painting is the larger part of a short simulation, and most have one of a few seeds."""
    from emoflow_ros.simulation.textures import TextureSet, make_textures

    painted: dict[str, TextureSet] = {}

    def paint(count: int, rng: "np.random.Generator") -> TextureSet:
        key = f"{count} {rng.bit_generator.state}"
        if key not in painted:
            painted[key] = make_textures(count, rng)
        return painted[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("emoflow_ros.simulation.recording.make_textures", paint)
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real recordings; tests that need it skip without it."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings in {folder}")
    return folder
