"""What patches look like under a flow, and what they learn from one that has turned."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_patches import (
    CAMERA,
    SETTINGS,
    along,
    error,
    of_brightness,
    rolled,
    slice_of,
    texture,
)

from emoflow_ros.core.front_end.appearance import completed_slopes, first_slopes
from emoflow_ros.core.front_end.appearance_kernels import cut_shaped, templates
from emoflow_ros.core.front_end.following import completed, follow
from emoflow_ros.core.front_end.patch_kernels import cut


def test_templates_show_slopes_along_the_flow_at_multiplied_offsets():
    y, x = np.mgrid[-12:13, -12:13].astype(np.float32)
    slopes = np.stack([np.stack([x * y, y]), np.stack([5 * x, 10 * y])])  # of two patches
    toward, shape = np.array([[1.0, 0.0], [0.6, 0.8]]), np.array([[0.9, 0.2], [-0.1, 1.1]])
    (same,) = templates(slopes, np.array([0]), toward, np.tile(np.eye(2), (2, 1, 1)))
    assert (same == x * y).all()
    (drawn,) = templates(slopes, np.array([1]), toward, np.stack([np.eye(2), shape]))
    before = np.linalg.inv(shape) @ np.stack([x.ravel(), y.ravel()])
    inside = (np.abs(before) < 11.9).all(axis=0)
    assert drawn.ravel()[inside] == pytest.approx((3 * before[0] + 8 * before[1])[inside], abs=1e-3)


@pytest.mark.parametrize(("degrees", "most"), [(0, 1e-6), (30, 0.15), (150, 0.15), (180, 1e-6)])
def test_a_patch_looks_as_the_present_flow_shows_it(degrees, most):
    brightness = texture()
    patches = of_brightness(brightness)
    found = follow(patches, along(brightness, degrees, 10**7), patches.place, CAMERA, SETTINGS)
    assert found.shown.mean() > 0.95
    assert error(found, patches.place) < most


def test_what_a_turned_flow_shows_is_learnt():
    brightness = texture()
    patches = of_brightness(brightness)
    place = patches.place
    for k, degrees in enumerate(range(30, 91, 4)):
        picture = along(brightness, degrees, (k + 1) * 10**7)
        patches = completed(
            follow(patches, picture, place, CAMERA, SETTINGS), picture, place, SETTINGS
        )
    across = along(brightness, 90, 10**8)
    learnt = follow(patches, across, place, CAMERA, SETTINGS)
    untaught = follow(of_brightness(brightness), across, place, CAMERA, SETTINGS)
    assert learnt.shown.mean() > 0.9
    assert untaught.shown.mean() < 0.1
    assert error(learnt, place) < 0.02
    first_flow = along(brightness, 0.0, 2 * 10**8)
    assert error(follow(patches, first_flow, place, CAMERA, SETTINGS), place) < 1e-3  # no drift


@pytest.mark.parametrize(
    ("degrees", "off_px", "learns"), [(10, 0.0, False), (40, 0.0, True), (40, 2.5, False)]
)
def test_nothing_is_learnt_of_the_same_flow_or_at_a_wrong_place(degrees, off_px, learns):
    brightness = texture()
    patches = of_brightness(brightness)
    picture = along(brightness, degrees, 10**7)
    found = follow(patches, picture, patches.place, CAMERA, SETTINGS)
    after = completed(found, picture, found.place + np.array([off_px, 0.0]), SETTINGS)
    for slopes, before in ((after.full, found.full), (after.half, found.half)):
        assert (slopes != before).any() == learns


def test_nothing_is_learnt_of_another_texture_or_off_the_image():
    brightness = texture()
    patches = of_brightness(brightness)
    x, y = patches.place.T
    inside = (x > 20) & (x < 140) & (y > 20) & (y < 100)
    shape, first = np.tile(np.eye(2), (len(patches), 1, 1)), patches.toward
    toward = np.tile([np.cos(0.7), np.sin(0.7)], (len(patches), 1))

    def learnt(image: np.ndarray, place: np.ndarray) -> np.ndarray:
        picture = along(image, np.degrees(0.7)).full
        return completed_slopes(patches.full, picture, place, shape, first, toward, SETTINGS)

    other = (learnt(texture(1), patches.place) != patches.full).any(axis=(1, 2, 3))
    assert other.mean() < 0.2
    assert (learnt(brightness, patches.place) != patches.full)[inside].any(axis=(1, 2, 3)).all()
    edge = patches.place.copy()
    edge[:, 0] = 7.0
    same = learnt(brightness, edge)[:, :, :, :5] == patches.full[:, :, :, :5]
    assert same.all()  # these columns lie off the image


def test_slopes_are_learnt_in_the_frame_of_the_first_appearance():
    """A roll by 50 degrees with a flow that has turned by 90 shows slopes at 40 degrees."""
    brightness = texture()
    near = np.linalg.norm(of_brightness(brightness).place - [79.5, 59.5], axis=1) < 25
    patches = of_brightness(brightness).at(near)
    later, shape = rolled(brightness, 50.0)
    place = [79.5, 59.5] + (patches.place - [79.5, 59.5]) @ shape.T
    patches = replace(patches, shape=np.tile(shape, (len(patches), 1, 1)))
    for k in range(6):
        picture = along(later, 90.0, (k + 1) * 10**7)
        patches = follow(patches, picture, place, CAMERA, SETTINGS)
        patches = completed(patches, picture, place, SETTINGS)
    true = cut(
        np.gradient(brightness)[0].astype(np.float32), of_brightness(brightness).place[near], 12
    )
    learnt = patches.full[:, 1]
    product = (true * learnt).sum(axis=(1, 2))
    likeness = product / np.sqrt((true**2).sum(axis=(1, 2)) * (learnt**2).sum(axis=(1, 2)))
    assert np.median(likeness) > 0.95
    assert 0.6 < np.median(product / (true**2).sum(axis=(1, 2))) < 1.0
    assert (patches.full[:, 0] == of_brightness(brightness).at(near).full[:, 0]).all()


def test_first_slopes_lie_across_an_edge():
    y, x = np.mgrid[0:120, 0:160]
    normal = np.array([np.cos(0.6), np.sin(0.6)])
    distance = (x - 80) * normal[0] + (y - 60) * normal[1]
    picture = slice_of(normal[0] * np.exp(-0.5 * (distance / 2) ** 2)).full
    middle, toward = np.array([[80.0, 60.0]]), np.array([[1.0, 0.0]])
    sure = replace(SETTINGS, any_direction=0.0)
    ((along_x, along_y),) = first_slopes(picture, middle, toward, 12, sure)
    assert along_x[12, 12] == pytest.approx(normal[0], rel=0.05)
    assert along_y[12, 12] == pytest.approx(normal[1], rel=0.05)
    _, unsure = first_slopes(picture, middle, toward, 12, replace(sure, any_direction=1e3))[0]
    assert np.abs(unsure).max() < 0.01


def test_patches_are_cut_in_their_shapes():
    y, x = np.mgrid[0:120, 0:160].astype(np.float32)
    shape = np.array([[0.9, 0.2], [-0.1, 1.1]])
    (patch,) = cut_shaped(3 * x + 5 * y, np.array([[80.25, 60.5]]), shape[None], 8)
    b, a = np.mgrid[-8:9, -8:9]
    at = [80.25, 60.5] + np.stack([a, b], axis=-1) @ shape.T
    assert patch == pytest.approx(at @ [3.0, 5.0], rel=1e-5)
    (outside,) = cut_shaped(3 * x + 5 * y + 1, np.array([[-20.0, 60.0]]), shape[None], 8)
    assert np.isnan(outside).all()
