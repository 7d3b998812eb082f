"""Measure `evaluate` on a simulated recording in MVSEC's format: faster than real time or not.

A recording is simulated and written as MVSEC's files: a ROS 1 bag of events, one of poses and
depth, and the npz of true flow. Then the executable `evaluate` runs over all of them with the
profile `realtime`, in a process of its own on two cores, report included. Its wall time is split
into the estimator's, the rest of the run (reading, comparison, estimates.h5), and start and report.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks._rows import Row, lay_out
from benchmarks._scoring import SCENES
from emoflow_ros.cli import run
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import machine, versions
from emoflow_ros.simulation.recording import davis346, simulate
from emoflow_ros.simulation.recording_files import OutputPaths, write_recording

START = 1_500_000_000_000_000_000
CORES = 2
TARGET_FACTOR = 3.0
_COMMAND = "import sys; from emoflow_ros.commands.evaluate import main; sys.exit(main())"


def main() -> int:
    """Run the benchmark."""
    return run(lambda: _measure(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="example, for a quick look: python benchmarks/offline.py --duration 5",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--scene", default="calm", choices=SCENES, metavar="SCENE", help="default: calm")
    add("--seed", type=int, default=0, help="default: 0")
    add(
        "--duration",
        type=float,
        default=60.0,
        metavar="S",
        help="seconds (default: 60, of which the files take 2.2 GB beside --out)",
    )
    add("--fps", type=int, default=250, help="rendered images per second (default: 250)")
    add(
        "--out",
        type=Path,
        default=Path("out/benchmarks/offline.json"),
        help="default: out/benchmarks/offline.json; the report lies in the folder `offline` there",
    )
    return parser


def _measure(args: argparse.Namespace) -> None:
    if not 1 <= args.duration <= 600:
        raise InputError("--duration", f"{args.duration:g} s", "give a length in [1, 600] s")
    results = args.out.with_suffix("")
    results.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=args.out.parent) as folder:
        paths = OutputPaths.within(Path(folder), args.scene, "rosbag1")
        _write(paths, args)
        megabytes = sum(path.stat().st_size for path in paths) / 1e6
        load = os.getloadavg()[0]
        wall, cpu = _evaluate(paths, results)
    done = json.loads((results / "report.json").read_text(encoding="utf-8"))
    report = {
        "machine": machine(),
        "load_average_at_start": load,
        "versions": versions(),
        "cores_used": CORES,
        "scene": args.scene,
        "seed": args.seed,
        "duration_s": args.duration,
        "megabytes": megabytes,
        "configuration": done["configuration"],
        **figures(done, wall, cpu),
    }
    report["rows"] = [row(report).as_dict()]
    print(table(report))
    args.out.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(f"written to {args.out}")


def _write(paths: OutputPaths, args: argparse.Namespace) -> None:
    recording = simulate(
        args.scene,
        duration_s=args.duration,
        seed=args.seed,
        camera=davis346("equidistant"),
        fps=args.fps,
        start_ns=START,
        progress=True,
    )
    write_recording(recording, paths, "rosbag1", progress=True)


def _evaluate(paths: OutputPaths, results: Path) -> tuple[float, float]:
    """Run the executable over all files; its wall and processor time in s."""
    cores = sorted(os.sched_getaffinity(0))[:CORES]
    truth = ("--gt", str(paths.truth), str(paths.flow))
    command = [sys.executable, "-c", _COMMAND, str(paths.data), *truth, "--out", str(results)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    finished = subprocess.run(
        command, check=False, preexec_fn=lambda: os.sched_setaffinity(0, cores)
    )
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if finished.returncode:
        raise InputError("evaluate", f"exit code {finished.returncode}", "see its message above")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def figures(done: Mapping[str, Any], wall_s: float, cpu_s: float) -> dict[str, Any]:
    """Compute what is reported from a run's report.json, its wall and processor time."""
    estimating = sum(window["runtime_s"] for window in done["windows"])
    return {
        "windows": done["windows_total"],
        "windows_ok": done["windows_ok"],
        "events": done["events"],
        "recorded_s": done["recorded_s"],
        "wall_s": wall_s,
        "processor_s": cpu_s,
        "parts_s": {
            "estimation": estimating,
            "reading, comparison, writing": done["wall_s"] - estimating,
            "start and report": wall_s - done["wall_s"],
        },
        "real_time_factor": done["recorded_s"] / wall_s,
        "real_time_factor_of_run": done["wall_real_time_factor"],
        "real_time_factor_of_estimator": done["summary"]["real_time_factor"]["value"],
        "epe_px": done["summary"]["epe_px"]["value"],
    }


def row(report: Mapping[str, Any]) -> Row:
    """Hold a run against its target."""
    return Row("evaluate: times real time", report["real_time_factor"], at_least=TARGET_FACTOR)


def table(report: Mapping[str, Any]) -> str:
    """Lay a report out for people."""
    lines = [
        f"{report['scene']}, {report['recorded_s']:.1f} s, {report['windows']} windows, "
        f"{report['events'] / 1e6:.1f} million events, files of {report['megabytes']:.0f} MB",
        f"{report['machine']['processor']}, {report['cores_used']} cores, load before "
        f"{report['load_average_at_start']:.1f}; "
        + ", ".join(f"{name} {version}" for name, version in report["versions"].items()),
        "",
        lay_out([row(report)]),
        f"  without start and report        {report['real_time_factor_of_run']:7.2f}",
        f"  of the estimator alone          {report['real_time_factor_of_estimator']:7.2f}",
    ]
    lines += [f"{name:<32}{seconds:9.1f} s" for name, seconds in report["parts_s"].items()]
    lines += [
        f"{'processor time':<32}{report['processor_s']:9.1f} s",
        f"{'flow EPE':<32}{report['epe_px']:9.2f} px",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
