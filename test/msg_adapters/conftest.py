"""Puts the encoders beside the tests on the path, and offers serialisers independent of ours."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

RECORDINGS = Path(__file__).parents[3] / "shared" / "data" / "event_packets"


@pytest.fixture(scope="session")
def recordings() -> Path:
    if not RECORDINGS.is_dir():
        pytest.skip("no real recordings beside the repository (../shared/data)")
    return RECORDINGS


@pytest.fixture(params=["cdr", "ros1"])
def serialization(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)
