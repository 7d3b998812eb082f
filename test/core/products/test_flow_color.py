import numpy as np
import pytest

from emoflow_ros.core.products.pictures import color_circle, color_wheel, flow_to_rgb


def test_circle_has_the_published_steps():
    circle = color_circle()
    assert circle.shape == (55, 3)
    np.testing.assert_allclose(circle[0], [1, 0, 0])
    np.testing.assert_allclose(circle[15], [1, 1, 0])
    np.testing.assert_allclose(circle[21], [0, 1, 0])
    np.testing.assert_allclose(circle[25], [0, 1, 1])
    np.testing.assert_allclose(circle[36], [0, 0, 1])
    np.testing.assert_allclose(circle[49], [1, 0, 1])
    np.testing.assert_allclose(circle[3], [1, 0.2, 0])


@pytest.mark.parametrize(
    ("vector", "rgb"),
    [
        ((0.0, 0.0), (255, 255, 255)),  # still
        ((1.0, 0.0), (255, 0, 0)),  # right, at full length
        ((0.5, 0.0), (255, 128, 128)),  # half as long: half as saturated
        ((2.0, 0.0), (191, 0, 0)),  # too long: darkened
        ((0.0, 1.0), (255, 234, 0)),  # down: 13.75 of 55 steps
        ((np.nan, 1.0), (0, 0, 0)),  # unknown
    ],
)
def test_color_of_a_vector(vector, rgb):
    image = flow_to_rgb(np.array([[vector]]), longest=1.0)
    np.testing.assert_array_equal(image[0, 0], rgb)


def test_longest_defaults_to_the_99th_percentile():
    flow = np.zeros((1, 101, 2))
    flow[0, :, 0] = np.arange(101)
    np.testing.assert_array_equal(flow_to_rgb(flow)[0, 99], [255, 0, 0])


def test_wheel_is_a_disc_on_white():
    wheel = color_wheel(101)
    np.testing.assert_array_equal(wheel[0, 0], [255, 255, 255])
    np.testing.assert_array_equal(wheel[50, 50], [255, 255, 255])
    np.testing.assert_array_equal(wheel[50, 100], [255, 0, 0])
