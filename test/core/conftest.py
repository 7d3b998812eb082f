"""Makes the helpers of these tests importable; the epipolar constraint behind three lenses."""

import sys
from pathlib import Path

import pytest

from emoflow_ros.core.lattice.egomotion import NodeEpipolar

sys.path.insert(0, str(Path(__file__).parent))

from motion_fields import INLIER_PX, LATTICE, LENSES, camera_with


@pytest.fixture(scope="module", params=LENSES)
def lens(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def epipolar(lens: str) -> NodeEpipolar:
    return NodeEpipolar(camera_with(lens), LATTICE, INLIER_PX)
