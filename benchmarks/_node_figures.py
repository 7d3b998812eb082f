"""What node.py reports of a run: rates, ages, counts of windows, memory and processor time."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np
from scipy.stats import linregress

from benchmarks._rows import Row
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError

WARM_UP_S = 1.0  # the first window is cold, the next ones meet what it leaves behind
MIN_FOR_GROWTH_S = 300.0  # of memory, for its target to mean something
MACHINE = "machine"  # the role under which the cores are sampled
OTHERS = "all others"

_BOTH = ("node", "worker")
_MIN_SAMPLES = 3
_SLOWEST = 0.99  # of the pace asked for: a replay that falls behind makes all else easier
_DROPPED = "dropped"  # status of a window


@dataclass(frozen=True)
class Targets:
    """What a case is held to besides what all are; None: nothing.

    Attributes:
        twists_per_s: at least so many.
        age_p50_ms, age_p95_ms: age of a twist's information, at most.
        lost: windows without an answer, and messages, at most.
        longest_run: of dropped windows over the mean run, at most.
    """

    twists_per_s: float | None = None
    age_p50_ms: float | None = None
    age_p95_ms: float | None = None
    lost: int | None = None
    longest_run: float | None = None


MEMORY_MB = 500.0
GROWTH_MB_PER_MIN = 1.0


@dataclass(frozen=True)
class Sample:
    """What a process, or all of them on the cores that are used, hold and have used.

    Attributes:
        time: Unix time, s.
        resident_mb: memory, MB (10^6 bytes).
        cpu_s: user and system time since the start.
    """

    time: float
    resident_mb: float
    cpu_s: float


@dataclass
class Observed:
    """What came over DDS, in Unix time, and what the processes used.

    Attributes:
        marks: (end of a packet in ROS time, ns; when `replay` went on to publish it, s).
        twists: (stamp in ns, publication in s) of each twist.
        with_covariance: number of twists with covariance, one per window that has one.
        statuses: of the windows, in the order in which they came.
        diagnostics: the node's last numbers.
        listening_s: from the start of the node's process to its subscription.
        samples: by role, one each second of the replay.
    """

    marks: list[tuple[int, float]] = field(default_factory=list)
    twists: list[tuple[int, float]] = field(default_factory=list)
    with_covariance: int = 0
    statuses: list[str] = field(default_factory=list)
    diagnostics: dict[str, str] = field(default_factory=dict)
    listening_s: float = float("nan")
    samples: dict[str, list[Sample]] = field(default_factory=dict)


@dataclass(frozen=True)
class Sent:
    """How many messages, events and windows a recording has."""

    messages: int
    events: int
    windows: int


def figures(observed: Observed, sent: Sent) -> dict[str, Any]:
    """Compute everything that is reported of a run.

    Args:
        observed: the run.
        sent: what should have come of it.

    Raises:
        InputError: no events came, or the run was too short.
    """
    if len(observed.marks) < 2:
        raise InputError("replay", "no events came over DDS", "see its message above")
    times, published = np.array(observed.marks, float).T
    begin, end = float(published[0]) + WARM_UP_S, float(published[-1])
    if end <= begin:
        took = f"{end - begin + WARM_UP_S:.1f} s of replay"
        raise InputError("--seconds", took, f"give more than {WARM_UP_S:g} s, times the pace")
    pace = (times[-1] - times[0]) / NS_PER_S / (published[-1] - published[0])
    counted = {k: int(v) for k, v in observed.diagnostics.items() if v.isdecimal()}
    answered = sum(counted.get(f"windows_{status}", 0) for status in Status)
    dropped = counted.get("windows_dropped", 0)
    rest = sum(counted.get(f"windows_{name}", 0) for name in ("failed", "forgotten"))
    return {
        "listening_s": observed.listening_s,
        "replayed_at": float(pace),
        **_twist_figures(observed, begin, end),
        "windows": {
            "expected": sent.windows,
            "answered": answered,
            "with a twist": observed.with_covariance,
            "dropped": dropped,
            "not accounted for": abs(counted.get("windows", 0) - answered - dropped - rest),
            "drop runs": drop_runs(observed.statuses),
        },
        **_input_figures(counted, sent),
        "processes": usage(observed.samples, float(published[0]), end, float(pace)),
        "diagnostics": observed.diagnostics,
    }


def _input_figures(counted: Mapping[str, int], sent: Sent) -> dict[str, Any]:
    came, events = (counted.get(name, 0) for name in ("messages", "events"))
    skipped, in_part = (counted.get(f"messages_{name}", 0) for name in ("skipped", "in_part"))
    missing = sent.messages - came
    return {
        "messages": {
            "sent": sent.messages,
            "lost": missing - skipped,
            "skipped": skipped,
            "in part": in_part,
            "not accounted for": abs(missing - skipped - counted.get("seq_gaps", 0)),
        },
        "events": {
            "sent": sent.events,
            "counted": events,
            "miscounted": abs(sent.events - events) if missing == in_part == 0 else None,
            "in dropped windows": counted.get("events_dropped", 0),
        },
    }


def _twist_figures(observed: Observed, begin: float, end: float) -> dict[str, Any]:
    inside = [(stamp, at) for stamp, at in observed.twists if begin <= at <= end]
    published = np.array([at for _, at in inside])
    gaps = np.diff([begin, *published, end])
    ages = ages_ms(observed.marks, inside)
    p50, p95, longest = map(float, np.percentile(ages, [50, 95, 100])) if ages else [None] * 3
    return {
        "twists": len(inside),
        "twists_per_s": len(inside) / (end - begin),
        "longest_gap_ms": 1e3 * float(gaps.max()),
        "age_ms": {"p50": p50, "p95": p95, "max": longest},
    }


def ages_ms(marks: Sequence[tuple[int, float]], twists: Iterable[tuple[int, float]]) -> list[float]:
    """Return how old the information of each twist was when it was published, ms.

    That is the time since its stamp. The recording's time maps to the clock by the marks, about one
    in 4 ms of the clock: `replay` published each at the time that it names, and between two marks
    time passes evenly. At other paces than 1 this is what the clock shows, too, not the
    recording's time.

    Args:
        marks: see Observed.
        twists: stamp in ns and publication in s.
    """
    ends, published = np.array(marks, float).T
    return [
        1e3 * (at - float(np.interp(stamp - marks[0][0], ends - marks[0][0], published)))
        for stamp, at in twists
    ]


def drop_runs(statuses: Iterable[str]) -> dict[str, float | None]:
    """Return the mean and the longest number of windows dropped one after another."""
    runs = [len(list(run)) for status, run in groupby(statuses) if status == _DROPPED]
    if not runs:
        return {"mean": None, "longest": 0, "ratio": None}
    mean = float(np.mean(runs))
    return {"mean": mean, "longest": max(runs), "ratio": max(runs) / mean}


def usage(
    samples: Mapping[str, Sequence[Sample]], begin: float, end: float, pace: float
) -> dict[str, Any]:
    """Sum up the processes, node and worker together, and the load of all others.

    Args:
        samples: by role; those of all processes together under MACHINE.
        begin, end: Unix time of the first and the last events, s.
        pace: of the replay.

    Raises:
        InputError: fewer than three samples of a process in that time.
    """
    kept = {role: [s for s in taken if begin <= s.time <= end] for role, taken in samples.items()}
    if min(map(len, kept.values())) < _MIN_SAMPLES:
        raise InputError("--seconds", "too short for memory", "give more")
    node, worker = (kept[role] for role in _BOTH)
    both = [
        Sample(a.time, a.resident_mb + b.resident_mb, a.cpu_s + b.cpu_s)
        for a, b in zip(node, worker, strict=True)
    ]
    machine = _processor(kept.pop(MACHINE), pace)
    own = [_processor(taken, pace) for taken in kept.values()]
    return {
        "node + worker": _process(both, pace),
        **{role: _process(taken, pace) for role, taken in kept.items()},
        OTHERS: {key: machine[key] - sum(one[key] for one in own) for key in machine},
    }


def _process(samples: Sequence[Sample], pace: float) -> dict[str, Any]:
    """Sum up a process; its growth is that of the later half, when all buffers are filled."""
    later = samples[len(samples) // 2 :]
    minutes = [s.time / 60 for s in later]
    growth = linregress(minutes, [s.resident_mb for s in later]).slope if len(later) > 1 else 0.0
    return {
        "resident_mb_max": max(s.resident_mb for s in samples),
        "growth_mb_per_min": float(growth),
        "observed_s": samples[-1].time - samples[0].time,
        **_processor(samples, pace),
        "resident_mb": [round(s.resident_mb, 1) for s in samples],
    }


def _processor(samples: Sequence[Sample], pace: float) -> dict[str, float]:
    first, last = samples[0], samples[-1]
    cores = (last.cpu_s - first.cpu_s) / (last.time - first.time)
    return {"cores": cores, "cpu_s_per_recorded_s": cores / pace}


def rows(name: str, pace: float, targets: Targets, found: Mapping[str, Any]) -> list[Row]:
    """Hold the figures of a case against its targets.

    Args:
        name: of the case.
        pace: that was asked for.
        targets: its own ones.
        found: what `figures` returned.
    """
    windows, messages, age = found["windows"], found["messages"], found["age_ms"]
    runs, both = windows["drop runs"], found["processes"]["node + worker"]
    miscounted = found["events"]["miscounted"]  # not known where messages were not read
    lost = windows["expected"] - windows["answered"]
    even = targets.longest_run if windows["dropped"] else None
    flat = GROWTH_MB_PER_MIN if both["observed_s"] >= MIN_FOR_GROWTH_S else None
    found_rows = [
        Row("replayed at", found["replayed_at"], at_least=_SLOWEST * pace),
        Row("twists per second", found["twists_per_s"], at_least=targets.twists_per_s),
        Row("age of a twist, median, ms", age["p50"], targets.age_p50_ms),
        Row("age of a twist, 95 %, ms", age["p95"], targets.age_p95_ms),
        Row("age of a twist, longest, ms", age["max"]),
        Row("longest gap between twists, ms", found["longest_gap_ms"]),
        Row("windows", windows["expected"]),
        Row("windows with a twist", windows["with a twist"]),
        Row("windows lost", lost, targets.lost),
        Row("longest run of dropped windows, over the mean", runs["ratio"], even),
        Row("windows not accounted for", windows["not accounted for"], 0),
        Row("messages lost before the node", messages["lost"], targets.lost),
        Row("messages left out by the node", messages["skipped"], targets.lost),
        Row("messages decoded in part", messages["in part"], targets.lost),
        Row("messages not accounted for", messages["not accounted for"], 0),
        Row("events miscounted", miscounted, None if miscounted is None else 0),
        Row("memory of node + worker, MB", both["resident_mb_max"], MEMORY_MB),
        Row("its growth in the later half, MB/min", both["growth_mb_per_min"], flat),
    ]
    return [Row(f"{name}: {r.figure}", r.result, r.at_most, r.at_least) for r in found_rows]


def process_table(processes: Mapping[str, Mapping[str, Any]]) -> str:
    """Lay out what the processes used, for people."""
    lines = [f"{'process':<16}{'MB':>9}{'MB/min':>9}{'cores':>8}{'CPU s per recorded s':>22}"]
    for role, used in processes.items():
        memory, growth = (used.get(key) for key in ("resident_mb_max", "growth_mb_per_min"))
        columns = "".join("        -" if v is None else f"{v:9.1f}" for v in (memory, growth))
        lines.append(f"{role:<16}{columns}{used['cores']:8.2f}{used['cpu_s_per_recorded_s']:22.3f}")
    return "\n".join(lines)
