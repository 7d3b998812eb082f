"""Recordings in MVSEC's formats through its protocols, against plain loops."""

import json
import math
import shutil

import h5py
import numpy as np
import pytest
from known import ANGULAR, LINEAR, START, Known, KnownMotion, errors_of, velocity
from synthetic import (
    Plane,
    flow_maps,
    write_flow_npz,
    write_mvsec_bags,
    write_mvsec_hdf5,
    write_odom_npz,
)

from emoflow_ros.commands.evaluate import main
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, WindowPolicy
from emoflow_ros.evaluation.benchmark_sequences import SEQUENCES, BenchmarkSequence
from emoflow_ros.evaluation.protocols import make_plan
from emoflow_ros.evaluation.recording_options import Source
from emoflow_ros.evaluation.summary import summarise, summarise_by_truth
from emoflow_ros.evaluation.window_run import evaluate
from emoflow_ros.truth import load_truth

FRAMES = [START + (20 + 50 * k) * NS_PER_MS for k in range(10)]
STAMPS = [START + (7 + 50 * k) * NS_PER_MS for k in range(11)]
ROWS, FIRST, LAST, CLIP = 193, 1, 3, 3000


@pytest.fixture(scope="module")
def world():
    camera = SEQUENCES["outdoor_day1"].camera
    return Plane(camera, START, START + 600 * NS_PER_MS, ANGULAR, LINEAR)


@pytest.fixture(scope="module")
def mvsec(tmp_path_factory, world):
    """Both forms of a recording, and the arrays in the files."""
    folder = tmp_path_factory.mktemp("mvsec")
    flow = flow_maps(world, STAMPS)
    return {
        "bag": write_mvsec_bags(folder, "synthetic", world, FRAMES, STAMPS),
        "hdf5": write_mvsec_hdf5(folder, "synthetic", world, FRAMES, STAMPS),
        "npz": write_flow_npz(folder / "synthetic_gt_flow_dist.npz", STAMPS, flow),
        "flow": flow,
        "odom_path": folder / "synthetic_odom.npz",
        "odom": write_odom_npz(folder / "synthetic_odom.npz", world, STAMPS),
        "events": world.events,
    }


def sequence(camera: Camera) -> BenchmarkSequence:
    return BenchmarkSequence("synthetic", camera, FIRST, LAST, rows=ROWS, clip_events=CLIP)


class Latest(Known):
    """Estimates only the last 70 ms of each window, as windows by motion do."""

    def estimate(self, window):
        return super().estimate(window.since(window.t_end - 70 * NS_PER_MS))


def run_mvsec(mvsec, world, form: str, protocol: str, policy: str, *more, estimator=Known):
    data, truth = mvsec[form]
    chosen = sequence(world.camera)
    with Source(data, sequence=chosen).open() as recording:
        files = [truth, mvsec["npz"], mvsec["odom_path"], *more]
        known = load_truth(recording, files)
        plan = make_plan(protocol, recording, known, WindowPolicy(), chosen, clips=policy)
        return plan, evaluate(recording, estimator(world.camera), plan.slicer, plan.truth)


def carried(flow, x, y, t0, t1):
    """Follow a pixel through the maps; None where it leaves them or nothing is known."""
    height, width = flow.shape[1:3]
    at_x, at_y = float(x), float(y)
    for i in range(len(STAMPS) - 1):
        overlap = min(STAMPS[i + 1], t1) - max(STAMPS[i], t0)
        if overlap <= 0:
            continue
        column, row = round(at_x), round(at_y)
        if not (0 <= column < width and 0 <= row < height):
            return None
        u, v = flow[i, row, column]
        if u == 0 and v == 0:
            return None
        at_x += u * overlap / (STAMPS[i + 1] - STAMPS[i])
        at_y += v * overlap / (STAMPS[i + 1] - STAMPS[i])
    return at_x - x, at_y - y


def slow_mvsec(events: Events, flow, step: int):
    """(interval, EPE, %Out, AE, pixels) per frame, one pixel at a time."""
    rows = []
    for i in range(FIRST, LAST + 1):
        t0, t1 = FRAMES[i], FRAMES[i + step]
        pixels = set()
        for x, y, t in zip(events.x.tolist(), events.y.tolist(), events.t.tolist(), strict=True):
            if t0 <= t < t1 and y < ROWS:
                pixels.add((x, y))
        epe, angle = [], []
        for x, y in pixels:
            true = carried(flow, x, y, t0, t1)
            if true is None or true[0] == 0 or true[1] == 0:
                continue
            u, v = velocity(((t0 + t1) / 2 - START) / NS_PER_S, x, y)
            seconds = (t1 - t0) / NS_PER_S
            e, a = errors_of((u * seconds, v * seconds), true)
            epe.append(e)
            angle.append(a)
        count = len(epe)
        out = 100 * sum(e > 3 for e in epe) / count
        rows.append(((t0, t1), sum(epe) / count, out, sum(angle) / count, count))
    return rows


@pytest.mark.parametrize("policy", ["causal", "paper"])
@pytest.mark.parametrize("form", ["bag", "hdf5"])
@pytest.mark.parametrize(("protocol", "step"), [("mvsec-dt1", 1), ("mvsec-dt4", 4)])
def test_mvsec_flow(mvsec, world, form, protocol, step, policy):
    plan, run = run_mvsec(mvsec, world, form, protocol, policy)
    expected = slow_mvsec(mvsec["events"], mvsec["flow"], step)
    assert [(w.t_start, w.t_end) for w in run.windows] == [row[0] for row in expected]
    for window, (_, epe, out, angle, count) in zip(run.windows, expected, strict=True):
        assert window.flow.pixels == count > 1000
        assert window.flow.epe_px == pytest.approx(epe, rel=1e-4)
        assert window.flow.pe3 == pytest.approx(out, abs=0.2)
        assert window.flow.ae_deg == pytest.approx(angle, rel=1e-4)
    figures = {m.key: m.value for m in summarise(run.windows)}
    assert figures["epe_px"] == pytest.approx(np.mean([row[1] for row in expected]), rel=1e-4)
    assert f"policy {policy}" in plan.description
    assert "rows from 193 on are left out" in plan.description
    assert f"every frame to number {step} after it, 3 intervals of synthetic" in plan.description


@pytest.mark.parametrize("protocol", ["mvsec-dt1", "mvsec-dt4"])
def test_published_truth_of_frames_closer_than_the_maps(tmp_path, mvsec, world, protocol):
    """Frames every 30 ms, maps every 50 ms: at dt1 one map counts, at dt4 (120 ms) the chain."""
    path = tmp_path / "frames_data.hdf5"
    shutil.copy(mvsec["hdf5"][0], path)
    with h5py.File(path, "a") as file:
        del file["davis/left/image_raw_ts"]
        file["davis/left/image_raw_ts"] = START / 1e9 + 0.02 + 0.03 * np.arange(12)
    chosen = sequence(world.camera)
    with Source(path, sequence=chosen).open() as recording:
        known = load_truth(recording, [mvsec["npz"]])
        causal, paper = (
            make_plan(protocol, recording, known, WindowPolicy(), chosen, clips=clips)
            for clips in ("causal", "paper")
        )
    t0 = START + 50 * NS_PER_MS  # frame 1; the maps meet 7 ms later
    t1 = t0 + (30 if protocol == "mvsec-dt1" else 120) * NS_PER_MS
    exact, published = (plan.truth.flows.displacement(t0, t1) for plan in (causal, paper))
    assert "the first map alone" in paper.truth.flows.description
    assert "the first map alone" not in causal.truth.flows.description
    if protocol == "mvsec-dt4":
        np.testing.assert_array_equal(published.displacement, exact.displacement)
        return
    np.testing.assert_allclose(published.displacement, 0.6 * mvsec["flow"][0], atol=1e-5)
    known = exact.valid & published.valid
    distance = np.linalg.norm(exact.displacement - published.displacement, axis=-1)[known]
    assert 0.001 < distance.mean() < 1.0


@pytest.mark.parametrize(
    ("protocol", "step", "length_ms"), [("mvsec-dt1", 1, 70), ("mvsec-dt4", 4, 200)]
)
def test_mvsec_flow_of_windows_by_motion(mvsec, world, protocol, step, length_ms):
    """They hold the interval at least, and it alone is compared."""
    _, run = run_mvsec(mvsec, world, "hdf5", protocol, "causal", estimator=Latest)
    events = mvsec["events"]
    expected = slow_mvsec(events, mvsec["flow"], step)
    assert [(w.t_start, w.t_end) for w in run.windows] == [row[0] for row in expected]
    for window, (_, epe, out, angle, count) in zip(run.windows, expected, strict=True):
        assert window.flow.pixels == count
        assert window.flow.epe_px == pytest.approx(epe, rel=1e-4)
        assert window.flow.pe3 == pytest.approx(out, abs=0.2)
        assert window.flow.ae_deg == pytest.approx(angle, rel=1e-4)
        span = (window.t_end - length_ms * NS_PER_MS, window.t_end)
        inside = slice(*np.searchsorted(events.t, span))
        assert window.events == (events.y[inside] < ROWS).sum()
        np.testing.assert_allclose(window.angular, KnownMotion().angular(window.t))


def test_windows_of_the_two_policies(mvsec, world):
    """Causal windows hold the last 90 ms; published ones 3000 events; both less the hood's."""
    events = mvsec["events"]
    _, causal = run_mvsec(mvsec, world, "hdf5", "mvsec-dt1", "causal")
    _, paper = run_mvsec(mvsec, world, "hdf5", "mvsec-dt1", "paper")
    for own, clip in zip(causal.windows, paper.windows, strict=True):
        first, last = np.searchsorted(events.t, [own.t_start, own.t_end])
        past = np.searchsorted(events.t, max(int(events.t[0]), own.t_end - 90 * NS_PER_MS))
        assert past < first
        assert own.events == (events.y[past:last] < ROWS).sum()
        half = (CLIP - (last - first)) // 2
        taken = events.y[first - half : last + half] if half > 0 else events.y[last - CLIP : last]
        assert clip.events == (taken < ROWS).sum()


@pytest.mark.parametrize("policy", ["causal", "paper"])
def test_mvsec_velocities(mvsec, world, policy):
    """At the middle of the interval: from the poses, and as MVSEC smoothed them."""
    _, run = run_mvsec(mvsec, world, "bag", "mvsec-dt4", policy)
    odom = mvsec["odom"]
    squares, smoothed = [], []
    for i in range(FIRST, LAST + 1):
        t = (FRAMES[i] + FRAMES[i + 4]) // 2
        ours = KnownMotion().angular(t)
        for axis in range(3):
            squares.append(math.degrees(ours[axis] - ANGULAR[axis]) ** 2)
            k = max(j for j in range(len(STAMPS)) if STAMPS[j] <= t)
            share = (t - STAMPS[k]) / (STAMPS[k + 1] - STAMPS[k])
            true = odom["ang_vel"][k][axis] * (1 - share) + odom["ang_vel"][k + 1][axis] * share
            smoothed.append(math.degrees(ours[axis] - true) ** 2)
    figures = {m.key: m.value for m in summarise(run.windows)}
    rms = math.sqrt(sum(squares) / len(squares))
    assert figures["angular_rms_deg_s"] == pytest.approx(rms, rel=1e-3)
    assert figures["direction_error_deg"] == pytest.approx(0, abs=0.1)
    other = {m.key: m.value for m in summarise_by_truth(run.windows, run.truth)["MVSEC's odometry"]}
    rms = math.sqrt(sum(smoothed) / len(smoothed))
    assert other["angular_rms_deg_s"] == pytest.approx(rms, rel=1e-6)
    assert abs(other["angular_rms_deg_s"] - figures["angular_rms_deg_s"]) > 0.05


@pytest.mark.parametrize("form", ["bag", "hdf5"])
def test_flow_from_depth_and_poses_is_the_planes(mvsec, world, form):
    """The left camera's depth, moved by the poses, without the flow file."""
    data, truth = mvsec[form]
    with Source(data, sequence=sequence(world.camera)).open() as recording:
        flows = load_truth(recording, [truth]).flows
    found = flows.displacement(STAMPS[2], STAMPS[3])
    exact = world.displacement(STAMPS[2], STAMPS[3])
    known = found.valid & np.isfinite(exact).all(-1)
    assert known.mean() > 0.95
    np.testing.assert_allclose(found.displacement[known], exact[known], atol=1e-3)


@pytest.mark.usefixtures("without_page")
def test_mvsec_files_to_report(monkeypatch, tmp_path, mvsec):
    """The executable and the real estimator on everything that MVSEC has for a sequence."""
    data, truth = mvsec["hdf5"]
    arguments = [data, "--sequence", "outdoor_day1", "--protocol", "mvsec-dt4"]
    arguments += ["--policy", "paper", "--gt", truth, mvsec["npz"], mvsec["odom_path"]]
    arguments += ["--out", tmp_path]
    monkeypatch.setattr("sys.argv", ["evaluate", *map(str, arguments)])
    assert main() == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert "policy paper: 40000 events around each" in report["protocol"]
    assert report["windows_ok"] == report["windows_total"] > 0
    assert "synthetic_odom.npz" in " ".join(report["truth"])
    summary = {key: entry["value"] for key, entry in report["summary"].items()}
    assert summary["epe_px"] < 0.3 * summary["true_displacement_px"]
    assert summary["angular_rms_deg_s"] < 5
