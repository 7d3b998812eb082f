"""Puts the encoders beside the tests on the path, and registers the profile of `make fuzz`."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

# Every decoder has four property tests or more: two properties in two serialisations.
FUZZ_INPUTS = 1_000_000
FUZZ_TESTS = 4
# Without a database: its entries would be replayed and not count as new inputs.
settings.register_profile("fuzz", max_examples=FUZZ_INPUTS // FUZZ_TESTS, database=None)

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
