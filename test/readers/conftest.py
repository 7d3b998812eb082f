"""What the tests of readers share."""

import pytest

from emoflow_ros.readers.bag_files import say_once


@pytest.fixture(autouse=True)
def _every_test_hears_every_line():
    say_once.cache_clear()
