"""How sure the reader of a fit is of v, with and without other knowledge of w."""

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.fit import FreeFlow, LatticeFit
from emoflow_ros.core.lattice.preparation import WorkingImage
from emoflow_ros.core.lattice.reading import EstimateReader
from emoflow_ros.core.lattice.uncertainty import PossibleMotions
from emoflow_ros.core.types.estimate import MotionModel
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window

CAMERA = Camera(346, 260, 226.4, 226.2, 173.6, 133.7)
V = np.array([0.8, 0.0, 0.6])
ACROSS = np.array([0.0, 1.0, 0.0])
WINDOW = Window(0, 90 * NS_PER_MS, Events.empty())
VARIANCE = 0.01  # of the possible motions' v across V, rad^2


@pytest.fixture
def reader() -> EstimateReader:
    """Of a camera that passes along V, whose possible motions differ in v alone."""
    config = load_config("realtime").estimator
    image = WorkingImage.of(CAMERA)
    lattice = Lattice.with_spacing(*image.camera.size, config.spacing_px)
    epipolar = NodeEpipolar(image.camera, lattice, config.dec_inlier_px)
    fit = LatticeFit(lattice, epipolar, config)
    flow = 0.05 * (epipolar.a @ V)
    fit.flow = np.repeat(flow[:, None], lattice.times, 1).reshape(lattice.shape).astype(np.float32)
    fit.motion = Motion.constant(np.zeros(3), V)
    fit.evidence[:] = np.eye(2)
    return EstimateReader(image, epipolar, fit, config)


def spread_counts(reader: EstimateReader, known) -> float:
    """Variance of v across V that a spread adds, over that of the spread."""
    free = FreeFlow(np.zeros((0, 2)), np.zeros((0, 2, 2)), known)

    def variance() -> float:
        found = reader.believe(WINDOW, free, MotionModel.FULL)
        return float(ACROSS @ found.covariance[3:, 3:] @ ACROSS)

    reader.possible = PossibleMotions()
    alone = variance()
    reader.possible = PossibleMotions(spread=np.diag([0.0, 0.0, 0.0, *VARIANCE * ACROSS]))
    return (variance() - alone) / VARIANCE


def test_the_spread_of_v_counts_more_with_a_gyro(reader):
    """Also with one that tells nothing: how the motions were weighed is what matters."""
    by_events, with_gyro = (
        spread_counts(reader, known) for known in (None, (np.zeros(3), np.zeros((3, 3))))
    )
    assert 0.5 < by_events < with_gyro
