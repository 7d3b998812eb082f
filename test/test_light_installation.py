"""The light installation: requirements.in alone, without what is optional at run time."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from event_bags import make_events

hdf5plugin = pytest.importorskip("hdf5plugin")

ROOT = Path(__file__).resolve().parents[1]
HIDDEN = {"aedat", "cv2", "hdf5plugin", "ray", "skimage", "torch", "torchdiffeq"}
IMPORT_OF = {"opencv-python-headless": "cv2", "scikit-image": "skimage"}
# Python runs it first, in child processes, too. These packages are then not found.
HIDE = f"""
from functools import partial
from importlib.machinery import PathFinder


def find_spec(find, name, path=None, target=None):
    return None if name in {HIDDEN} else find(name, path, target)


PathFinder.find_spec = partial(find_spec, PathFinder.find_spec)
"""
NODE_TESTS = ("test_supervisor.py", "test_pipeline.py")  # its processes, and its thread
# Runs commands one after another and prints code, output and errors of each. One process for all
# of them, because most of their time is the start of Python and numba.
RUN_ALL = """
import contextlib, io, json, sys
from emoflow_ros import cli

for name, *arguments in json.load(sys.stdin):
    sys.argv = [name, *arguments]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = getattr(cli, name)()
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""
# Prints the modules that cannot be imported, and the package that each lacks.
IMPORT_ALL = """
import importlib, pkgutil
import emoflow_ros, msg_adapters

for package in (emoflow_ros, msg_adapters):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + ".", onerror=str):
        try:
            importlib.import_module(found.name)
        except ModuleNotFoundError as error:
            print(found.name, error.name)
"""
CALIBRATION = """\
image_width: 120
image_height: 90
camera_name: camera
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
camera_matrix: {rows: 3, cols: 3, data: [110, 0, 60, 0, 110, 45, 0, 0, 1]}
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("hidden")
    (folder / "sitecustomize.py").write_text(HIDE)
    path = os.pathsep.join([str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path}


def run(
    environment: dict[str, str], *arguments: str, text: str = ""
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        input=text, capture_output=True, text=True, cwd=ROOT, env=environment, check=False,
    )  # fmt: skip


def run_commands(
    environment: dict[str, str], *commands: tuple[str | Path, ...]
) -> list[tuple[int, str, str]]:
    """Code, output and errors of each command; a command is its name and its arguments."""
    done = run(environment, "-c", RUN_ALL, text=json.dumps([[*map(str, c)] for c in commands]))
    assert done.returncode == 0, done.stderr
    return [(code, out, err) for code, out, err in map(json.loads, done.stdout.splitlines())]


def write_columns(path: Path, **storage: object) -> Path:
    """An HDF5 file with columns of 2000 events, and its calibration in `calib.yaml`."""
    events = make_events(2000)
    path.with_name("calib.yaml").write_text(CALIBRATION)
    with h5py.File(path, "w") as file:
        for name, values in (("x", events.x), ("y", events.y), ("p", events.p)):
            file.create_dataset(name, data=values, chunks=(500,), **storage)
        file.create_dataset("t_offset", data=0)
        t = file.create_dataset("t", data=events.t // 1000, chunks=(500,), **storage)
        t.attrs["unit"] = "us"
    return path


def test_hidden_are_the_requirements_that_it_leaves_out_at_run_time(
    environment: dict[str, str],
) -> None:
    lines = [
        line
        for part in ("offline", "ray", "torch")
        for line in (ROOT / f"requirements-{part}.in").read_text().splitlines()
    ]
    names = {found[0] for line in lines if (found := re.match(r"[\w-]+", line))}
    assert {IMPORT_OF.get(name, name) for name in names} == HIDDEN
    found = run(
        environment,
        "-c",
        f"from importlib.util import find_spec as f\n"
        f"print([name for name in {sorted(HIDDEN)} if f(name)])",
    )
    assert found.stdout == "[]\n", found.stderr


def test_only_what_is_for_torch_cannot_be_imported(environment: dict[str, str]) -> None:
    pytest.importorskip("rclpy", reason="no ROS: run `make test`")
    found = run(environment, "-c", IMPORT_ALL)
    assert found.returncode == 0, found.stderr
    missing = dict(row.split() for row in found.stdout.splitlines())
    assert set(missing.values()) == {"torch"}
    assert {name.split(".")[:2] == ["emoflow_ros", "published"] for name in missing} == {True}


def test_commands_work_and_say_in_one_line_what_is_missing(
    environment: dict[str, str], tmp_path: Path
) -> None:
    plain = write_columns(tmp_path / "plain.h5", compression="gzip")
    packed = write_columns(tmp_path / "packed.h5", **hdf5plugin.Blosc())
    aedat4 = ROOT / "test" / "recordings" / "events.aedat4"
    bag, out = tmp_path / "calm_data.bag", tmp_path / "out"
    calib = ("--calib", tmp_path / "calib.yaml")
    photo = ("random", "--set", "texture=photo", "--out", tmp_path)
    install_torch = "install it (pip install torch torchdiffeq), or use"
    refused = {
        ("evaluate", bag, "--profile", "paper"): "method: implicit (profile paper) needs "
        f"PyTorch; {install_torch} the method lattice (profile realtime)",
        ("evaluate", bag, "--set", "estimator.device=cuda"): "estimator.device: only the profiles "
        "paper* have a device, this one runs on the processor; leave it out",
        ("evaluate", packed, *calib): f"{packed}: compressed with blosc, which the installed "
        "libraries cannot read; run 'pip install hdf5plugin'",
        ("info", aedat4): f"{aedat4}: AEDAT4 needs the package 'aedat'; run 'pip install aedat'",
        ("label", bag, "--out", tmp_path / "labels", "--ray", "local"): "--ray: Ray is not "
        "installed; run 'pip install ray'",
        ("simulate", *photo): "texture photo: scikit-image is not installed; run 'pip install "
        "scikit-image'",
    }
    works: list[tuple[str | Path, ...]] = [
        ("simulate", "calm", "--duration", "0.3", "--out", tmp_path),
        ("info", bag),
        ("info", plain),
        ("evaluate", bag, "--out", out),
    ]
    found = run_commands(environment, *works, *refused)
    for code, _, err in found[: len(works)]:
        assert code == 0, err
    lines = [err.strip().splitlines()[-1] for _, _, err in found[len(works) :]]
    assert lines == [f"error: {line}" for line in refused.values()]
    assert {code for code, _, _ in found[len(works) :]} == {2}
    assert "dvs_msgs/msg/EventArray" in found[1][1]
    assert re.search(r"\b2000\b", found[2][1]), found[2][1]
    with h5py.File(out / "estimates.h5") as file:
        assert len(file["status"]) > 2
    assert '<img src="data:image' in (out / "report.html").read_text()


def test_the_node_s_tests_pass(environment: dict[str, str]) -> None:
    pytest.importorskip("rclpy", reason="no ROS: run `make test`")
    files = [f"test/node/{name}" for name in NODE_TESTS]
    found = run(environment, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files)
    assert found.returncode == 0, found.stdout[-3000:]
    assert " passed" in found.stdout.splitlines()[-1]
