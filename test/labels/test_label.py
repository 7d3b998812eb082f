"""The executable `label` in one process, with an estimator whose answers are known."""

import json

import h5py
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from emoflow_ros.commands import label as label_command
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.evaluation.estimates_file import read_estimates
from emoflow_ros.labels import label_chunks

MS, SECOND = 1_000_000, 1_000_000_000


class Flow:
    """(20, -10) px/s everywhere."""

    def displacement(self, t0, t1):
        return np.full((180, 240, 2), (20.0, -10.0), np.float32) * ((t1 - t0) / 1e9)


class Remembering:
    """Its answer depends on all windows since the last reset."""

    raise_at = None
    interrupt_after = None
    late = 0
    seen = ()
    status = Status.OK

    def __init__(self):
        self.memory = 0.0

    def estimate(self, window):
        type(self).seen = (*self.seen, window.t_start)
        if len(self.seen) == self.interrupt_after:
            raise KeyboardInterrupt
        if window.t_start == self.raise_at:
            raise ValueError("singular matrix")
        self.memory = 0.5 * self.memory + float(window.events.x.sum())
        return Estimate(
            window.t_start + self.late,
            window.t_end,
            (window.t_start + window.t_end) // 2,
            self.status,
            Quality(events=len(window.events), iterations=7, stop_reason="converged", warm=True),
            MotionModel.ROTATION,
            angular=np.array([self.memory, 0, 0]),
            flow=Flow(),
        )

    def reset(self):
        self.memory = 0.0


@pytest.fixture(autouse=True)
def estimator(monkeypatch):
    monkeypatch.setattr(label_chunks, "make_estimator", lambda camera, config: Remembering())
    monkeypatch.setattr(Remembering, "seen", ())
    return Remembering


@pytest.fixture
def ecd(tmp_path):
    return lambda name, **options: write_ecd(tmp_path / name, **options)


def write_ecd(path, seconds=1.0, times=None):
    """An ECD folder: one event per ms, from 1 s on."""
    path.mkdir()
    rng = np.random.default_rng(0)
    times = 1 + np.arange(round(seconds * 1000)) / 1000 if times is None else times
    lines = [f"{t:.6f} {rng.integers(240)} {rng.integers(180)} 1" for t in times]
    (path / "events.txt").write_text("\n".join(lines) + "\n")
    (path / "calib.txt").write_text("200 200 119.5 89.5 0 0 0 0 0")
    return path


def call(monkeypatch, out, *arguments):
    """Chunks of 4 windows of 50 ms and a margin of 2, unless told otherwise."""
    cut = ("--window-ms", 50, "--stride-ms", 50, "--chunk-s", 0.2, "--margin-s", 0.1)
    monkeypatch.setattr("sys.argv", ["label", *map(str, (*cut, *arguments, "--out", out))])
    return label_command.main()


def rows(path, *names):
    columns = read_estimates(path).columns
    return [columns[name].tolist() for name in names]


def test_a_recording_without_any_label_has_failed(monkeypatch, tmp_path, ecd, capsys):
    """It ends with 1, and its file is kept: it says why of each window."""
    monkeypatch.setattr(Remembering, "status", Status.TOO_FEW_EVENTS)
    path = ecd("dark")
    for more in ((), ("--resume",)):
        assert call(monkeypatch, tmp_path / "out", path, *more) == 1
        target = tmp_path / "out" / "dark.h5"
        line = f"{path}: none of its 19 windows could be estimated; {target} says why"
        assert line in capsys.readouterr().err
        assert rows(target, "status") == [["too_few_events"] * 19]


def test_file_of_a_recording(monkeypatch, tmp_path, ecd, capsys):
    assert call(monkeypatch, tmp_path / "out", ecd("spin")) == 0
    path = tmp_path / "out" / "spin.h5"
    assert f"{path}: 19 of 19 windows estimated" in capsys.readouterr().out
    assert [p.name for p in path.parent.iterdir()] == ["spin.h5"]
    (starts,) = rows(path, "t_start_ns")
    assert starts == [SECOND + k * 50 * MS for k in range(19)]
    read = read_estimates(path)
    np.testing.assert_array_equal(read.flow(18)[100, 100], np.float16([1.0, -0.5]))
    with h5py.File(path) as file:
        assert file["flow"].attrs["unit"] == "px"
        assert file["flow"].dtype == np.float16
        assert all(file[name].attrs["description"] for name in file)
        assert file["valid"].shape == (19, 180, 240)
        assert file["valid"][0].sum() == len({tuple(p) for p in pixels(tmp_path / "spin")[:50]})
        assert file["valid"][0][tuple(pixels(tmp_path / "spin")[0])]
        assert file["chunk"][:].tolist() == [0] * 4 + [1] * 4 + [2] * 4 + [3] * 4 + [4] * 3
        assert file["stop_reason"].asstr()[0] == "converged"
        assert file["iterations"][0] == 7
        assert file["warm"][:].all()
        assert file["window_events"][:].tolist() == [50] * 19
        provenance = json.loads(file.attrs["provenance"])
    assert provenance["chunks"] == {"length_s": 0.2, "margin_s": 0.1}
    assert provenance["recording"]["name"] == "spin"
    size = sum(p.stat().st_size for p in (tmp_path / "spin").iterdir())
    assert provenance["recording"]["bytes"] == size
    assert "numpy" in provenance["versions"]


def pixels(folder):
    """Row and column of every event."""
    table = np.loadtxt(folder / "events.txt")
    return [(int(y), int(x)) for _, x, y, _ in table]


def test_estimate_of_a_window_s_latest_part(monkeypatch, tmp_path, ecd):
    """It is valid where that part has events, and stays in its chunk."""
    monkeypatch.setattr(Remembering, "late", 30 * MS)
    assert call(monkeypatch, tmp_path / "out", ecd("spin")) == 0
    path = tmp_path / "out" / "spin.h5"
    assert rows(path, "t_start_ns") == [[SECOND + (k * 50 + 30) * MS for k in range(19)]]
    assert rows(path, "window_events") == [[20] * 19]
    with h5py.File(path) as file:
        for k in (0, 4):
            latest = pixels(tmp_path / "spin")[50 * k + 30 : 50 * k + 50]
            assert {tuple(map(int, p)) for p in np.argwhere(file["valid"][k])} == set(latest)


def test_margin_is_estimated_and_not_written(monkeypatch, tmp_path, ecd):
    """Chunk 1 (from 200 ms on) begins with the memory of the windows at 100 and 150 ms."""
    assert call(monkeypatch, tmp_path / "out", ecd("spin")) == 0
    sums = np.loadtxt(tmp_path / "spin" / "events.txt")[:, 1].reshape(20, 50).sum(axis=1)
    (angular,) = rows(tmp_path / "out" / "spin.h5", "angular")
    assert angular[0][0] == sums[0]
    assert angular[4][0] == sums[4] + sums[3] / 2 + sums[2] / 4
    assert angular[8][0] == sums[8] + sums[7] / 2 + sums[6] / 4
    assert len(Remembering.seen) == 19 + 4 * 2


def test_labelling_takes_one_thread(monkeypatch, tmp_path, ecd):
    threads = []

    def estimate(self, window, estimate=Remembering.estimate):
        threads.extend(pool["num_threads"] for pool in threadpool_info())
        return estimate(self, window)

    monkeypatch.setattr(Remembering, "estimate", estimate)
    with threadpool_limits(2):
        assert call(monkeypatch, tmp_path / "out", ecd("a", seconds=0.2)) == 0
        assert max(pool["num_threads"] for pool in threadpool_info()) == 2
    assert set(threads) == {1}


def test_window_that_raises_is_recorded(monkeypatch, tmp_path, ecd):
    monkeypatch.setattr(Remembering, "raise_at", SECOND + 250 * MS)
    assert call(monkeypatch, tmp_path / "out", ecd("spin")) == 0
    path = tmp_path / "out" / "spin.h5"
    (status,) = rows(path, "status")
    assert [i for i, s in enumerate(status) if s != "ok"] == [5]
    with h5py.File(path) as file:
        assert file["note"].asstr()[5].startswith("ValueError: singular matrix; traceback in ")
        assert not file["valid"][5].any()
        assert np.isnan(file["flow"][5]).all()


def test_interrupted_run_is_resumed(monkeypatch, tmp_path, ecd, capsys):
    """Of two recordings the first is whole and the second has one of five chunks."""
    inputs = ecd("a"), ecd("b")
    assert call(monkeypatch, tmp_path / "whole", *inputs) == 0
    done = Remembering.seen

    monkeypatch.setattr(Remembering, "seen", ())
    with monkeypatch.context() as patched:
        patched.setattr(Remembering, "interrupt_after", len(done) // 2 + 9)  # in its second chunk
        assert call(patched, tmp_path / "parts", *inputs) == 130
    assert "--resume continues" in capsys.readouterr().err
    left = sorted(p.relative_to(tmp_path / "parts") for p in (tmp_path / "parts").rglob("*.*"))
    assert list(map(str, left)) == ["a.h5", "b.parts", "b.parts/000000.h5"]

    kept = (tmp_path / "parts" / "a.h5").stat().st_mtime_ns
    monkeypatch.setattr(Remembering, "seen", ())
    assert call(monkeypatch, tmp_path / "parts", *inputs, "--resume") == 0
    assert Remembering.seen == done[len(done) // 2 + 4 :]  # without a, and b's first chunk
    assert (tmp_path / "parts" / "a.h5").stat().st_mtime_ns == kept
    assert f"{tmp_path / 'parts' / 'a.h5'}: there already\n" in capsys.readouterr().out
    whole, parts = (tmp_path / name / "b.h5" for name in ("whole", "parts"))
    assert rows(parts, "t_start_ns", "angular") == rows(whole, "t_start_ns", "angular")
    assert not list((tmp_path / "parts").glob("*.parts"))


def interrupt(monkeypatch, out, path):
    with monkeypatch.context() as patched:
        patched.setattr(Remembering, "interrupt_after", 10)
        assert call(patched, out, path) == 130


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        (("--set", "estimator.max_events=2000"), "another configuration"),
        (("--margin-s", "0.15"), "another chunks"),
        (("--time-unit", "s"), "another columns"),
    ],
)
def test_resumption_of_another_run_is_refused(monkeypatch, tmp_path, ecd, capsys, changed, what):
    path = ecd("a")
    out = tmp_path / "out"
    interrupt(monkeypatch, out, path)
    assert call(monkeypatch, out, path, "--resume", *changed) == 1
    assert f"of a run with {what}; leave --resume out" in capsys.readouterr().err
    assert call(monkeypatch, out, path, *changed) == 0
    assert call(monkeypatch, out, path, "--resume") == 1  # the finished file, too
    assert f"a.h5: of a run with {what}" in capsys.readouterr().err


def test_chunks_of_an_earlier_version_are_not_resumed(monkeypatch, tmp_path, ecd, capsys):
    path = ecd("a")
    interrupt(monkeypatch, tmp_path / "out", path)
    with h5py.File(tmp_path / "out" / "a.parts" / "000000.h5", "r+") as file:
        del file["window_events"]
    assert call(monkeypatch, tmp_path / "out", path, "--resume") == 1
    words = "000000.h5: without window_events, as of an earlier version; leave --resume out"
    assert words in capsys.readouterr().err


def test_recording_that_changed_is_not_resumed(monkeypatch, tmp_path, ecd, capsys):
    path = ecd("a")
    interrupt(monkeypatch, tmp_path / "out", path)
    with (path / "events.txt").open("a") as file:
        file.write("2.0 1 1 1\n")
    assert call(monkeypatch, tmp_path / "out", path, "--resume") == 1
    assert "of a run with another recording" in capsys.readouterr().err


def test_recordings_that_fail_do_not_cost_the_others(monkeypatch, tmp_path, ecd, capsys):
    """Missing; without calibration; too short; damaged where only one of its chunks sees it."""
    monkeypatch.setattr("emoflow_ros.readers.ecd._CHUNK_BYTES", 400)
    times = 1 + np.arange(3000) / 1000
    times[500:700] -= 1
    bad = ecd("unsorted", times=times), ecd("short", seconds=0.04), tmp_path / "none", ecd("blind")
    (bad[3] / "calib.txt").unlink()
    assert call(monkeypatch, tmp_path / "out", ecd("a"), *bad, ecd("b")) == 1
    assert sorted(p.name for p in (tmp_path / "out").glob("*.h5")) == ["a.h5", "b.h5"]
    shown = capsys.readouterr().err
    assert "4 of 6 recordings could not be labelled:" in shown
    listed = shown.partition("could not be labelled:")[2]
    reasons = ("back for good", "39.0 ms, less than one window", "no such file", "no camera")
    for path, reason in zip(bad, reasons, strict=True):
        (line,) = [line for line in listed.splitlines() if line.startswith(f"  {path}: ")]
        assert reason in line
        assert line.count(f"{path}: ") == 1
    assert len(list((tmp_path / "out" / "unsorted.parts").glob("*.h5"))) == 2  # before the damage
