import math

import numpy as np
import pytest
import torch

from emoflow_ros.core.geometry.camera_motion import SplineMotion, basis
from emoflow_ros.errors import InputError
from emoflow_ros.published.field import CoordinateMLP, MotionSpline
from emoflow_ros.published.fit import EarlyStopping, field_rate, make_optimizer
from emoflow_ros.published.implicit_config import (
    EarlyStopConfig,
    FieldConfig,
    ImplicitConfig,
    LossConfig,
    OptimizerConfig,
)


def make_field(config: FieldConfig, seed: int = 0) -> CoordinateMLP:
    return CoordinateMLP(config, 346, 260, 0.09, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(
    ("layers", "octaves", "expected"),
    [
        # First layer, residual layers, the input's second entry, output.
        (8, 0, 4 * 256 + 7 * 257 * 256 + 3 * 256 + 2 * 257),
        (4, 0, 4 * 256 + 3 * 257 * 256 + 3 * 256 + 2 * 257),
        (8, 6, 40 * 256 + 7 * 257 * 256 + 39 * 256 + 2 * 257),
    ],
)
def test_network_has_the_published_size(layers: int, octaves: int, expected: int) -> None:
    field = make_field(FieldConfig(layers=layers, width=256, octaves=octaves))
    assert sum(p.numel() for p in field.parameters()) == expected


def test_input_enters_again_at_layer_five_of_eight() -> None:
    field = make_field(FieldConfig(layers=8, width=16))
    assert [layer.in_features for layer in field.hidden] == [3, 16, 16, 16, 19, 16, 16, 16]


def test_corners_of_the_window_are_normalised_to_one() -> None:
    field = make_field(FieldConfig(layers=1, width=4))
    encoded = field.encode(torch.tensor([[0.0, 0.0, 0.0], [0.09, 345.0, 259.0]]))
    torch.testing.assert_close(encoded, torch.tensor([[-1.0, -1, -1], [1, 1, 1]]))


def test_encoding_doubles_the_frequency_with_each_octave() -> None:
    field = make_field(FieldConfig(layers=1, width=4, octaves=2))
    encoded = field.encode(torch.tensor([[0.0675, 172.5, 129.5]]))[0]
    t = 0.5
    sines = [math.sin(math.pi * t), math.sin(2 * math.pi * t)]
    cosines = [math.cos(math.pi * t), math.cos(2 * math.pi * t)]
    expected = [t, 0, 0, *sines, 0, 0, 0, 0, *cosines, 1, 1, 1, 1]
    torch.testing.assert_close(encoded, torch.tensor(expected), atol=1e-5, rtol=0)


def test_forward_agrees_with_the_network_written_out() -> None:
    field = make_field(FieldConfig(layers=2, width=8, output_scale=50.0))
    t, x = torch.tensor([0.02]), torch.tensor([[100.0, 40.0]])
    z = torch.tensor([0.02 / 0.045 - 1, 100 / 172.5 - 1, 40 / 129.5 - 1])
    first, second = field.hidden
    h = (first.weight @ z + first.bias).clamp(min=0)
    h = h + (second.weight @ torch.cat([h, z]) + second.bias).clamp(min=0)
    expected = 50 * (field.output.weight @ h + field.output.bias)
    torch.testing.assert_close(field(t, x)[0], expected)


def test_raw_field_is_fed_seconds_and_pixels() -> None:
    field = make_field(FieldConfig(layers=1, width=4, normalised=False))
    raw = torch.tensor([[0.02, 100.0, 40.0]])
    torch.testing.assert_close(field.encode(raw), raw)
    with pytest.raises(InputError, match="6 octaves of coordinates that are not in"):
        FieldConfig(octaves=6, normalised=False)


def test_weights_come_from_the_generator_alone() -> None:
    torch.manual_seed(1)
    first = make_field(FieldConfig(layers=3, width=16), seed=5)
    torch.manual_seed(2)
    again = make_field(FieldConfig(layers=3, width=16), seed=5)
    other = make_field(FieldConfig(layers=3, width=16), seed=6)
    for a, b, c in zip(first.parameters(), again.parameters(), other.parameters(), strict=True):
        assert torch.equal(a, b)
        assert not torch.equal(a, c)


def test_motion_agrees_with_the_numpy_spline() -> None:
    rng = np.random.default_rng(0)
    angular, linear = rng.normal(size=(2, 4, 3))
    motion = MotionSpline(0.2)
    with torch.no_grad():
        motion.angular_points.copy_(torch.from_numpy(angular))
        motion.linear_points.copy_(torch.from_numpy(linear))
    expected = SplineMotion(0, 1000, angular, linear)
    for t in (0, 250, 900, 1000):
        v, w = motion(torch.from_numpy(basis(t / 1000)).float())
        np.testing.assert_allclose(v.detach(), expected.linear(t), atol=1e-6)
        np.testing.assert_allclose(w.detach(), expected.angular(t), atol=1e-6)


def test_motion_starts_from_the_configured_value() -> None:
    v, w = MotionSpline(0.2)(torch.from_numpy(basis(0.3)).float())
    torch.testing.assert_close(w, torch.full((3,), 0.2))
    torch.testing.assert_close(v, torch.full((3,), 3**-0.5))


def test_exponential_schedule_ends_at_the_published_rate() -> None:
    config = OptimizerConfig()
    assert field_rate(0, config) == 1e-4
    assert field_rate(999, config) == pytest.approx(6.3e-5)
    ratio = field_rate(401, config) / field_rate(400, config)
    assert ratio == pytest.approx(0.63 ** (1 / 999))


def test_cosine_schedule_warms_up_and_falls_along_half_a_period() -> None:
    config = OptimizerConfig(
        schedule="cosine", field_rate=2e-3, final_field_rate=2e-5, warmup=100, iterations=1001
    )
    assert field_rate(0, config) == pytest.approx(2e-5)
    assert field_rate(49, config) == pytest.approx(1e-3)
    assert field_rate(100, config) == pytest.approx(2e-3)
    assert field_rate(550, config) == pytest.approx((2e-3 + 2e-5) / 2)
    assert field_rate(1000, config) == pytest.approx(2e-5)


@pytest.mark.parametrize(
    ("algorithm", "kind"), [("adam", torch.optim.Adam), ("adamw", torch.optim.AdamW)]
)
def test_optimiser_follows_the_schedule_for_the_field_only(
    algorithm: str, kind: type[torch.optim.Optimizer]
) -> None:
    config = OptimizerConfig(algorithm=algorithm, iterations=10)
    field, motion = make_field(FieldConfig(layers=1, width=4)), MotionSpline(0.2)
    optimizer, schedule = make_optimizer(field, motion, config)
    assert type(optimizer) is kind
    for step in range(3):
        rates = [group["lr"] for group in optimizer.param_groups]
        assert rates == [pytest.approx(field_rate(step, config)), 1e-3]
        optimizer.step()
        schedule.step()


def test_stops_when_patience_ends_without_improvement() -> None:
    stopping = EarlyStopping(EarlyStopConfig(burn_in=300, patience=3, min_improvement=1e-3))
    # -1.0005 is too little better than -1, -1.002 is enough, and counting starts again.
    seen = [stopping.should_stop(loss) for loss in (-1, -1.0005, -0.9, -1.002, -1.0, -1.0, -1.0)]
    assert seen == [False] * 6 + [True]


def test_a_loss_that_is_not_a_number_counts_as_no_improvement() -> None:
    stopping = EarlyStopping(EarlyStopConfig(patience=2))
    assert [stopping.should_stop(float("nan")) for _ in range(2)] == [False, True]


def test_the_loss_is_read_after_the_burn_in_only() -> None:
    stopping = EarlyStopping(EarlyStopConfig(burn_in=300, patience=45))
    assert [stopping.watches(i) for i in (0, 299, 300, 999)] == [False, False, True, True]
    assert not EarlyStopping(EarlyStopConfig(patience=0)).watches(500)


def test_early_stopping_within_the_contrast_phase_is_refused() -> None:
    with pytest.raises(InputError, match="100 iterations end before"):
        ImplicitConfig(
            loss=LossConfig(contrast_only=200), early_stop=EarlyStopConfig(100, patience=45)
        )
