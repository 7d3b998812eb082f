"""A sequence in DSEC's format through its protocol, against plain loops."""

import numpy as np
import pytest
from known import ANGULAR, LINEAR, START, Known, errors_of, velocity
from synthetic import Plane, write_dsec

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, WindowPolicy
from emoflow_ros.evaluation.protocols import make_plan
from emoflow_ros.evaluation.recording_options import Source
from emoflow_ros.evaluation.window_run import evaluate
from emoflow_ros.truth import load_truth

RECTIFIED = Camera(640, 480, 569.76, 569.76, 335.1, 221.24)
DSEC = [
    (START + a * 1000, START + b * 1000)
    for a, b in ((30_523, 130_524), (130_524, 230_511), (260_000, 360_020))
]


@pytest.fixture(scope="module")
def dsec(tmp_path_factory):
    world = Plane(RECTIFIED, START, START + 400 * NS_PER_MS, ANGULAR, 2 * LINEAR, dots=1500)
    folder = tmp_path_factory.mktemp("dsec") / "zurich_city_02_a"
    return write_dsec(folder, world, DSEC, (134, 136, 140))


def test_dsec_events_in_the_rectified_view(dsec):
    expected = []
    columns = dsec.raw.x.tolist(), dsec.raw.y.tolist(), dsec.raw.t.tolist(), dsec.raw.p.tolist()
    for x, y, t, p in zip(*columns, strict=True):
        u, v = dsec.rectify_map[y, x]
        u, v = round(float(u)), round(float(v))
        if 0 <= u < 640 and 0 <= v < 480:
            expected.append((u, v, t, p))
    with Source(dsec.path).open() as recording:
        assert recording.camera == RECTIFIED
        read = Events.concatenate(list(recording.event_chunks()))
    assert 0 < len(dsec.raw) - len(expected) < 0.2 * len(dsec.raw)
    np.testing.assert_array_equal(np.column_stack([read.x, read.y, read.t, read.p]), expected)


def test_dsec_events_without_rectification(dsec):
    with Source(dsec.path / "events" / "left" / "events.h5").open() as recording:
        assert recording.camera is None
        read = Events.concatenate(list(recording.event_chunks()))
    np.testing.assert_array_equal(read.x, dsec.raw.x)
    np.testing.assert_array_equal(read.t, dsec.raw.t)


def slow_dsec(dsec):
    """(EPE, %Out, AE, pixels) per interval, one pixel with truth at a time."""
    rows = []
    for (t0, t1), flow, valid in zip(dsec.intervals, dsec.flow, dsec.valid, strict=True):
        epe, angle = [], []
        seconds, middle = (t1 - t0) / NS_PER_S, ((t0 + t1) / 2 - START) / NS_PER_S
        for y in range(480):
            for x in range(640):
                if valid[y, x]:
                    u, v = velocity(middle, x, y)
                    e, a = errors_of((u * seconds, v * seconds), flow[y, x].tolist())
                    epe.append(e)
                    angle.append(a)
        count = len(epe)
        out = 100 * sum(e > 3 for e in epe) / count
        rows.append((sum(epe) / count, out, sum(angle) / count, count))
    return rows


@pytest.mark.parametrize("policy", ["causal", "paper"])
def test_dsec_flow(dsec, monkeypatch, policy):
    """All pixels with truth count, wherever events are; lead-in windows count for nothing."""
    monkeypatch.setattr("emoflow_ros.evaluation.protocols.DSEC_CLIP", 2000)
    with Source(dsec.path).open() as recording:
        plan = make_plan("dsec", recording, load_truth(recording), WindowPolicy(), clips=policy)
        run = evaluate(recording, Known(RECTIFIED), plan.slicer, plan.truth)
    compared = [w for w in run.windows if w.flow]
    assert [(w.t_start, w.t_end) for w in compared] == DSEC
    for window, (epe, out, angle, count) in zip(compared, slow_dsec(dsec), strict=True):
        assert window.flow.pixels == count
        assert window.flow.epe_px == pytest.approx(epe, rel=1e-6)
        assert window.flow.pe3 == pytest.approx(out, abs=0.01)
        assert window.flow.ae_deg == pytest.approx(angle, rel=1e-4)
    assert f"dsec: 3 intervals of the flow truth; policy {policy}" in plan.description
    if policy == "paper":
        assert [w.events for w in compared] == [2000] * 3
    else:
        assert len(run.windows) > 3  # windows to warm up on before the first interval


def test_dsec_windows_end_with_the_intervals(dsec):
    """135 ms to each interval's end, also those to warm up on; the first from the first event."""
    with Source(dsec.path).open() as recording:
        plan = make_plan("dsec", recording, load_truth(recording), WindowPolicy(duration_ms=135.0))
        events = Events.concatenate(list(recording.event_chunks()))
    windows = plan.slicer.push(events)
    first = int(events.t[0])
    assert {(w.compared.t_start, w.compared.t_end) for w in windows} >= set(DSEC)
    assert len(windows) > len(DSEC)
    for w in windows:
        assert w.t_end == w.compared.t_end
        start = max(first, w.t_end - 135 * NS_PER_MS)
        assert w.t_start == min(w.compared.t_start, start)
        inside = slice(*np.searchsorted(events.t, [w.t_start, w.t_end]))
        np.testing.assert_array_equal(w.events.t, events.t[inside])
    assert "windows of 135 ms that end with each, or its own events" in plan.description
