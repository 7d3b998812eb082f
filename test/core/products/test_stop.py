"""The latest twist where a turning camera stops: nothing of the turn is left."""

import numpy as np
import pytest
from present_runs import CONFIG, LATE_NS, SLICE_NS

from emoflow_ros.core.products.present_motion import PresentMotion
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import NS_PER_MS, Window, WindowSlicer
from emoflow_ros.core.types.twist import PresentTwist
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation import recording as simulation
from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from emoflow_ros.simulation.scene import YAW, Scene, Step, Trajectory
from emoflow_ros.simulation.sensor import SensorModel

STOPS_S = 0.4


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    def turn(duration_s: float, rng: np.random.Generator) -> Scene:
        return Scene(simulation._room(rng), Trajectory(steps=(Step(YAW, 0.35, 0.0, STOPS_S),)))

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(simulation.SCENES, "turn", turn)
        return simulate("turn", duration_s=1.0, seed=0, fps=400, sensor=SensorModel(noise_hz=0.2))


@pytest.fixture(scope="module")
def estimates(recording: SimulatedRecording) -> list[Estimate]:
    estimator = make_estimator(recording.camera, CONFIG)
    return [estimator.estimate(w) for w in WindowSlicer(CONFIG.window).push(recording.events)]


def degrees(w: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(w)))


def test_windows_after_the_stop_are_still(recording, estimates):
    after = [e for e in estimates if e.t_start > (STOPS_S + 0.1) * 1e9]
    assert len(after) > 4
    assert [e.status for e in after] == [Status.STILL] * len(after)
    assert all(e.told for e in estimates)


def twists_of_now(
    recording: SimulatedRecording, estimates: list[Estimate], every_ms: int = 20
) -> list[PresentTwist]:
    """As the node has them: a window's estimate is there LATE_NS after its end."""
    present, known, found = PresentMotion(recording.camera, CONFIG.estimator), None, []
    for t in range(220 * NS_PER_MS, recording.t_end, every_ms * NS_PER_MS):
        there = [e for e in estimates if e.t_end + LATE_NS <= t]
        if there[-1] is not known:
            known = there[-1]
            present.know(known)
        first, last = np.searchsorted(recording.events.t, [t - SLICE_NS, t])
        twist = present.estimate(Window(t - SLICE_NS, t, recording.events[first:last]))
        assert twist is not None
        found.append(twist)
    return found


def test_twists_of_now_come_all_the_time_and_are_at_rest_20_ms_after_the_stop(recording, estimates):
    twists = twists_of_now(recording, estimates)
    assert len(twists) == 39
    true = [recording.truth.twist(f.twist.t)[1] for f in twists]
    assert max(map(degrees, true)) > 60
    after = [f for f in twists if f.twist.t > (STOPS_S + 0.02) * 1e9]
    assert len(after) > 25
    for found in after:
        assert degrees(found.twist.angular) < 1.0
        sigma = np.degrees(np.sqrt(np.diag(found.covariance)[3:]))
        assert (sigma < 2.0).all()
        assert not found.twist.linear.any() and 0 < found.covariance[0, 0] < 0.01
    errors = [f.twist.angular - w for f, w in zip(twists, true, strict=True)]
    squares = [
        e @ np.linalg.solve(f.covariance[3:, 3:], e) / 3
        for e, f in zip(errors, twists, strict=True)
    ]
    assert max(squares) < 9 and np.mean(squares) < 2


def test_without_a_bound_the_turn_would_go_on(recording, estimates):
    """What the newest events tell is what stops it."""
    from dataclasses import replace

    twists = twists_of_now(recording, [replace(e, bound=None) for e in estimates])
    after = [f for f in twists if (STOPS_S + 0.02) * 1e9 < f.twist.t < (STOPS_S + 0.1) * 1e9]
    assert max(degrees(f.twist.angular) for f in after) > 5
