import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_estimators import Recorder

from emoflow_ros.config import Config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import flow_to_rgb
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.node.painter import Painter
from emoflow_ros.node.tasks import Picture, Wishes

CAMERA = Camera(64, 48, 50.0, 40.0, 32.0, 24.0)
MS = 1_000_000


class CountedFlow:
    """A flow of (100, 0) px/s that counts what it is asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def velocity(self, t: int) -> np.ndarray:
        self.asked.append("velocity")
        return np.tile(np.float32([100, 0]), (CAMERA.height, CAMERA.width, 1))

    def tracks(self, points: np.ndarray, times: list[int]) -> np.ndarray:
        self.asked.append("tracks")
        since = (np.array(times) - times[0]) / 1e9
        return points + since[:, None, None] * (100.0, 0.0)


def window(start_ms: int = 0) -> Window:
    t = np.array([start_ms * MS, (start_ms + 20) * MS])
    events = Events(np.array([10, 12], np.uint16), np.array([5, 5], np.uint16), t, t >= 0)
    return Window(start_ms * MS, (start_ms + 20) * MS, events)


def estimate(flow: CountedFlow | None, of: Window) -> Estimate:
    return replace(Recorder(CAMERA, Config()).estimate(of), flow=flow)


def test_nothing_is_computed_that_nobody_wants() -> None:
    flow = CountedFlow()
    assert Painter(CAMERA).draw(Wishes(), estimate(flow, window()), window()) == {}
    assert flow.asked == []


@pytest.mark.parametrize(
    ("picture", "asked", "shape", "dtype"),
    [
        (Picture.FLOW, {"velocity"}, (48, 64, 2), np.float32),
        (Picture.COLOR, {"velocity"}, (48, 64, 3), np.uint8),
        (Picture.EVENTS, {"tracks"}, (48, 64), np.uint8),
        (Picture.TRACKS, {"tracks"}, (12 * 2, 2, 4), np.float32),
    ],
)
def test_one_picture_costs_no_other(
    picture: Picture, asked: set[str], shape: tuple[int, ...], dtype: type
) -> None:
    flow = CountedFlow()
    drawn = Painter(CAMERA).draw(Wishes((picture,), tracks=12), estimate(flow, window()), window())
    assert set(drawn) == {picture}
    assert set(flow.asked) == asked
    assert drawn[picture].shape == shape
    assert drawn[picture].dtype == dtype


def test_flow_is_evaluated_once_for_its_image_and_its_colours() -> None:
    flow = CountedFlow()
    wishes = Wishes((Picture.FLOW, Picture.COLOR), flow_color_max=200.0)
    drawn = Painter(CAMERA).draw(wishes, estimate(flow, window()), window())
    assert flow.asked == ["velocity"]
    expected = flow_to_rgb(drawn[Picture.FLOW], 200.0)
    np.testing.assert_array_equal(drawn[Picture.COLOR], expected)


@pytest.mark.parametrize("stride", [2, 3, 7])
def test_flow_image_holds_every_so_many_th_pixel_and_the_colours_all(stride: int) -> None:
    class Ramp(CountedFlow):
        def velocity(self, t: int) -> np.ndarray:
            x, y = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
            return np.stack([x, y], axis=-1).astype(np.float32)

    wishes = Wishes((Picture.FLOW, Picture.COLOR), flow_stride=stride)
    drawn = Painter(CAMERA).draw(wishes, estimate(Ramp(), window()), window())
    flow = drawn[Picture.FLOW]
    assert flow.shape == (-(-48 // stride), -(-64 // stride), 2)
    assert flow[3, 5].tolist() == [5 * stride, 3 * stride]
    np.testing.assert_array_equal(drawn[Picture.COLOR], flow_to_rgb(Ramp().velocity(0), None))


def test_no_flow_no_pictures() -> None:
    wishes = Wishes(tuple(Picture), tracks=3)
    assert Painter(CAMERA).draw(wishes, estimate(None, window()), window()) == {}


def test_tracks_go_on_over_windows() -> None:
    """Two px to the right per window of 20 ms, at 50 px per unit of the plane."""
    painter, wishes = Painter(CAMERA), Wishes((Picture.TRACKS,), tracks=12)
    lines = []
    for start_ms in (0, 20, 200):
        of = window(start_ms)
        lines.append(painter.draw(wishes, estimate(CountedFlow(), of), of)[Picture.TRACKS])
    first, second, third = lines
    np.testing.assert_allclose(first[0, 0], [(7.5 - 32) / 50, (7.5 - 24) / 40, 1, 0], rtol=1e-6)
    np.testing.assert_allclose(first[:, 1, 0] - first[:, 0, 0], 0.02, atol=1e-6)
    # Three of the 12 points began anew, nine have two windows behind them.
    assert len(first) == 12 * 2
    assert len(second) == 9 * 2 + 12 * 2
    fresh = second[..., 3]
    np.testing.assert_allclose(np.unique(fresh.round(3)), [0, 0.25, 0.5, 0.75, 1])
    old = second[:18].reshape(2, 9, 2, 4)
    np.testing.assert_allclose(old[0, :, 1], old[1, :, 0], atol=1e-6)
    # After a gap all of them begin anew.
    assert len(third) == 12 * 2
    np.testing.assert_array_equal(third[:, :, :3], first[:, :, :3])


def test_profile_for_large_images_holds_one_in_shared_memory() -> None:
    path = Path(__file__).resolve().parents[2] / "config" / "dds" / "fastdds_large_images.xml"
    names = {"x": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}
    root = ElementTree.parse(path).getroot()
    [size] = root.findall(".//x:segment_size", names)
    [longest] = root.findall(".//x:maxMessageSize", names)
    assert size.text is not None and longest.text is not None
    assert int(size.text) >= 4 * int(longest.text)
    assert int(longest.text) > 8 * 346 * 260
    used = [t.text for t in root.findall(".//x:userTransports/x:transport_id", names)]
    made = [t.text for t in root.findall(".//x:transport_descriptor/x:transport_id", names)]
    assert used == made == ["shared_memory", "udp"]
