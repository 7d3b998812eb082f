"""Compiled code is that of the sources as they are: in a small package with the same decorator."""

import ast
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]

SOURCES = {
    "emoflow_ros/core/limits.py": "FACTOR = 2\n",
    "emoflow_ros/core/inner.py": """
from emoflow_ros.core.numerics.jit import njit

@njit(nogil=True)
def called(x):
    return 2 * x

@njit(inline="always")
def inlined(x):
    return 2 * x
""",
    "emoflow_ros/core/outer.py": """
from emoflow_ros.core.inner import called, inlined
from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.limits import FACTOR

@njit(fastmath={"nsz"})
def calls(x):
    return called(x)

@njit()
def inlines(x):
    return inlined(x)

@njit()
def reads(x):
    return FACTOR * x
""",
    "emoflow_ros/simulation/scene.py": """
from emoflow_ros.core.inner import called
from emoflow_ros.core.numerics.jit import njit

@njit()
def draws(x):
    return 1 * called(x)
""",
    "msg_adapters/encodings/encoding.py": """
from numba import types
from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.outer import calls

@njit(types.int64(types.int64))
def decodes(x):
    return calls(x)
""",
}
NAMES = ("calls", "inlines", "reads", "draws", "decodes")

START = """
import json
import sys
from emoflow_ros.core.outer import calls, inlines, reads
from emoflow_ros.simulation.scene import draws
from msg_adapters.encodings.encoding import decodes

if "wait" in sys.argv:
    print("imported", flush=True)
    sys.stdin.readline()
functions = (calls, inlines, reads, draws, decodes)
values = {function.__name__: function(10) for function in functions}
loaded = [f.__name__ for f in functions if f.stats.cache_hits and not f.stats.cache_misses]
print(json.dumps({"values": values, "loaded": loaded}))
"""
FULL_DISK = """
from numba.core.caching import IndexDataCacheFile

def refuse(*_):
    raise OSError(28, "No space left on device")

IndexDataCacheFile._save_data = refuse
from emoflow_ros.core.outer import calls
calls(10)
"""


class Package:
    """A copy that can be edited, and started in processes of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = os.environ | {
            "PYTHONPATH": str(folder),
            # Python takes bytecode for new if size and second of its source are the same.
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": "",
            "XDG_CACHE_HOME": str(folder / "cache"),
        }
        for name, text in SOURCES.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        for name in ("emoflow_ros/__init__.py", "emoflow_ros/core/numerics/jit.py"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)

    def edit(self, name: str, old: str, new: str) -> None:
        path = self.folder / name
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))

    def begin(self, code: str, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", code, *arguments], cwd=self.folder, env=self.environment,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def start(self) -> tuple[dict[str, int], list[str]]:
        """Return the functions' values at 10, and which were loaded and not compiled."""
        return finish(self.begin(START))

    def caches(self) -> dict[Path, set[str]]:
        """Return for each of numba's folders the folders and files in it that hold code."""
        found: dict[Path, set[str]] = {}
        for index in self.folder.rglob("*.nbi"):
            versioned = index.parent.name.startswith("emoflow_ros-")
            inner = index.parent if versioned else index
            found.setdefault(inner.parent, set()).add(inner.name)
        return found


def finish(process: subprocess.Popen[str]) -> tuple[dict[str, int], list[str]]:
    output, errors = process.communicate("\n")
    assert process.returncode == 0, errors
    result: dict[str, Any] = json.loads(output.splitlines()[-1])
    return result["values"], result["loaded"]


@pytest.fixture
def package(tmp_path: Path) -> Package:
    return Package(tmp_path)


def everywhere(value: int) -> dict[str, int]:
    return dict.fromkeys(NAMES, value)


def test_edit_of_what_another_file_s_function_uses_is_seen(package: Package) -> None:
    """And without one nothing is compiled, and of the old version nothing is left."""
    assert package.start() == (everywhere(20), [])
    assert package.start() == (everywhere(20), list(NAMES))
    before = package.caches()
    package.edit("emoflow_ros/core/inner.py", "2 * x", "3 * x")
    package.edit("emoflow_ros/core/limits.py", "2", "3")
    assert package.start() == (everywhere(30), [])
    assert package.start() == (everywhere(30), list(NAMES))
    after = package.caches()
    assert before.keys() == after.keys() and len(after) == 3
    for folder in after:
        assert len(before[folder]) == len(after[folder]) == 1
        assert before[folder] != after[folder]
        assert folder.name == "__pycache__"


@pytest.mark.parametrize("place", ["chosen", "cache"])
def test_code_is_found_again_in_a_folder_elsewhere(package: Package, place: str) -> None:
    """One that the environment names, or the user's cache."""
    if place == "chosen":
        package.environment["NUMBA_CACHE_DIR"] = str(package.folder / place)
    else:  # files where folders would be: not even root can write there
        for folder in {(package.folder / name).parent for name in SOURCES}:
            (folder / "__pycache__").touch()
    assert package.start() == (everywhere(20), [])
    assert package.start() == (everywhere(20), list(NAMES))
    assert {path.relative_to(package.folder).parts[0] for path in package.caches()} == {place}


def test_other_parts_of_the_package_keep_their_code(package: Package) -> None:
    package.start()
    package.edit("emoflow_ros/simulation/scene.py", "1 * called", "7 * called")
    kept = [name for name in NAMES if name != "draws"]
    assert package.start() == (everywhere(20) | {"draws": 140}, kept)


def test_code_of_a_process_that_runs_during_the_edit_is_not_taken(package: Package) -> None:
    """Its functions are compiled from the sources that it has imported."""
    running = package.begin(START, "wait")
    assert running.stdout is not None and running.stdout.readline() == "imported\n"
    package.edit("emoflow_ros/core/inner.py", "2 * x", "3 * x")
    package.edit("emoflow_ros/core/limits.py", "2", "3")
    assert finish(running)[0] == everywhere(20)
    assert package.start()[0] == everywhere(30)


def test_disk_that_fills_up_while_code_is_written_leaves_no_old_one(package: Package) -> None:
    package.start()
    package.edit("emoflow_ros/core/inner.py", "2 * x", "3 * x")
    full = package.begin(FULL_DISK)
    assert "No space left on device" in full.communicate()[1]
    assert package.start()[0] == everywhere(30) | {"reads": 20}


def test_code_of_versions_without_folders_is_removed(package: Package) -> None:
    kept = package.folder / "emoflow_ros" / "core" / "__pycache__"
    kept.mkdir()
    for name in ("outer.calls-6.py312.nbi", "outer.calls-6.py312.1.nbc", "outer.pyc"):
        (kept / name).touch()
    package.start()
    (folder,) = package.caches()[kept]
    assert {path.name for path in kept.iterdir()} == {folder, "outer.pyc"}


def sources() -> Iterator[tuple[Path, list[ast.Import | ast.ImportFrom]]]:
    """Both packages' files, and what they import."""
    for package in ("emoflow_ros", "msg_adapters"):
        for path in (ROOT / package).rglob("*.py"):
            nodes = ast.walk(ast.parse(path.read_text()))
            yield path, [x for x in nodes if isinstance(x, ast.Import | ast.ImportFrom)]


def imported(node: ast.Import | ast.ImportFrom) -> set[str]:
    """What a statement imports, with the names of modules and of what is taken of them."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    return {f"{node.module}.{alias.name}" for alias in node.names}


def test_there_is_one_way_to_compile() -> None:
    allowed = {"numba.types", "numba.core.typing.templates.Signature", "numba.core.event"}
    found = {
        f"{path.relative_to(ROOT)}:{node.lineno}: {name}"
        for path, nodes in sources()
        if path != ROOT / "emoflow_ros" / "core" / "numerics" / "jit.py"
        for node in nodes
        for name in imported(node) - allowed
        if name.partition(".")[0] == "numba"
    }
    assert found == set()


def test_what_compiled_functions_can_use_is_in_the_hash() -> None:
    """Modules with such functions import of the package `core`, their own part and the error."""
    compiled, wrong = 0, set()
    for path, nodes in sources():
        names = {(name, node.lineno) for node in nodes for name in imported(node)}
        if "emoflow_ros.core.numerics.jit.njit" not in {name for name, _ in names}:
            continue
        compiled += 1
        parts = path.relative_to(ROOT).parts
        own = ".".join(parts[: 2 if parts[0] == "emoflow_ros" else 1])
        hashed = (f"{own}.", "emoflow_ros.core.", "emoflow_ros.errors.InputError")
        wrong |= {
            f"{path.relative_to(ROOT)}:{line}: {name}"
            for name, line in names
            if name.startswith(("emoflow_ros", "msg_adapters")) and not name.startswith(hashed)
        }
    assert compiled > 20 and wrong == set()


SAVES = """
import sys
from numba.core import caching
import emoflow_ros.core.numerics.jit

file = caching.IndexDataCacheFile(sys.argv[1], "function", "stamp")
sys.stdin.readline()
for key in range(int(sys.argv[2]), 200, 2):
    file.save(key, f"version {key}")
"""

LOADS = """
import sys
from numba.core import caching

file = caching.IndexDataCacheFile(sys.argv[1], "function", "stamp")
print([file.load(key) for key in range(200)] == [f"version {key}" for key in range(200)])
"""


def test_two_processes_may_keep_versions_of_one_function_at_once(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SAVES, str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    pipe = subprocess.PIPE
    both = [
        subprocess.Popen([*command, first], stdin=pipe, env=environment) for first in ("0", "1")
    ]
    for process in both:
        assert process.stdin is not None
        process.stdin.write(b"\n")
        process.stdin.flush()
    assert [process.wait() for process in both] == [0, 0]
    loads = [sys.executable, "-c", LOADS, str(tmp_path)]
    assert subprocess.run(loads, capture_output=True, check=True).stdout == b"True\n"
