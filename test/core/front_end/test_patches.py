"""Patches: how exactly they are found again, and what is known of their places."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import affine_transform, gaussian_filter, shift

from emoflow_ros.core.front_end.appearance import completed_slopes, first_slopes
from emoflow_ros.core.front_end.bearings import looked_up, on_plane
from emoflow_ros.core.front_end.patch_kernels import cut, cut_shaped, deformed
from emoflow_ros.core.front_end.patches import (
    Patches,
    choose,
    completed,
    directions,
    follow,
)
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import Slice, grid_nodes
from emoflow_ros.core.geometry.camera import Camera

CAMERA = Camera(160, 120, 120.0, 120.0, 80.0, 60.0)
SETTINGS = FrontEndSettings()
ROWS, COLUMNS = grid_nodes(CAMERA.size).shape[:2]


def texture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 50 * gaussian_filter(rng.normal(size=(120, 160)), 2.0).astype(np.float32)


def slice_of(image: np.ndarray, t: int = 0, flow: tuple[float, float] = (10.0, 0.0)) -> Slice:
    image = np.ascontiguousarray(image, np.float32)
    grid = np.tile(np.array(flow, np.float32), (ROWS, COLUMNS, 1))
    return Slice.of(t, image, grid)


def moved(image: np.ndarray, x: float, y: float) -> np.ndarray:
    return shift(image, (y, x), order=3)


def first(image: np.ndarray) -> Patches:
    return choose(slice_of(image), Patches.none(), CAMERA, SETTINGS)


@pytest.mark.parametrize("way", [(0.3, -0.2), (2.0, 1.0), (-3.4, 2.6)])
def test_patches_are_found_to_hundredths_of_a_pixel(way):
    image = texture()
    patches = first(image)
    assert len(patches) > 60
    found = follow(
        patches, slice_of(moved(image, *way), 10**7), patches.place + 1.0, CAMERA, SETTINGS
    )
    good = found.shown
    assert good.mean() > 0.9
    error = (found.place - patches.place - way)[good]
    assert np.median(np.linalg.norm(error, axis=1)) < 0.03


def test_a_patch_that_goes_back_has_the_other_polarity():
    image = texture()
    patches = first(image)
    back = slice_of(-moved(image, -1.0, 0.5), 10**7, flow=(-10.0, 0.0))
    found = follow(patches, back, patches.place, CAMERA, SETTINGS)
    assert found.shown.mean() > 0.9
    assert np.median((found.place - patches.place)[found.shown], axis=0) == pytest.approx(
        [-1.0, 0.5], abs=0.02
    )


def rolled(image: np.ndarray, degrees: float, zoom: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The image turned and enlarged about its middle, and what that makes of offsets (x, y)."""
    angle = np.radians(degrees)
    shape = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    back = np.linalg.inv(shape)[::-1, ::-1]  # of (row, column)
    middle = np.array([59.5, 79.5])
    return affine_transform(image, back, middle - back @ middle, order=3), shape


@pytest.mark.parametrize(("degrees", "zoom"), [(25.0, 1.0), (-40.0, 1.0), (0.0, 1.3)])
def test_a_patch_that_was_deformed_is_found_in_its_new_shape(degrees, zoom):
    image = texture()
    patches = first(image)
    patches = patches.at(np.linalg.norm(patches.place - [79.5, 59.5], axis=1) < 30)
    later, shape = rolled(image, degrees, zoom)
    flow = tuple(shape @ [10.0, 0.0])
    expected = [79.5, 59.5] + (patches.place - [79.5, 59.5]) @ shape.T
    shapes = np.tile(shape, (len(patches), 1, 1))

    def errors(patches: Patches) -> np.ndarray:
        found = follow(patches, slice_of(later, 10**7, flow), expected, CAMERA, SETTINGS)
        return np.where(found.shown, np.linalg.norm(found.place - expected, axis=1), 9.0)

    assert np.median(errors(replace(patches, shape=shapes))) < 0.1
    assert np.median(errors(patches)) > 0.4  # as it was


def test_shapes_are_drawn_by_multiplying_offsets():
    y, x = np.mgrid[-12:13, -12:13].astype(np.float32)
    shape = np.array([[0.9, 0.2], [-0.1, 1.1]])
    (drawn,) = deformed((3 * x + 5 * y)[None], shape[None])
    before = np.linalg.inv(shape) @ np.stack([x.ravel(), y.ravel()])
    inside = (np.abs(before) < 11.9).all(axis=0)
    assert drawn.ravel()[inside] == pytest.approx((3 * before[0] + 5 * before[1])[inside], abs=1e-3)
    (same,) = deformed((x * y)[None], np.eye(2)[None])
    assert (same == x * y).all()


def along(brightness: np.ndarray, degrees: float, t: int = 0) -> Slice:
    """Events of a picture's brightness that moves in a direction: its slopes along it."""
    u = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    slope_y, slope_x = np.gradient(brightness)
    return slice_of(u[0] * slope_x + u[1] * slope_y, t, tuple(20 * u))


def of_brightness(brightness: np.ndarray) -> Patches:
    return choose(along(brightness, 0.0), Patches.none(), CAMERA, SETTINGS)


def error(found: Patches, place: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(found.place - place, axis=1)[found.shown]))


@pytest.mark.parametrize(("degrees", "most"), [(0, 1e-6), (30, 0.15), (150, 0.15), (180, 1e-6)])
def test_a_patch_looks_as_the_present_flow_shows_it(degrees, most):
    brightness = texture()
    patches = of_brightness(brightness)
    found = follow(patches, along(brightness, degrees, 10**7), patches.place, CAMERA, SETTINGS)
    assert found.shown.mean() > 0.95
    assert error(found, patches.place) < most


def test_a_patch_waits_while_the_flow_shows_little_of_it():
    brightness = np.tile(texture()[60], (120, 1))  # edges across the first flow alone
    patches = of_brightness(brightness)
    for degrees, seen in ((55, 1.0), (65, 0.0), (115, 0.0), (125, 1.0)):
        turned = along(brightness, degrees, 10**7)
        found = follow(patches, turned, patches.place, CAMERA, SETTINGS)
        assert found.shown.mean() == pytest.approx(seen, abs=0.1)
    again = choose(turned, found, CAMERA, SETTINGS)
    assert len(again) < 1.2 * len(found)
    across = along(texture(), 90, 10**7)
    waiting = follow(patches, across, patches.place, CAMERA, SETTINGS)
    assert choose(across, waiting, CAMERA, SETTINGS).shown.sum() > 0.5 * len(patches)


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


def test_directions_turn_with_the_patch():
    patches = first(texture())
    across = slice_of(texture(), 10**7, flow=(2.0, 10.0))
    unturned = directions(patches, across.flow, patches.place, SETTINGS)
    assert unturned == pytest.approx(np.tile([0.196, 0.981], (len(patches), 1)), abs=1e-3)
    by_a_quarter = np.tile([[0.0, -1.0], [1.0, 0.0]], (len(patches), 1, 1))
    turned = directions(replace(patches, shape=by_a_quarter), across.flow, patches.place, SETTINGS)
    assert turned == pytest.approx(np.tile([0.981, -0.196], (len(patches), 1)), abs=1e-3)


def test_patches_are_cut_in_their_shapes():
    y, x = np.mgrid[0:120, 0:160].astype(np.float32)
    shape = np.array([[0.9, 0.2], [-0.1, 1.1]])
    (patch,) = cut_shaped(3 * x + 5 * y, np.array([[80.25, 60.5]]), shape[None], 8)
    b, a = np.mgrid[-8:9, -8:9]
    at = [80.25, 60.5] + np.stack([a, b], axis=-1) @ shape.T
    assert patch == pytest.approx(at @ [3.0, 5.0], rel=1e-5)
    (outside,) = cut_shaped(3 * x + 5 * y + 1, np.array([[-20.0, 60.0]]), shape[None], 8)
    assert np.isnan(outside).all()


def test_without_a_flow_patches_are_looked_for_and_none_chosen():
    image = texture()
    patches = first(image)
    still = slice_of(image, 10**7, flow=(0.0, 0.0))
    assert follow(patches, still, patches.place, CAMERA, SETTINGS).shown.mean() > 0.9
    assert len(choose(still, patches, CAMERA, SETTINGS)) == len(patches)
    assert len(choose(slice_of(image, 0, (2.0, 1.0)), Patches.none(), CAMERA, SETTINGS)) == 0


def test_another_texture_is_not_found():
    patches = first(texture())
    found = follow(patches, slice_of(texture(1), 10**7), patches.place, CAMERA, SETTINGS)
    assert found.shown.mean() < 0.2  # two smooth textures look alike here and there


def test_along_an_edge_nothing_is_known_of_the_place():
    column = np.exp(-0.5 * ((np.arange(160) - 80.0) / 1.5) ** 2)
    rng = np.random.default_rng(3)

    def edge() -> np.ndarray:
        noise = gaussian_filter(rng.normal(size=(120, 160)), 0.8)
        return (20 * np.tile(column, (120, 1)) + noise).astype(np.float32)

    patches = first(edge())
    patches = patches.at(np.abs(patches.place[:, 0] - 80) < 3)
    assert len(patches) >= 5
    found = follow(
        patches, slice_of(edge(), 10**7), patches.place + np.array([0.0, 2.0]), CAMERA, SETTINGS
    )
    assert found.shown.all()
    along = found.place[:, 1] - patches.place[:, 1]
    assert np.abs(found.place[:, 0] - patches.place[:, 0]).max() < 0.2
    assert np.median(np.abs(along - 2.0)) < 2 * SETTINGS.expected_px
    information = np.einsum("nji,njk->nik", found.root[:, -1], found.root[:, -1])
    across, weak = information[:, 0, 0], information[:, 1, 1]
    assert np.median(weak / across) < 1e-3


def test_information_is_that_of_the_errors():
    """Noise of known size: squared errors over the covariance are 2 on average (two axes)."""
    rng = np.random.default_rng(5)
    clean, squares = texture(), []
    for _ in range(8):
        noisy = [clean + 1.5 * gaussian_filter(rng.normal(size=clean.shape), 0.8) for _ in range(2)]
        patches = first(noisy[0])
        found = follow(patches, slice_of(noisy[1], 10**6), patches.place, CAMERA, SETTINGS)
        error = (found.place - patches.place)[found.shown] / 120.0
        white = np.einsum("nij,nj->ni", found.root[found.shown, -1], error)
        squares.append((white**2).sum(axis=1))
    mean = float(np.concatenate(squares).mean())
    assert 0.3 < mean < 2.5


def test_an_older_appearance_tells_less():
    place, information = np.full((2, 2), 50.0), np.tile(1e4 * np.eye(2), (2, 1, 1))
    _, root = on_plane(CAMERA, place, information, np.array([0.0, 1.0]), SETTINGS)
    young, old = np.linalg.norm(root, axis=(1, 2))
    assert old < 0.6 * young


def test_new_patches_keep_off_those_that_are_followed():
    image = texture()
    patches = first(image)
    again = choose(slice_of(image), patches.at(np.arange(len(patches)) % 2 == 0), CAMERA, SETTINGS)
    apart = np.abs(again.place[:, None] - again.place[None]).max(axis=-1)
    np.fill_diagonal(apart, 99)
    assert apart.min() > SETTINGS.distance_px
    assert len(again) > 0.8 * len(patches)


def test_an_empty_slice_has_no_patches():
    assert len(first(np.zeros((120, 160), np.float32))) == 0


def test_the_oldest_slice_is_forgotten_with_what_only_it_shows():
    image = texture()
    patches = first(image)
    found = follow(patches, slice_of(moved(image, 1, 0), 10**7), patches.place, CAMERA, SETTINGS)
    lost = ~found.shown
    kept = found.without(0, np.full(len(found), 0.7))
    assert len(kept) == len(found) - lost.sum()
    assert kept.found.shape[1] == 1
    assert (kept.inverse_depth == 0.7).all()


def test_a_slice_between_others_is_forgotten_without_moving_depths():
    image = texture()
    patches = first(image)
    for k in (1, 2):
        later = slice_of(moved(image, k, 0), k * 10**7)
        patches = follow(patches, later, patches.place, CAMERA, SETTINGS)
    patches = replace(patches, inverse_depth=np.full(len(patches), 0.4))
    kept = patches.without(1, np.full(len(patches), 0.7))
    assert len(kept) == len(patches)
    assert (kept.inverse_depth == 0.4).all()
    assert (kept.seen == patches.seen[:, [0, 2]]).all()


@pytest.mark.parametrize("missing", [1, 5, 6])
def test_a_patch_is_waited_for_five_nodes_long(missing):
    image = texture()
    patches = first(image)
    for k in range(missing):
        patches = follow(
            patches,
            slice_of(np.zeros_like(image), (k + 1) * 10**7),
            patches.place,
            CAMERA,
            SETTINGS,
        )
        assert not patches.shown.any()
    patches = follow(patches, slice_of(image, 10**8), patches.place, CAMERA, SETTINGS)
    assert patches.shown.mean() == (0.0 if missing > SETTINGS.patience else 1.0)


def test_along_a_noisy_edge_a_patch_stays_where_it_is_expected():
    rng = np.random.default_rng(3)
    edge = np.zeros((120, 160))
    edge[:, 80] = 60.0
    noisy = [gaussian_filter(edge + 4 * rng.normal(size=edge.shape), 0.8) for _ in range(2)]
    patches = first(noisy[0].astype(np.float32))
    patches = patches.at(np.abs(patches.place[:, 0] - 80) < 2)
    assert len(patches) > 3
    found = follow(patches, slice_of(noisy[1], 10**7), patches.place, CAMERA, SETTINGS)
    along = (found.place - patches.place)[found.shown, 1]
    assert found.shown.mean() > 0.9
    assert np.sqrt(np.mean(along**2)) < 0.5


def test_bearings_off_the_maps_are_those_of_the_lens():
    camera = Camera(160, 120, 120.0, 118.0, 80.0, 60.0, "plumb_bob", (-0.3, 0.1, 0.001, -0.002))
    rng = np.random.default_rng(4)
    place = rng.uniform([1, 1], [158, 118], (200, 2))
    bearing, jacobian = looked_up(camera, place)
    exact, slope = camera.undistort(place)
    assert bearing == pytest.approx(exact, abs=5e-5)
    assert jacobian == pytest.approx(slope, abs=3e-4)
    outside, _ = looked_up(camera, np.array([[-1.0, 5.0], [159.5, 5.0], [np.nan, 3.0]]))
    assert np.isnan(outside).all()
