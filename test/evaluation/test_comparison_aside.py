"""Windows are compared with the truth in a thread, while the next one is estimated."""

import threading
import time

import numpy as np
import pytest
from test_window_run import CAMERA, KnownErrors, run, spin

from emoflow_ros.core.types.events import WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation import window_run
from emoflow_ros.evaluation.estimates_file import EstimatesWriter, read_estimates
from emoflow_ros.evaluation.run_progress import Checkpoint, Progress
from emoflow_ros.evaluation.window_run import proceed
from emoflow_ros.readers import open_recording
from emoflow_ros.truth import load_truth

PATIENCE_S = 600.0  # only what hangs takes so long, also on a busy machine


class InStep(KnownErrors):
    """Notes the windows that have begun."""

    def __init__(self):
        super().__init__()
        self.begun = [threading.Event() for _ in range(5)]

    def estimate(self, window):
        self.begun[self.calls].set()
        return super().estimate(window)


def test_the_next_window_is_estimated_while_one_is_compared(tmp_path, monkeypatch):
    """Each comparison waits until the next window has begun; results come in their order."""
    estimator, assess = InStep(), window_run.assess
    in_time = []

    def patient(index, *arguments):
        if index < 4:
            in_time.append(estimator.begun[index + 1].wait(PATIENCE_S))
        return assess(index, *arguments)

    monkeypatch.setattr(window_run, "assess", patient)
    done = run(spin(tmp_path), estimator)
    assert in_time == [True] * 4
    assert [w.index for w in done.windows] == list(range(5))
    assert np.diff([w.t_start for w in done.windows]).tolist() == [100_000_000] * 4


@pytest.mark.parametrize("last", [2, 5])
def test_what_is_wrong_with_the_truth_ends_the_run(tmp_path, monkeypatch, last):
    """Also at the last window, after which nothing is estimated."""
    assess = window_run.assess

    def damaged(index, *arguments):
        if index == last - 1:
            raise InputError("truth.bag", "damaged", "copy it again")
        return assess(index, *arguments)

    monkeypatch.setattr(window_run, "assess", damaged)
    with pytest.raises(InputError, match=r"truth\.bag: damaged"):
        run(spin(tmp_path))


def test_ctrl_c_keeps_the_window_that_is_being_compared(tmp_path, monkeypatch):
    """It comes in the third window; the second one is compared to its end, and in the file."""
    estimator, assess = KnownErrors(interrupt_at=3), window_run.assess
    interrupted = threading.Event()
    estimate = estimator.estimate

    def tell(window):
        try:
            return estimate(window)
        except KeyboardInterrupt:
            interrupted.set()
            raise

    estimator.estimate = tell

    def late(index, *arguments):
        assert index == 0 or interrupted.wait(PATIENCE_S)
        return assess(index, *arguments)

    monkeypatch.setattr(window_run, "assess", late)
    file = tmp_path / "estimates.h5"
    with EstimatesWriter(file, camera=CAMERA, source="", configuration={}) as writer:
        done = run(spin(tmp_path), estimator, writer=writer)
    assert done.interrupted and [w.index for w in done.windows] == [0, 1]
    assert len(read_estimates(file)) == 2


def test_a_checkpoint_has_the_results_of_all_windows_that_its_estimator_has_seen(
    tmp_path, monkeypatch
):
    estimator, assess, saved = KnownErrors(), window_run.assess, []

    class EachWindow(Checkpoint):
        def is_due(self):
            return True

        def save(self, progress):
            saved.append((estimator.calls, len(progress.windows), len(progress.pending)))

    def slow(*arguments):
        time.sleep(0.05)
        return assess(*arguments)

    monkeypatch.setattr(window_run, "assess", slow)
    with open_recording(spin(tmp_path)) as recording:
        proceed(
            recording,
            Progress(estimator, WindowSlicer(WindowPolicy(duration_ms=100.0))),
            load_truth(recording),
            checkpoint=EachWindow(tmp_path / "checkpoint.pickle", {}),
        )
    assert [calls for calls, _, _ in saved] == [1, 2, 3, 4, 5]
    assert all(calls == results for calls, results, _ in saved)


def test_what_is_wrong_with_the_truth_is_told_after_ctrl_c(tmp_path, monkeypatch):
    """It comes while the window before is compared."""

    def damaged(*_):
        time.sleep(0.05)
        raise InputError("truth.bag", "damaged", "copy it again")

    monkeypatch.setattr(window_run, "assess", damaged)
    with pytest.raises(InputError, match=r"truth\.bag: damaged"):
        run(spin(tmp_path), KnownErrors(interrupt_at=2))
