"""Simulated recordings and the estimates of their windows, for the latest twist."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from emoflow_ros.config import load_config
from emoflow_ros.core.products.present_motion import PresentMotion
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_MS, SLICE_MS, Window, WindowSlicer
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

SLICE_NS = round(SLICE_MS * NS_PER_MS)
LATE_NS = 60 * NS_PER_MS  # from a window's end until its estimate is there
CONFIG = load_config()


@dataclass
class Run:
    """Estimates of a recording's windows."""

    recording: SimulatedRecording
    estimates: list[Estimate]

    def slice(self, t_end: int) -> Window:
        events = self.recording.events
        first, last = np.searchsorted(events.t, [t_end - SLICE_NS, t_end])
        return Window(t_end - SLICE_NS, t_end, events[first:last])

    def present(self) -> PresentMotion:
        return PresentMotion(self.recording.camera, CONFIG.estimator)

    def angular(self, t: int) -> np.ndarray:
        return self.recording.truth.twist(t)[1]


@cache
def run(scene: str) -> Run:
    recording = simulate(scene, duration_s=1.2, seed=0, fps=500)
    estimator = make_estimator(recording.camera, CONFIG)
    windows = WindowSlicer(CONFIG.window).push(recording.events)
    return Run(recording, [estimator.estimate(window) for window in windows])


def last(scene: str) -> tuple[Run, Estimate]:
    its = run(scene)
    return its, [e for e in its.estimates if e.translation_observable][-2]


def degrees(error: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(error)))
