import numpy as np
import pytest

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.simulation.sensor import (
    EventPixels,
    Lamp,
    Photoreceptor,
    SensorModel,
    background_noise,
    hot_pixels,
    lose_bursts,
)

MS = 1_000_000
IDEAL = SensorModel(threshold_on=0.2, threshold_off=0.25, mismatch=0, refractory_us=0)


def one_pixel(model: SensorModel, values: list[float], seed: int = 0) -> tuple[Events, EventPixels]:
    """Events of a pixel that is shown the values one after another, 1 ms apart."""
    images = [np.full((1, 1), value, np.float32) for value in values]
    pixels = EventPixels(model, images[0], 0, np.random.default_rng(seed))
    parts = [pixels.advance(image, (k + 1) * MS) for k, image in enumerate(images[1:])]
    return Events.concatenate(parts), pixels


def test_a_ramp_crosses_its_thresholds_at_even_times() -> None:
    events, pixels = one_pixel(IDEAL, [0.0, 2.0])
    assert len(events) in (9, 10, 11)
    assert events.p.all()
    # 2.0 per ms over a threshold of 0.2: one event each 100 us.
    assert set(np.diff(events.t)) <= {99_000, 100_000, 101_000}
    assert 0 <= 2.0 - pixels.level[0, 0] < 0.2


def test_falling_brightness_uses_the_off_threshold() -> None:
    events, pixels = one_pixel(IDEAL, [0.0, -5.0])
    assert not events.p.any()
    assert abs(len(events) - 5.0 / 0.25) <= 1
    assert 0 <= pixels.level[0, 0] + 5.0 < 0.25


def test_constant_brightness_is_silent() -> None:
    events, _ = one_pixel(IDEAL, [0.3] * 20)
    assert len(events) == 0


@pytest.mark.parametrize("seed", range(4))
def test_events_add_up_to_the_change_within_one_threshold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    images = np.cumsum(rng.normal(0, 0.3, (40, 8, 9)), axis=0).astype(np.float32)
    model = SensorModel(mismatch=0.2, refractory_us=0)
    pixels = EventPixels(model, images[0], 0, rng)
    total = pixels.level.copy()
    on, off = pixels.thresholds
    for k, image in enumerate(images[1:]):
        events = pixels.advance(image, (k + 1) * MS)
        step = np.where(events.p, on[events.y, events.x], -off[events.y, events.x])
        np.add.at(total, (events.y, events.x), step)
        assert (image - total < on).all()
        assert (total - image < off).all()


def test_refractory_period_silences_a_pixel() -> None:
    dead_us = 250
    model = SensorModel(threshold_on=0.2, mismatch=0, refractory_us=dead_us)
    events, pixels = one_pixel(model, [0.0, 2.0, 4.0])
    assert np.diff(events.t).min() >= dead_us * 1_000
    assert len(events) == 7  # every third of the crossings that come 100 us apart
    assert 0 <= 4.0 - pixels.level[0, 0] < 0.2  # the level follows all the same


def test_recording_is_sorted_inside_and_refractory(mover) -> None:
    events = mover.events
    assert (np.diff(events.t) >= 0).all()
    assert events.t[0] >= mover.t_start
    assert events.t[-1] < mover.t_end
    assert events.inside(346, 260).all()
    assert 0.35 < events.p.mean() < 0.65
    pixel = events.y.astype(np.int64) * 346 + events.x
    order = np.lexsort((events.t, pixel))
    gaps = np.diff(events.t[order])[np.diff(pixel[order]) == 0]
    assert gaps.min() >= 300_000


def test_event_rate_of_the_calm_scene_is_that_of_a_real_camera() -> None:
    recording = simulate("calm", duration_s=0.06, seed=0)
    assert 0.3e6 < len(recording.events) / 0.06 < 1.5e6


def test_noise_is_poisson_in_count_and_uniform_in_time() -> None:
    rng = np.random.default_rng(0)
    events = background_noise(6.0, (260, 346), 0, 200 * MS, rng)
    expected = 6.0 * 260 * 346 * 0.2
    assert abs(len(events) - expected) < 4 * np.sqrt(expected)
    assert abs(events.p.mean() - 0.5) < 0.01
    assert abs(events.t.mean() - 100 * MS) < 0.01 * 200 * MS
    assert (events.x.max(), events.y.max()) == (345, 259)


def test_camera_at_rest_sends_noise_alone() -> None:
    silent = simulate("static", duration_s=0.02, seed=0, sensor=SensorModel(noise_hz=0))
    assert len(silent.events) == 0
    noisy = simulate("static", duration_s=0.02, seed=0, sensor=SensorModel(noise_hz=50))
    expected = 50 * 260 * 346 * 0.02
    assert abs(len(noisy.events) - expected) < 4 * np.sqrt(expected)


def test_seed_decides_every_bit(painted_each_time: None) -> None:
    first, again, other = (simulate("noisy", duration_s=0.02, seed=s).events for s in (5, 5, 6))
    for name in ("x", "y", "t", "p"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert len(first) != len(other) or (first.x != other.x).any()


def test_sharp_edges_move_with_the_true_flow(mover) -> None:
    """Warped back along the true flow, events line up: the image of warped events sharpens."""
    events, t0 = mover.events, mover.t_start
    flow = mover.truth.flow((mover.t_start + mover.t_end) // 2)
    u = flow[events.y, events.x] * ((events.t - t0) * 1e-9)[:, None]
    still = _count_image(events.x, events.y).var()
    warped = _count_image(events.x - u[:, 0], events.y - u[:, 1]).var()
    assert warped > 1.5 * still


def _count_image(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    edges = (np.arange(261) - 0.5, np.arange(347) - 0.5)
    return np.histogram2d(y, x, edges)[0]


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"threshold_on": 0.0}, "sensor.threshold"),
        ({"mismatch": 0.9}, "sensor.mismatch"),
        ({"refractory_us": -1}, "sensor.refractory_us"),
        ({"noise_hz": float("nan")}, "sensor.noise_hz"),
    ],
)
def test_sensor_refuses_values_out_of_range(values: dict[str, float], named: str) -> None:
    with pytest.raises(InputError, match=named):
        SensorModel(**values)


def test_simulate_refuses_what_it_cannot_do() -> None:
    with pytest.raises(InputError, match="unknown name 'nowhere'; use one of calm, agile"):
        simulate("nowhere", duration_s=1.0, seed=0)
    with pytest.raises(InputError, match="duration: 0 s"):
        simulate("calm", duration_s=0, seed=0)
    with pytest.raises(InputError, match="fps: 1"):
        simulate("calm", duration_s=1.0, seed=0, fps=1)


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
