"""The pictures of one window, against images made by hand."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import flow_to_rgb
from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.evaluation.run_progress import Example
from emoflow_ros.evaluation.window_results import assess
from emoflow_ros.report.documents import png_uri
from emoflow_ros.report.window_pictures import error_legend, window_pictures
from emoflow_ros.truth import TrueFlow, Truth

LENGTH_NS = 100_000_000
MOVER = (0x1F, 0x7F, 0xD8)
UNKNOWN = (0xDD, 0xDD, 0xDD)


class Constant:
    """All pixels move by (3, 4) px over the window."""

    def __init__(self, camera: Camera) -> None:
        self._shape = camera.height, camera.width, 2

    def displacement(self, t0: int, t1: int) -> np.ndarray:
        return np.full(self._shape, (3.0, 4.0), np.float32) * np.float32((t1 - t0) / LENGTH_NS)

    def tracks(self, points: np.ndarray, times) -> np.ndarray:
        moved = [points + np.array([3.0, 4.0]) * (t - times[0]) / LENGTH_NS for t in times]
        return np.stack(moved)


class Flows:
    description = "by hand"

    def __init__(self, true: TrueFlow) -> None:
        self._true = true

    def displacement(self, t0: int, t1: int) -> TrueFlow:
        return self._true


def camera_of(width: int, height: int) -> Camera:
    return Camera(width, height, float(width), float(width), width / 2, height / 2)


def example(camera: Camera, events: Events, truth: Truth) -> Example:
    window = Window(0, LENGTH_NS, events)
    estimate = Estimate(
        0, LENGTH_NS, LENGTH_NS // 2, Status.OK, Quality(events=len(events)), flow=Constant(camera)
    )
    return Example("Best window", window, estimate, assess(0, window, estimate, truth))


def events_at(*places: tuple[int, int]) -> Events:
    x, y = np.array(places, np.uint16).T
    t = np.full(len(x), LENGTH_NS // 2 - 1, np.int64)
    return Events(np.ascontiguousarray(x), np.ascontiguousarray(y), t, np.ones(len(x), np.bool_))


def true_flow(camera: Camera, *, moving: bool = False) -> TrueFlow:
    """The same motion, but for one pixel that is off by 6 px and the unknown first column."""
    displacement = np.full((camera.height, camera.width, 2), (3.0, 4.0), np.float32)
    displacement[10, 20] = (9.0, 4.0)
    valid = np.ones((camera.height, camera.width), np.bool_)
    valid[:, 0] = False
    mover = np.zeros_like(valid)
    mover[12:17, 12:17] = moving
    return TrueFlow(displacement, valid, mover if moving else None)


def test_a_window_with_its_truth():
    camera = camera_of(40, 30)
    truth = Truth(flows=Flows(true_flow(camera)))
    found = window_pictures(example(camera, events_at((5, 5), (6, 7)), truth), camera, truth)
    titles = [title for title, _ in found.panels]
    assert titles == [
        "Estimated flow",
        "True flow (black: unknown)",
        "Error (grey: truth unknown)",
        "Events before the warp",
        "Events warped to the middle",
    ]
    estimated, true, error, before, after = (image for _, image in found.panels)
    assert all(image.shape == (30, 40, 3) and image.dtype == np.uint8 for _, image in found.panels)
    assert found.longest_px == pytest.approx(5.0, abs=0.3)  # a quantile, one pixel is longer
    np.testing.assert_array_equal(
        estimated, flow_to_rgb(np.full((30, 40, 2), (3.0, 4.0)), found.longest_px)
    )
    assert (true[:, 0] == 0).all()
    np.testing.assert_array_equal(true[3, 3], estimated[3, 3])
    assert found.error_limit_px == 3.0
    assert tuple(error[4, 0]) == UNKNOWN
    palest, darkest = error_legend()[0, [0, -1]]
    np.testing.assert_array_equal(error[10, 20], darkest)
    np.testing.assert_array_equal(error[3, 3], palest)
    for image in (before, after):  # the events are at the window's middle already
        np.testing.assert_array_equal(np.argwhere((image != 255).any(axis=-1)), [[5, 5], [7, 6]])


def test_without_a_truth_there_is_no_error():
    camera = camera_of(40, 30)
    found = window_pictures(example(camera, events_at((5, 5)), Truth()), camera, Truth())
    assert [title for title, _ in found.panels] == [
        "Estimated flow",
        "Events before the warp",
        "Events warped to the middle",
    ]
    assert found.longest_px == pytest.approx(5.0)
    assert found.error_limit_px is None


@pytest.mark.parametrize(
    ("width", "known", "columns", "enlarged"),
    [(320, True, 3, True), (346, True, 3, False), (240, False, 4, True), (304, False, 4, False)],
)
def test_images_that_the_page_makes_larger_are_known(width, known, columns, enlarged):
    camera = camera_of(width, 30)
    truth = Truth(flows=Flows(true_flow(camera))) if known else Truth()
    found = window_pictures(example(camera, events_at((5, 5)), truth), camera, truth)
    assert (found.columns, found.enlarged) == (columns, enlarged)


def test_what_moves_by_itself_is_outlined():
    camera = camera_of(40, 30)
    truth = Truth(flows=Flows(true_flow(camera, moving=True)))
    found = window_pictures(example(camera, events_at((5, 5)), truth), camera, truth)
    title, error = found.panels[2]
    assert title == "Error (outlined: moves by itself)"
    outline = np.zeros((30, 40), np.bool_)
    outline[12:17, 12:17] = True
    outline[13:16, 13:16] = False
    np.testing.assert_array_equal((error == MOVER).all(axis=-1), outline)


def test_what_moves_by_itself_is_open_at_the_image_border_and_outlined_wider_in_large_images():
    camera = camera_of(1280, 720)
    true = true_flow(camera)
    moving = np.zeros((720, 1280), np.bool_)
    moving[100:200, :300] = True
    truth = Truth(flows=Flows(TrueFlow(true.displacement, true.valid, moving)))
    found = window_pictures(example(camera, events_at((5, 5)), truth), camera, truth)
    outline = np.zeros((360, 640), np.bool_)
    outline[50:100, :150] = True
    outline[52:98, :148] = False
    np.testing.assert_array_equal((found.panels[2][1] == MOVER).all(axis=-1), outline)


def test_images_of_large_sensors_are_smaller_and_show_every_event():
    camera = camera_of(1280, 720)
    events = events_at((0, 0), (1, 1), (1001, 501), (1279, 719))
    truth = Truth(flows=Flows(true_flow(camera)))
    found = window_pictures(example(camera, events, truth), camera, truth)
    assert {image.shape for _, image in found.panels} == {(360, 640, 3)}
    before = found.panels[3][1]
    places = [[0, 0], [250, 500], [359, 639]]
    np.testing.assert_array_equal(np.argwhere((before != 255).any(axis=-1)), places)


def test_events_in_the_last_column_and_row_are_shown_where_the_size_is_odd():
    camera = camera_of(701, 11)
    events = events_at((700, 0), (0, 10))
    found = window_pictures(example(camera, events, Truth()), camera, Truth())
    before = found.panels[1][1]
    assert before.shape == (6, 351, 3)
    np.testing.assert_array_equal(np.argwhere((before != 255).any(axis=-1)), [[0, 350], [5, 0]])


def test_images_come_back_from_the_page_pixel_by_pixel():
    image = np.random.default_rng(0).integers(0, 256, (7, 5, 3), np.uint8)
    kind, data = png_uri(image).split(",")
    assert kind == "data:image/png;base64"
    read = Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")
    np.testing.assert_array_equal(np.asarray(read), image)
