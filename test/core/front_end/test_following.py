"""Patches: how exactly they are found again, and what is known of their places."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_patches import (
    CAMERA,
    SETTINGS,
    along,
    first,
    moved,
    of_brightness,
    rolled,
    slice_of,
    texture,
)
from scipy.ndimage import gaussian_filter

from emoflow_ros.core.front_end.bearings import looked_up, on_plane
from emoflow_ros.core.front_end.following import choose, directions, follow
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.geometry.camera import Camera


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


def test_directions_turn_with_the_patch():
    patches = first(texture())
    across = slice_of(texture(), 10**7, flow=(2.0, 10.0))
    unturned = directions(patches, across.flow, patches.place, SETTINGS)
    assert unturned == pytest.approx(np.tile([0.196, 0.981], (len(patches), 1)), abs=1e-3)
    by_a_quarter = np.tile([[0.0, -1.0], [1.0, 0.0]], (len(patches), 1, 1))
    turned = directions(replace(patches, shape=by_a_quarter), across.flow, patches.place, SETTINGS)
    assert turned == pytest.approx(np.tile([0.981, -0.196], (len(patches), 1)), abs=1e-3)


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


def apart(patches: Patches) -> float:
    """Least distance of two patches along x or y, px."""
    distance = np.abs(patches.place[:, None] - patches.place[None]).max(axis=-1)
    return float(distance[np.triu_indices(len(patches), 1)].min())


def test_new_patches_keep_off_those_that_are_followed():
    image = texture()
    patches = first(image)
    again = choose(slice_of(image), patches.at(np.arange(len(patches)) % 2 == 0), CAMERA, SETTINGS)
    as_large = replace(SETTINGS, distance=1.0)
    large = choose(slice_of(image), Patches.none(), CAMERA, as_large)
    others = choose(slice_of(image), large.at(np.arange(len(large)) % 2 == 0), CAMERA, as_large)
    assert apart(others) > SETTINGS.distance_px
    assert apart(again) > round(SETTINGS.distance * CAMERA.width) == 2
    assert len(again) > 0.8 * len(patches)


def test_patches_of_a_small_image_are_closer_together():
    as_large = replace(SETTINGS, distance=1.0)
    few = choose(slice_of(texture()), Patches.none(), CAMERA, as_large)
    assert apart(first(texture())) < SETTINGS.distance_px < apart(few)
    assert len(first(texture())) > len(few) > 50


def test_an_empty_slice_has_no_patches():
    assert len(first(np.zeros((120, 160), np.float32))) == 0


def test_the_oldest_slice_is_forgotten_with_what_only_it_shows():
    image = texture()
    patches = first(image)
    found = follow(patches, slice_of(moved(image, 1, 0), 10**7), patches.place, CAMERA, SETTINGS)
    lost = ~found.shown
    kept = found.without(0, np.full((len(found), 2), 0.2), np.full(len(found), 0.7))
    assert len(kept) == len(found) - lost.sum()
    assert kept.found.shape[1] == 1
    assert (kept.inverse_depth == 0.7).all()
    assert (kept.seen == 0.2).all()  # where the way puts them, not where they were found


def test_a_slice_between_others_is_forgotten_without_moving_depths():
    image = texture()
    patches = first(image)
    for k in (1, 2):
        later = slice_of(moved(image, k, 0), k * 10**7)
        patches = follow(patches, later, patches.place, CAMERA, SETTINGS)
    patches = replace(patches, inverse_depth=np.full(len(patches), 0.4))
    kept = patches.without(1, np.full((len(patches), 2), 0.2), np.full(len(patches), 0.7))
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


def test_patches_that_were_waited_for_count_as_lost():
    patches = Patches.none()
    assert patches.kept(2) == 1.0
    image = texture()
    patches = first(image)
    assert patches.kept(2) == 1.0
    found = np.array([[1, 1, 1, 1], [0, 1, 0, 1], [0, 1, 0, 0], [1, 0, 0, 1]], np.bool_)
    patches = patches.at(np.arange(len(patches)) < 4)
    patches = replace(
        patches, found=found, seen=np.tile(patches.seen[:, :1], (1, 4, 1)),
        root=np.tile(patches.root[:, :1], (1, 4, 1, 1)),
    )  # fmt: skip
    assert patches.kept(0) == 1.0  # of the first alone
    assert patches.kept(1) == 2 / 3  # the third was seen just before
    assert patches.kept(2) == 3 / 4


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
