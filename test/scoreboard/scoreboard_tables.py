"""Tables of windows for tests of the scoreboard, and its figures once more in plain loops."""

import math
from typing import Any

import numpy as np

from benchmarks.scoreboard.windows import Windows, make_windows

MS = 1_000_000
NAN = float("nan")


def row(**changed: Any) -> dict[str, Any]:
    """A good window of a moving camera: w 1 deg/s off with a sigma of 1 deg/s, v exact."""
    sigma = math.radians(1.0)
    return {
        "start": 0,
        "t_begin": 0,
        "t_window": 0,
        "t_start": 0,
        "t_end": 135 * MS,
        "events": 40_000,
        "status": "ok",
        "model": "full",
        "ok": True,
        "moved_px": 10.0,
        "parallax_px": 5.0,
        "truth_px": 10.0,
        "epe_px": 0.5,
        "angular": np.radians([11.0, 0.0, 0.0]),
        "true_angular": np.radians([10.0, 0.0, 0.0]),
        "angular_covariance": sigma**2 * np.eye(3),
        "linear": np.array([0.0, 0.0, 1.0]),
        "true_linear": np.array([0.0, 0.0, 1.0]),
        "linear_covariance": math.radians(3.0) ** 2 * np.diag([1.0, 1.0, 0.0]),
        "seconds": 0.03,
    } | changed


def silent(**changed: Any) -> dict[str, Any]:
    """A window without an estimate."""
    nothing = np.full(3, NAN)
    return row(
        ok=False,
        status="no_motion",
        model="static",
        epe_px=NAN,
        angular=nothing,
        angular_covariance=NAN,
        linear=nothing,
        linear_covariance=NAN,
        **changed,
    )


def towards(degrees: float) -> np.ndarray:
    """Unit direction that many degrees off the optical axis, to the right."""
    return np.array([math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))])


def random_table(seed: int, count: int = 60) -> Windows:
    """Windows of all kinds: with and without estimate, moving or not, with gaps in the truth."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(count):
        true = rng.normal(size=3)
        true /= np.linalg.norm(true)
        linear = true + rng.normal(size=3)
        linear /= np.linalg.norm(linear)
        root = rng.normal(size=(3, 3)) * rng.choice([0.02, 0.3])
        across = np.eye(3) - np.outer(linear, linear)
        changed = {
            "start": int(k >= count // 2),
            "t_begin": int(k >= count // 2) * 100 * MS,
            "t_end": (k % (count // 2) + 4) * 67 * MS,
            "moved_px": rng.choice([0.0, 0.9, 2.9, 3.0, 12.0, NAN]),
            "parallax_px": rng.choice([0.0, 1.0, 2.0, 4.0]),
            "truth_px": rng.uniform(1, 12) if rng.random() < 0.9 else NAN,
            "true_angular": rng.normal(size=3) * 0.3,
            "true_linear": true,
        }
        if rng.random() < 0.2:
            changed["true_linear"] = np.full(3, NAN)
        if rng.random() < 0.25:
            rows.append(silent(**changed))
            continue
        changed |= {
            "epe_px": rng.choice([NAN, *rng.uniform(0, 6, 3)]) + 0 * changed["truth_px"],
            "angular": changed["true_angular"] + rng.normal(size=3) * 0.1,
            "angular_covariance": root @ root.T + 1e-4 * np.eye(3),
            "linear": linear,
            "linear_covariance": across @ (root @ root.T + 1e-3 * np.eye(3)) @ across,
        }
        if rng.random() < 0.2:
            changed |= {"linear": np.full(3, NAN), "linear_covariance": NAN}
        rows.append(row(**changed))
    return make_windows(rows)


def slow_figures(windows: Windows) -> dict[str, float]:
    """The figures by their definitions, window by window, without the code under test."""
    moving, still, covered, covered_still = 0, 0, 0, 0
    epe, way, w2, true2, nees_w, nees_v, v = [], [], [], [], [], [], []
    wrong_w = wrong_v = wrong = lost = lost_of = still_wrong = estimates = 0
    parallax = given = 0
    all_epe, all_way, w_known, v_known = [], [], 0, 0
    for window in windows:
        if window["moved_px"] >= 1:
            w_known += not math.isnan(window["true_angular"][0])
            v_known += not math.isnan(window["true_linear"][0])
            if not math.isnan(window["truth_px"]):
                zero_flow = math.isnan(window["epe_px"])
                all_epe.append(window["truth_px"] if zero_flow else window["epe_px"])
                all_way.append(window["truth_px"])
        moves, rests = window["moved_px"] >= 3, window["moved_px"] < 3
        moving, still = moving + moves, still + rests
        if not window["ok"]:
            continue
        estimates += 1
        covered, covered_still = covered + moves, covered_still + rests
        if not math.isnan(window["epe_px"]):
            epe.append(window["epe_px"])
            way.append(window["truth_px"])
            if moves:
                lost_of += 1
                lost += window["epe_px"] > window["truth_px"] / 2
        error = [math.degrees(window["angular"][i] - window["true_angular"][i]) for i in range(3)]
        length = math.hypot(*error)
        w2.append(length**2)
        true2.append(sum(math.degrees(a) ** 2 for a in window["true_angular"]))
        covariance = np.degrees(np.degrees(window["angular_covariance"]))
        inverse = np.linalg.inv(covariance)
        nees_w.append(_quadratic(error, inverse) / 3)
        sigma = math.sqrt(_quadratic([e / length for e in error], covariance))
        bad_w = length > 5 and length > 3 * sigma
        still_wrong += rests and length > 1 and length > 3 * sigma
        bad_v = False
        gives = not math.isnan(window["linear"][0])
        if window["parallax_px"] > 2:
            parallax += 1
            given += gives
        if gives and not math.isnan(window["true_linear"][0]):
            angle, nees, sigma_v = _direction(window)
            nees_v.append(nees)
            bad_v = angle > 20 and angle > 3 * sigma_v
            if window["parallax_px"] > 2:
                v.append(angle)
        wrong_w, wrong_v, wrong = wrong_w + bad_w, wrong_v + bad_v, wrong + (bad_w or bad_v)
    v.sort()
    return {
        "gain_w_windows": w_known,
        "gain_v_windows": v_known,
        "epe_share_all": 100 * sum(all_epe) / sum(all_way),
        "epe_share_windows": len(all_way),
        "windows": len(windows),
        "estimates": estimates,
        "moving": moving,
        "still": still,
        "covered_moving": 100 * covered / moving,
        "covered_still": 100 * covered_still / still,
        "flow_moving": 100 * lost_of / moving,
        "epe_px": sum(epe) / len(epe),
        "truth_px": sum(way) / len(way),
        "epe_percent": 100 * sum(epe) / sum(way),
        "w_rms": math.sqrt(sum(w2) / len(w2)),
        "w_true_rms": math.sqrt(sum(true2) / len(true2)),
        "w_percent": 100 * math.sqrt(sum(w2) / sum(true2)),
        "v_median": (v[(len(v) - 1) // 2] + v[len(v) // 2]) / 2,
        "v_reversed": 100 * sum(a > 90 for a in v) / len(v),
        "v_windows": len(v),
        "v_given": 100 * given / parallax,
        "nees_w": sum(nees_w) / len(nees_w),
        "nees_v": sum(nees_v) / len(nees_v),
        "confident_wrong": 100 * wrong / estimates,
        "confident_wrong_w": 100 * wrong_w / estimates,
        "confident_wrong_v": 100 * wrong_v / estimates,
        "lost": 100 * lost / lost_of,
        "still_wrong": 100 * still_wrong / still,
    }


def _direction(window: np.void) -> tuple[float, float, float]:
    """Angle (deg), NEES and sigma (deg) of v, with another basis of the tangent plane."""
    estimate, true = window["linear"], window["true_linear"]
    angle = math.acos(max(-1.0, min(1.0, sum(estimate[i] * true[i] for i in range(3)))))
    helper = np.eye(3)[int(np.argmin(np.abs(estimate)))]
    first = np.cross(estimate, helper)
    first /= np.linalg.norm(first)
    second = np.cross(estimate, first)
    a, b = float(first @ true), float(second @ true)
    unit = [a / math.hypot(a, b), b / math.hypot(a, b)]
    basis = np.stack([first, second])
    covariance = basis @ window["linear_covariance"] @ basis.T
    error = [angle * unit[0], angle * unit[1]]
    nees = _quadratic(error, np.linalg.inv(covariance)) / 2
    return math.degrees(angle), nees, math.degrees(math.sqrt(_quadratic(unit, covariance)))


def _quadratic(vector: list[float], matrix: np.ndarray) -> float:
    size = len(vector)
    return float(
        sum(vector[i] * matrix[i][j] * vector[j] for i in range(size) for j in range(size))
    )
