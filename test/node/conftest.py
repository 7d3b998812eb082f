"""Let the worker process find the fake estimators by name, and tests their helpers."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from supervisor_bench import WAIT_S, Bench


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    """Start supervisors with a fake estimator each, and end them."""
    benches: list[Bench] = []

    def make(estimator: str, **kwargs: Any) -> Bench:
        benches.append(Bench(estimator, **kwargs))
        benches[-1].supervisor.start()
        assert benches[-1].supervisor.ready.wait(WAIT_S)
        return benches[-1]

    yield make
    for made in benches:
        made.supervisor.stop()
