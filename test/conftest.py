"""What all tests share: where the real recordings are, and ROS on this machine only."""

import os
import signal
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

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


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real recordings; tests that need it skip without it."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings in {folder}")
    return folder
