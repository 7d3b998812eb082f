"""What profiles.py measured, as tables in Markdown."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks._scoring import PAPER_SPEED_UP, SCENES

FAST = "realtime"  # the profile that the targets are about
_HEADS = (
    "windows", "EPE, px", "EPE, static scene, px", "Out, %", "AE, deg", "RMS w, deg/s",
    "v, deg", "s/window", "CPU s/window",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One window under one profile; None where unknown.

    Attributes:
        index: of the window in its recording.
        status, model: see Estimate.
        epe_px, out_percent, ae_deg, true_px: see FlowErrors.
        static_epe_px: EPE without the pixels of the moving object.
        w_rms_deg_s: root mean square over the axes.
        v_error_deg: angle between the directions, sign included.
        seconds, cpu_seconds: of estimate and flow image, by the clock and of the processor, which
            other processes lengthen less.
        nees_w, nees_v: see normalised_errors.
        events, iterations, stop_reason, contrast_gain: see Quality.
    """

    index: int
    status: str
    model: str
    epe_px: float | None
    static_epe_px: float | None
    out_percent: float | None
    ae_deg: float | None
    true_px: float | None
    w_rms_deg_s: float | None
    v_error_deg: float | None
    seconds: float
    cpu_seconds: float
    nees_w: float | None
    nees_v: float | None
    events: int
    iterations: int
    stop_reason: str
    contrast_gain: float | None


@dataclass(frozen=True)
class Cell:
    """What a profile did on a recording.

    Attributes:
        profile, scene, seed: which.
        rows: one per window.
        configuration: all values of the profile.
        where: machine, versions and the load before.
    """

    profile: str
    scene: str
    seed: int
    rows: tuple[Row, ...]
    configuration: dict[str, Any]
    where: dict[str, Any]


def table(cells: Sequence[Cell]) -> str:
    """Lay out all windows of every profile, scene by scene."""
    lines = [*_origin(cells), "", *_head("All windows")]
    for scene, profile in _pairs(cells):
        rows = [row for c in cells if (c.scene, c.profile) == (scene, profile) for row in c.rows]
        lines.append(_line(scene, profile, rows))
    return "\n".join(lines) + "\n"


def paired_table(cells: Sequence[Cell]) -> str:
    """Lay out every profile on the windows that a slow profile has, and on no others."""
    lines = []
    for slow, scenes in _paired(cells).items():
        lines += _head(f"The windows of {slow}")
        for scene, by_profile in scenes.items():
            lines += [_line(scene, profile, rows) for profile, rows in by_profile.items()]
        lines.append("")
    return "\n".join(lines)


def verdicts(cells: Sequence[Cell]) -> str:
    """Judge `realtime` against every slow profile, scene by scene, on the windows of the latter.

    Target: at least as good in EPE, w and v, and so many times faster in processor time.
    """
    heads = ("scene", "windows", "EPE, px", "RMS w, deg/s", "v, deg", "times faster", "verdict")
    lines = []
    for slow, scenes in _paired(cells).items():
        lines += [
            f"Target: `{FAST}` <= `{slow}` in EPE, w and v, at least {PAPER_SPEED_UP:.0f} times "
            "faster in processor time:",
            "",
            _markdown(heads),
            _markdown(["---"] * len(heads)),
            *(_verdict(scene, scenes.get(scene, {}), slow) for scene in SCENES),
            "",
        ]
    return "\n".join(
        lines or ["Target: not measured, no window of the published loop is there.", ""]
    )


def _verdict(scene: str, by_profile: Mapping[str, Sequence[Row]], slow: str) -> str:
    if not {FAST, slow} <= by_profile.keys():
        return _markdown([scene, "0", *["-"] * 4, "not measured"])
    ours, theirs = by_profile[FAST], by_profile[slow]
    cells, missed = [], []
    for name, of in (("EPE", _epe), ("w", _w_rms), ("v", _v_error)):
        us, them = of(ours), of(theirs)
        cells.append(f"{_number(us)} / {_number(them)}")
        if them is not None and (us is None or us > them):
            missed.append(name)
    faster = float(_cpu_seconds(theirs) / _cpu_seconds(ours))
    if faster < PAPER_SPEED_UP:
        missed.append("speed")
    result = f"missed: {', '.join(missed)}" if missed else "met"
    return _markdown([scene, str(len(ours)), *cells, f"{faster:.0f}", result])


def _paired(cells: Sequence[Cell]) -> dict[str, dict[str, dict[str, list[Row]]]]:
    """By slow profile, scene and profile: the rows of those that have all of the slow one's."""
    by_window = {
        (cell.profile, cell.scene, cell.seed, row.index): row for cell in cells for row in cell.rows
    }
    streamed = {FAST} | {cell.profile for cell in cells if len(cell.rows) > 1}
    pairs: dict[str, dict[str, dict[str, list[Row]]]] = {}
    for slow in dict.fromkeys(c.profile for c in cells if c.profile not in streamed):
        pairs[slow] = {scene: {} for scene in SCENES}
        for scene, by_profile in pairs[slow].items():
            chosen = sorted(key[1:] for key in by_window if key[:2] == (slow, scene))
            for profile in dict.fromkeys(c.profile for c in cells):
                keys = [(profile, *window) for window in chosen]
                rows = [by_window[key] for key in keys if key in by_window]
                if rows and len(rows) == len(keys):
                    by_profile[profile] = rows
    return pairs


def _pairs(cells: Sequence[Cell]) -> Iterable[tuple[str, str]]:
    """Scenes in their usual order, each with the profiles that have it."""
    there = dict.fromkeys((cell.profile, cell.scene) for cell in cells)
    return [(scene, profile) for scene in SCENES for profile, of in there if of == scene]


def _origin(cells: Sequence[Cell]) -> list[str]:
    machines = dict.fromkeys(
        f"{c.where['machine']['processor']}, {c.where['machine']['cores']} cores, "
        f"{c.where['machine']['memory']}" for c in cells
    )  # fmt: skip
    versions = dict.fromkeys(
        ", ".join(f"{name} {version}" for name, version in c.where["versions"].items())
        for c in cells
    )
    return [f"One thread; {'; '.join(machines)}. {'; '.join(versions)}."]


def _head(title: str) -> list[str]:
    heads = ("scene", "profile", *_HEADS)
    return [f"{title}:", "", _markdown(heads), _markdown(["---"] * len(heads))]


def _line(scene: str, profile: str, rows: Sequence[Row]) -> str:
    figures = (
        _epe(rows),
        _over(np.mean, [row.static_epe_px for row in rows]),
        _over(np.mean, [row.out_percent for row in rows]),
        _over(np.mean, [row.ae_deg for row in rows]),
        _w_rms(rows),
        _v_error(rows),
    )
    seconds = (np.median([row.seconds for row in rows]), _cpu_seconds(rows))
    numbers = [_number(value) for value in figures]
    ok = sum(row.status == "ok" for row in rows)
    count = str(len(rows)) if ok == len(rows) else f"{ok} of {len(rows)}"
    times = [f"{value:.3g}" for value in seconds]
    return _markdown([scene, f"`{profile}`", count, *numbers, *times])


def _epe(rows: Sequence[Row]) -> float | None:
    return _over(np.mean, [row.epe_px for row in rows])


def _w_rms(rows: Sequence[Row]) -> float | None:
    return _over(lambda rms: np.sqrt(np.mean(rms**2)), [row.w_rms_deg_s for row in rows])


def _v_error(rows: Sequence[Row]) -> float | None:
    return _over(np.median, [row.v_error_deg for row in rows])


def _cpu_seconds(rows: Sequence[Row]) -> float:
    return float(np.median([row.cpu_seconds for row in rows]))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _over(statistic: Callable[[Any], Any], values: Sequence[float | None]) -> float | None:
    """Apply a statistic to the values that are known; None without any."""
    known = np.array([value for value in values if value is not None])
    return float(statistic(known)) if len(known) else None


def _markdown(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
