from collections.abc import Iterator

import pytest
import torch

from emoflow_ros.core.geometry.camera import Camera


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def small_camera() -> Camera:
    return Camera(80, 60, 70.0, 72.0, 39.0, 31.0, "plumb_bob", (-0.2, 0.05, 1e-3, -2e-3))
