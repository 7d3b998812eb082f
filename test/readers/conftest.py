"""What the tests of readers share."""

import pytest

from emoflow_ros.errors import say


@pytest.fixture(autouse=True)
def _every_test_hears_every_line():
    say.cache_clear()
