import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.known import Structure

LATTICE = Lattice(346, 260, 14, 11)
NODES = 14 * 11
EPIPOLAR = NodeEpipolar(Camera(346, 260, 226.4, 226.2, 173.6, 133.7), LATTICE, 0.7)
SIDEWAYS, FORWARD = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
W = np.array([0.01, -0.02, 0.03])
EVIDENCE = np.tile(5.0 * np.eye(2), (NODES, 1, 1))
STILL = np.zeros((NODES, 2))


def relief(pixels):
    """Inverse depth that varies over the image, linearly."""
    return 0.02 + 1e-4 * pixels[:, 0] - 5e-5 * pixels[:, 1]


RELIEF = relief(LATTICE.pixels)


def observe(v, predicted=None, inverse_depth=RELIEF) -> Structure:
    flow = (EPIPOLAR.a @ v) * inverse_depth[:, None] + EPIPOLAR.b @ W
    return Structure.observe(EPIPOLAR, flow, (W, v), EVIDENCE, predicted)


def predict(structure, flow=STILL, windows=1.0, v=SIDEWAYS, drift=0.0) -> Structure:
    return structure.predict(LATTICE, EPIPOLAR, flow, windows, v, drift)


def test_inverse_depth_is_read_from_the_flow_along_the_line():
    np.testing.assert_allclose(observe(SIDEWAYS).inverse_depth, RELIEF, rtol=1e-4)


def test_flow_across_the_line_changes_nothing():
    flow = (EPIPOLAR.a @ SIDEWAYS) * RELIEF[:, None] + EPIPOLAR.b @ W + np.array([0, 2.0])
    structure = Structure.observe(EPIPOLAR, flow, (W, SIDEWAYS), EVIDENCE, None)
    np.testing.assert_allclose(structure.inverse_depth, RELIEF, rtol=1e-4)


def test_information_grows_with_parallax():
    """Going forward nothing is seen at the focus of expansion and most at the corners."""
    information = observe(FORWARD).information
    radius = np.linalg.norm(LATTICE.pixels - (173.6, 133.7), axis=1)
    expected = information[0] * (radius / radius[0]) ** 2
    np.testing.assert_allclose(information, expected, rtol=1e-2, atol=1e-2 * information[0])


def test_what_was_predicted_adds_to_what_is_seen():
    once = observe(SIDEWAYS)
    twice = observe(SIDEWAYS, predicted=once)
    np.testing.assert_allclose(twice.information, 2 * once.information)


def test_nodes_beyond_the_lens_know_nothing():
    camera = Camera(400, 400, 100.0, 100.0, 199.5, 199.5, "equidistant", (0.0,) * 4)
    epipolar = NodeEpipolar(camera, Lattice(400, 400, 9, 9), 0.7)
    evidence = np.tile(np.eye(2), (81, 1, 1))
    structure = Structure.observe(epipolar, np.ones((81, 2)), (W, SIDEWAYS), evidence, None)
    np.testing.assert_array_equal(structure.information[~epipolar.usable], 0)
    assert np.isfinite(structure.inverse_depth).all()


def test_prediction_moves_structure_with_the_flow():
    """What lies under a node now was half a flow vector before it, half a window ago."""
    flow = np.tile([12.0, -6.0], (NODES, 1))
    predicted = predict(Structure(RELIEF, np.ones(NODES)), flow, windows=0.5)
    source = LATTICE.pixels - (6, -3)
    inside = ((source >= 0) & (source <= (345, 259))).all(axis=1)
    np.testing.assert_allclose(predicted.inverse_depth[inside], relief(source)[inside], rtol=2e-2)
    assert (predicted.information[~inside] < 1e-6 * predicted.information[inside].min()).all()


def test_certain_nodes_outweigh_uncertain_neighbours():
    information = np.where(LATTICE.pixels[:, 0] < 200, 1e4, 1e-6)
    flow = np.tile([10.0, 0.0], (NODES, 1))
    predicted = predict(Structure(RELIEF, information), flow)
    first = np.flatnonzero(LATTICE.pixels[:, 0] > 200)[0]  # its source lies between the two
    known = RELIEF[first - 11]
    assert predicted.inverse_depth[first] == pytest.approx(known, rel=0.02)
    assert predicted.information[first] < predicted.information[first - 11]


@pytest.mark.parametrize("drift", [0.0, 0.2, 1.0])
def test_prediction_loses_certainty_by_drift(drift):
    sharp = Structure(RELIEF, np.full(NODES, 1e9))
    variance = 1 / predict(sharp, drift=drift).information
    floor = 1 / predict(sharp).information
    np.testing.assert_allclose(variance - floor, (drift * RELIEF) ** 2, rtol=1e-3, atol=1e-8)
    assert (floor > 1e-9).all()


def test_prediction_of_nothing_is_nothing():
    predicted = predict(Structure(RELIEF, np.zeros(NODES)))
    assert (predicted.information < 1e-8).all()
    assert np.isfinite(predicted.inverse_depth).all()
