"""`label` on a cluster of several workers: nothing lost and nothing twice, whoever dies."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from emoflow_ros.commands import label as label_command
from emoflow_ros.commands.label import ray_workers
from emoflow_ros.core.types.events import WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.estimates_file import read_estimates
from emoflow_ros.readers import open_recording

ROOT = Path(__file__).parents[2]
WHOLE = ("--set", "window.max_displacement_px=0")
POLICY = WindowPolicy(duration_ms=60.0, stride_ms=20.0)
CUT = ("--window-ms", 60, "--stride-ms", 20, "--chunk-s", 0.06, "--margin-s", 0.02, *WHOLE)


@pytest.fixture(scope="module")
def cluster():
    """Address of a cluster of 3 workers on this machine."""
    import ray

    with ray_workers("local", 3):
        yield ray.get_runtime_context().gcs_address


def arguments(bag, out, *more):
    return [str(a) for a in (bag.data, *CUT, "--out", out, *more)]


def writers(folder: Path) -> list[int]:
    """Processes that are writing a chunk in the folder."""
    found = []
    for descriptor in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            file = Path(os.readlink(descriptor))
        except OSError:
            continue
        if file.parent == folder and file.suffix == ".partial":
            found.append(int(descriptor.parts[2]))
    return found


class Killer(threading.Thread):
    """Kills the first process that is writing a chunk once another chunk is finished."""

    def __init__(self, folder: Path) -> None:
        super().__init__(daemon=True)
        self._folder = folder
        self._over = threading.Event()
        self.killed: list[int] = []

    def run(self) -> None:
        while not self._over.wait(0.01):
            if any(self._folder.glob("*.h5")) and (found := writers(self._folder)):
                os.kill(found[0], signal.SIGKILL)
                self.killed.append(found[0])
                return

    def stop(self) -> None:
        self._over.set()
        self.join()


def test_labels_are_the_same_although_a_worker_is_killed(monkeypatch, tmp_path, calm_bag, cluster):
    monkeypatch.setattr("sys.argv", ["label", *arguments(calm_bag, tmp_path / "serial")])
    assert label_command.main() == 0

    killer = Killer(tmp_path / "ray" / f"{calm_bag.data.name}.parts")
    killer.start()
    command = [sys.executable, "-m", "emoflow_ros.commands.label"]
    options = arguments(calm_bag, tmp_path / "ray", "--ray", cluster)
    done = subprocess.run(
        [*command, *options], capture_output=True, text=True, cwd=ROOT, check=False
    )
    killer.stop()
    assert done.returncode == 0, done.stderr
    assert len(killer.killed) == 1

    (serial,) = (tmp_path / "serial").iterdir()
    (on_ray,) = (tmp_path / "ray").iterdir()  # and no parts
    assert_same(on_ray, serial)
    with open_recording(calm_bag.data) as recording:
        slicer = WindowSlicer(POLICY)
        starts = [w.t_start for e in recording.event_chunks() for w in slicer.push(e)]
    assert read_estimates(on_ray).columns["t_start_ns"].tolist() == starts


def assert_same(path: Path, other: Path) -> None:
    """Every bit of the labels; times of computation are measured."""
    with h5py.File(path) as a, h5py.File(other) as b:
        assert dict(a.attrs) == dict(b.attrs)
        assert set(a) == set(b)
        for name in set(a) - {"runtime_s"}:
            np.testing.assert_array_equal(a[name][:], b[name][:], err_msg=name)
        assert a["flow"][:].tobytes() == b["flow"][:].tobytes()
        assert len(np.unique(a["chunk"])) > 4
        assert (a["status"].asstr()[:] == "ok").all()


class FakeRay:
    """Stands for the module: does a job at once, when it is asked for its result."""

    class exceptions:  # noqa: N801
        class RayError(Exception):
            pass

    def __init__(self) -> None:
        self.refuses = ""
        self.lost: tuple[str, ...] = ()
        self.started: dict[str, Any] = {}
        self.flying = self.most = 0

    def init(self, address, **options):
        self.started = {"address": address, **options}
        if self.refuses:
            raise ConnectionError(self.refuses)

    def cluster_resources(self):
        return {"CPU": 5.0}

    def shutdown(self):
        self.started = {}

    def remote(self, **options):
        assert options == {"max_retries": 3}
        return lambda function: SimpleNamespace(remote=self._start)

    def _start(self, job):
        self.flying += 1
        self.most = max(self.most, self.flying)
        return job

    def wait(self, refs):
        return [refs[-1]], refs[:-1]

    def get(self, job):
        self.flying -= 1
        if job in self.lost:
            raise self.exceptions.RayError("died\nunexpectedly")
        return ""


@pytest.fixture
def fake(monkeypatch):
    fake = FakeRay()
    monkeypatch.setitem(sys.modules, "ray", fake)
    return fake


@pytest.mark.parametrize(("count", "most"), [(2, 2), (None, 5)])
def test_no_more_jobs_fly_than_wanted(fake, count, most):
    with ray_workers("10.0.0.1:6379", count) as run:
        assert fake.started["address"] == "10.0.0.1:6379"
        assert "num_cpus" not in fake.started
        done = list(run(f"job{k}" for k in range(12)))
    assert sorted(done) == sorted((f"job{k}", "") for k in range(12))
    assert fake.most == most
    assert fake.started == {}


def test_job_whose_workers_keep_dying(fake):
    fake.lost = ("b",)
    with ray_workers("local", 1) as run:
        assert dict(run("abc")) == {
            "a": "",
            "b": "the worker was lost (died unexpectedly)",
            "c": "",
        }


def test_no_cluster_at_the_address(fake):
    fake.refuses = "Failed to connect\nto it"
    with (
        pytest.raises(InputError, match=r"--ray x:1: no cluster \(Failed to connect\); give"),
        ray_workers("x:1", None),
    ):
        pass
