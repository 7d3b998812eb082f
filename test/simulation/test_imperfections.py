import numpy as np
import pytest

from emoflow_ros.core.events import Events
from emoflow_ros.simulation.imperfections import Lamp, Photoreceptor, hot_pixels, lose_bursts

MS = 1_000_000


def test_photoreceptor_follows_slowly_and_slower_in_the_dark() -> None:
    dark = np.full((1, 2), -2.0, np.float32)
    receptor = Photoreceptor(50.0, dark)
    target = np.array([[-1.0, 1.0]], np.float32)
    time = 0.0
    for _ in range(2000):
        held = receptor.advance(target, 1e-6)
        time += 1e-6
    # A first-order lag: 1 - exp(-2 pi f t), with f in proportion to the light that is shown.
    cutoff = 50.0 * np.exp(target)
    expected = dark + (target - dark) * (1 - np.exp(-2 * np.pi * cutoff * time))
    np.testing.assert_allclose(held, expected, rtol=2e-3)
    np.testing.assert_allclose(receptor.advance(target, 1e3), target, rtol=1e-4)


def test_lamp_lights_its_patch_alone_and_moves_with_the_world() -> None:
    x = np.linspace(-1, 1, 101)
    bearings = np.stack(np.meshgrid(x, x), axis=-1)
    lamp = Lamp(bearings, np.array([0.0, 0.0, 1.0]), 0.2, 0.3, 100.0)
    image = np.zeros((101, 101), np.float32)
    lamp.light(image, np.eye(3), 0.0025)  # a quarter of a period: full light
    assert image[50, 50] == pytest.approx(np.log(1.3))
    assert image[50, 65] == 0
    assert (image > 0).mean() == pytest.approx(np.pi * np.tan(0.2) ** 2 / 4, rel=0.05)
    turned = np.array([[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]])
    image = np.zeros((101, 101), np.float32)
    lamp.light(image, turned, 0.0075)
    assert image[50, 50] == 0
    assert image[50, 50 - 15] == pytest.approx(np.log(0.7), rel=1e-3)  # 0.28 / 0.96 to the left


def test_hot_pixels_fire_at_their_places_alone() -> None:
    events = hot_pixels(5, (180, 240), 0, 1000 * MS, np.random.default_rng(0))
    places, counts = np.unique(np.stack([events.x, events.y]), axis=1, return_counts=True)
    assert places.shape[1] <= 5
    assert counts.min() > 5
    assert 100 < counts.sum() < 5000
    assert len(hot_pixels(0, (180, 240), 0, 1000 * MS, np.random.default_rng(0))) == 0


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_bursts_are_lost_whole(share: float) -> None:
    t = np.arange(0, 20_000 * MS, MS // 20)
    zeros = np.zeros(len(t), np.uint16)
    events = Events(zeros, zeros, t, np.ones(len(t), np.bool_))
    kept = lose_bursts(events, share, np.random.default_rng(1))
    assert 1 - len(kept) / len(events) == pytest.approx(share, rel=0.2)
    gaps = np.diff(kept.t)
    gaps = gaps[gaps > MS // 20]
    assert gaps.min() >= MS
    # A few bursts follow one another at once.
    assert np.quantile(gaps, 0.98) <= 10 * MS + MS // 10


def test_nothing_is_lost_where_nothing_shall_be() -> None:
    one = Events(*(np.array([1], kind) for kind in (np.uint16, np.uint16, np.int64, np.bool_)))
    assert lose_bursts(one, 0.0, np.random.default_rng(0)) is one
    assert len(lose_bursts(Events.empty(), 0.3, np.random.default_rng(0))) == 0
