"""Hold a few short recordings to recorded figures, so that a loss of accuracy fails the tests.

`python -m benchmarks.scoreboard.gates` measures them and shows the figures beside the recorded
ones; with --record it writes them down as the new ones.
"""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from benchmarks.scoreboard.figures import Figures, figures_of
from benchmarks.scoreboard.observe import observe
from benchmarks.scoreboard.simulated_subjects import RandomSubject, SceneSubject
from benchmarks.scoreboard.subjects import SHARED_DATA, Material, Subject, shared_subjects
from emoflow_ros import __version__
from emoflow_ros.cli import run
from emoflow_ros.config import load_config

FILE = Path(__file__).with_name("gates.yaml")
MARGIN = 0.25
_HEADER = "# Written by `python -m benchmarks.scoreboard.gates --record`.\n"


@dataclass(frozen=True)
class Gate:
    """A figure that must not become worse.

    Attributes:
        figure: its name in Figures.
        slack: what it may always change by: other processors round differently, and a quarter of
            a small figure is little.
        least: whether it must not fall rather than not rise.
    """

    figure: str
    slack: float
    least: bool = False

    def bound(self, recorded: float) -> float:
        """Worst value that passes: a quarter of the recorded one away, or the slack."""
        change = max(MARGIN * recorded, self.slack)
        return recorded - change if self.least else recorded + change

    def passes(self, value: float, recorded: float) -> bool:
        """Whether a value is within the bound; one that is missing is not."""
        bound = self.bound(recorded)
        return value >= bound if self.least else value <= bound


GATES = (
    Gate("covered_moving", 5.0, least=True),
    Gate("epe_px", 0.05),
    Gate("w_rms", 0.2),
    Gate("v_median", 1.0),
    Gate("nees_w", 0.5),
    Gate("confident_wrong", 0.0),  # a share of few windows: none may be added
)


def gate_subjects(data: Path = SHARED_DATA) -> list[Subject]:
    """List the six recordings; the real one may be missing."""
    scenes = [
        SceneSubject("calm", 3, 0.5),
        SceneSubject("forward", 3, 0.5),
        SceneSubject("agile", 3, 0.4),
    ]
    random = [RandomSubject(seed, None, duration_s=0.6) for seed in (12, 15)]
    real = [s for s in shared_subjects(data) if s.name == "real/shapes_rotation_start"]
    return [*scenes, *random, *real]


def measure(subject: Subject) -> dict[str, float]:
    """Measure one recording with the default profile; figures that it has, by name."""
    material: Material = subject.load()
    figures: Figures = figures_of(observe(material, load_config()), material.gyro_scale)
    values = {gate.figure: float(getattr(figures, gate.figure)) for gate in GATES}
    return {name: round(value, 3) for name, value in values.items() if math.isfinite(value)}


def recorded() -> dict[str, dict[str, float]]:
    """Read the recorded figures by recording."""
    return dict(yaml.safe_load(FILE.read_text(encoding="utf-8"))["recordings"])


def failures(values: Mapping[str, float], expected: Mapping[str, float]) -> list[str]:
    """Say in a line each which gates a recording does not pass."""
    return [
        f"{gate.figure} is {values.get(gate.figure, math.nan):.3f}, bound "
        f"{gate.bound(expected[gate.figure]):.3f} (recorded {expected[gate.figure]:.3f})"
        for gate in GATES
        if gate.figure in expected
        and not gate.passes(values.get(gate.figure, math.nan), expected[gate.figure])
    ]


def main() -> int:
    """Entry point."""
    return run(_run)


def _run() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scoreboard.gates",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--record", action="store_true", help="write the figures down")
    options = parser.parse_args()
    before = recorded() if FILE.exists() else {}
    found = {}
    for subject in gate_subjects():
        if subject.missing:
            print(f"{subject.name}: missing ({subject.missing}); its figures stay")
            found[subject.name] = before.get(subject.name, {})
            continue
        found[subject.name] = measure(subject)
        _show(subject.name, found[subject.name], before.get(subject.name, {}))
    if options.record:
        _write(found)
        print(f"written to {FILE}")


def _show(name: str, values: Mapping[str, float], before: Mapping[str, float]) -> None:
    words: Sequence[str] = [f"{k} {v:g} ({before.get(k, math.nan):g})" for k, v in values.items()]
    print(f"{name}: {', '.join(words)}")
    for line in failures(values, before):
        print(f"  fails: {line}")


def _write(found: Mapping[str, Mapping[str, Any]]) -> None:
    document = {
        "date": datetime.now(UTC).date().isoformat(),
        "version": __version__,
        "recordings": {name: dict(values) for name, values in found.items()},
    }
    FILE.write_text(_HEADER + yaml.safe_dump(document, sort_keys=False), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
