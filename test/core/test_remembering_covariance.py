"""How sure a remembered motion is told to be, by its patches and by its window."""

from dataclasses import replace

import pytest
from test_remembering import Run, run_of

from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.types.estimate import Estimate


@pytest.fixture(scope="module")
def calm() -> Run:
    return run_of("calm")


def last_of(run: Run, back: BackEndSettings | None = None, *, warm: bool = True) -> Estimate:
    """Estimate the sixth window by its last part, whose flow is said to be warm or cold."""
    camera = run.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    reader = RememberingEstimator(lattice, camera, lambda e, depths: e, back=back)
    memory = reader.nothing()
    for window in run.windows[:6]:
        found = lattice.estimate(window)
        found = replace(found, t_start=(found.t + 2 * found.t_start) // 3)
        found = replace(found, quality=replace(found.quality, warm=warm))
        memory, estimate = reader.step(memory, window, found)
    return estimate


def test_a_motion_is_less_sure_where_few_patches_are_found_again(calm: Run):
    law = BackEndSettings().errors
    sure = last_of(calm)
    losing = BackEndSettings(errors=replace(law, lost_share=1.1))
    unsure = last_of(calm, losing)
    assert (law.lost, law.lost_share) == (8.0, 0.1)
    assert unsure.covariance == pytest.approx(8 * sure.covariance)
    assert unsure.angular.tolist() == sure.angular.tolist()


def test_only_of_a_warm_fit_the_length_counts(calm: Run):
    warm, cold = last_of(calm), last_of(calm, warm=False)
    part = (warm.t_end - warm.t_start) / 1e9
    assert part < 0.9 * calm.windows[5].duration
    longer = calm.windows[5].duration / part
    assert cold.covariance[3:, 3:] == pytest.approx(longer * warm.covariance[3:, 3:])
    assert cold.covariance[:3, :3] == pytest.approx(warm.covariance[:3, :3])


def test_a_motion_is_less_sure_where_other_ways_are_as_likely(calm: Run):
    sure = last_of(calm, replace(BackEndSettings(), temperature=1e-9))
    as_likely = last_of(calm, replace(BackEndSettings(), temperature=1e9))
    of_w = [float(e.covariance[3:, 3:].trace()) for e in (sure, as_likely)]
    assert of_w[1] > 1.5 * of_w[0]
    assert sure.translation_observable
    assert as_likely.covariance[0, 0] > 4 * sure.covariance[0, 0]
