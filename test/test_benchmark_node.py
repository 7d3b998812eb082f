"""The figures of the benchmark of the running node, by hand."""

import pytest

from benchmarks._event_loop import START
from benchmarks._node_figures import (
    MACHINE,
    Observed,
    Sample,
    Sent,
    Targets,
    ages_ms,
    drop_runs,
    figures,
    process_table,
    rows,
    usage,
)
from emoflow_ros.errors import InputError

MS = 1_000_000
SENT = Sent(messages=2500, events=1000, windows=100)


def test_age_is_from_the_stamp_to_the_publication():
    """The recording runs at twice its pace: 100 ms of it take 50 ms."""
    marks = [(START, 100.0), (START + 100 * MS, 100.05), (START + 200 * MS, 100.1)]
    twists = [(START + 50 * MS, 100.045), (START + 200 * MS, 100.13)]
    assert ages_ms(marks, twists) == pytest.approx([20, 30], abs=1e-3)


def test_runs_of_dropped_windows():
    statuses = ["ok", "dropped", "dropped", "ok", "dropped", "no_motion", "dropped"]
    assert drop_runs(statuses) == {"mean": pytest.approx(4 / 3), "longest": 2, "ratio": 1.5}
    assert drop_runs(["ok"]) == {"mean": None, "longest": 0, "ratio": None}


def samples(mb: float, cores: float, mb_per_s: float = 0.0) -> list[Sample]:
    """Eleven samples from 100 to 110 s, and one each before and after the events."""
    return [Sample(99 + k, mb + mb_per_s * k, 5 + cores * k) for k in range(13)]


def observed() -> Observed:
    """Ten seconds at 1x; a twist each 10 ms, 25 ms old, but for a gap of 200 ms."""
    twists = [(START + k * 10 * MS, 100 + k / 100 + 0.025) for k in range(1000)]
    return Observed(
        marks=[(START + k * 4 * MS, 100 + k / 250) for k in range(2501)],
        twists=twists[:500] + twists[519:],
        with_covariance=95,
        statuses=["ok"] * 95 + ["dropped"] * 2 + ["no_motion"] + ["dropped"],
        diagnostics={
            "status": "ok",
            "messages": "2500",
            "seq_gaps": "0",
            "events": "990",
            "events_dropped": "40",
            "windows": "100",
            "windows_ok": "95",
            "windows_no_motion": "1",
            "windows_dropped": "3",
            "windows_failed": "0",
            "windows_forgotten": "0",
        },
        samples={
            "node": samples(250, 0.3),
            "worker": samples(180, 0.5, 1.0),
            "replay": samples(90, 0.1),
            MACHINE: samples(4000, 1.4),
        },
    )


def test_figures_of_a_run():
    found = figures(observed(), SENT)
    assert found["replayed_at"] == pytest.approx(1)
    assert found["twists_per_s"] == pytest.approx(881 / 9)  # of 9 s without the first one
    assert found["longest_gap_ms"] == pytest.approx(200)
    assert found["age_ms"] == pytest.approx({"p50": 25, "p95": 25, "max": 25}, abs=1e-3)
    assert found["windows"] == {
        "expected": 100,
        "answered": 96,
        "with a twist": 95,
        "dropped": 3,
        "not accounted for": 1,
        "drop runs": {"mean": 1.5, "longest": 2, "ratio": pytest.approx(4 / 3)},
    }
    assert found["messages"] == {
        "sent": 2500,
        "lost": 0,
        "skipped": 0,
        "in part": 0,
        "not accounted for": 0,
    }
    assert found["events"] == {
        "sent": 1000,
        "counted": 990,
        "miscounted": 10,
        "in dropped windows": 40,
    }
    processes = found["processes"]
    assert processes["node + worker"]["resident_mb_max"] == pytest.approx(430 + 11)
    assert processes["node + worker"]["growth_mb_per_min"] == pytest.approx(60)
    assert processes["node + worker"]["cpu_s_per_recorded_s"] == pytest.approx(0.8)
    assert processes["all others"]["cores"] == pytest.approx(0.5)
    others = process_table(processes).splitlines()[-1].split()
    assert others == [
        "all",
        "others",
        "-",
        "-",
        "0.50",
        "0.500",
    ]


def test_processor_time_is_per_second_of_the_recording():
    taken = {role: samples(1, 1.0) for role in ("node", "worker", MACHINE)}
    used = usage(taken, 99, 111, pace=5.0)
    assert used["node"]["cores"] == pytest.approx(1.0)
    assert used["node"]["cpu_s_per_recorded_s"] == pytest.approx(0.2)


def test_every_figure_of_a_case_is_judged():
    found = figures(observed(), SENT)
    targets = Targets(50, age_p50_ms=20, age_p95_ms=45, lost=0, longest_run=3)
    judged = {row.figure: row.verdict for row in rows("fresh", 1, targets, found)}
    assert judged == {
        "fresh: replayed at": "met",
        "fresh: twists per second": "met",
        "fresh: age of a twist, median, ms": "missed",
        "fresh: age of a twist, 95 %, ms": "met",
        "fresh: age of a twist, longest, ms": "",
        "fresh: longest gap between twists, ms": "",
        "fresh: windows": "",
        "fresh: windows with a twist": "",
        "fresh: windows lost": "missed",
        "fresh: longest run of dropped windows, over the mean": "met",
        "fresh: windows not accounted for": "missed",
        "fresh: messages lost before the node": "met",
        "fresh: messages left out by the node": "met",
        "fresh: messages decoded in part": "met",
        "fresh: messages not accounted for": "met",
        "fresh: events miscounted": "missed",
        "fresh: memory of node + worker, MB": "met",
        "fresh: its growth in the later half, MB/min": "",  # from five minutes on
    }
    slow = rows("overload", 5, Targets(), found)[0]
    assert (slow.at_least, slow.verdict) == (pytest.approx(4.95), "missed")


def test_messages_that_the_queue_lost_are_gaps():
    run = observed()
    run.diagnostics |= {"messages": "2400", "seq_gaps": "90"}
    found = figures(run, SENT)
    assert found["messages"] == {
        "sent": 2500,
        "lost": 100,
        "skipped": 0,
        "in part": 0,
        "not accounted for": 10,
    }
    assert found["events"]["miscounted"] is None  # nobody knows which are missing


def test_messages_that_the_node_left_out_are_no_gaps():
    run = observed()
    run.diagnostics |= {"messages": "2400", "messages_skipped": "95", "seq_gaps": "3"}
    found = figures(run, SENT)
    assert found["messages"] == {
        "sent": 2500,
        "lost": 5,
        "skipped": 95,
        "in part": 0,
        "not accounted for": 2,
    }
    assert found["events"]["miscounted"] is None


def test_events_of_messages_in_part_are_not_miscounted():
    run = observed()
    run.diagnostics |= {"messages_in_part": "1000", "events": "900000"}
    found = figures(run, SENT)
    assert found["messages"]["in part"] == 1000
    assert found["events"]["miscounted"] is None
    assert "fresh: messages decoded in part" in [
        row.figure for row in rows("fresh", 1, Targets(lost=0), found) if row.verdict == "missed"
    ]


def test_a_run_that_is_too_short_is_refused():
    with pytest.raises(InputError, match="no events came over DDS"):
        figures(Observed(), SENT)
    short = Observed(marks=[(START, 100.0), (START + MS, 100.5)])
    with pytest.raises(InputError, match=r"--seconds: 0\.5 s of replay"):
        figures(short, SENT)
