from itertools import pairwise

import numpy as np
import pytest
import torch

from emoflow_ros.core.lattice import kernels
from emoflow_ros.core.lattice.cells import add_cells
from emoflow_ros.core.lattice.contrast import SAMPLING, TAPS, Contrast, best_constant_flow
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.normal_equations import NormalEquations
from emoflow_ros.core.lattice.window_events import PAIRS, PARTS, WindowEvents

LATTICE = Lattice(120, 90, 5, 4, 2)
SCALES = (0.25, 0.5, 1.0)


def moving_dots(displacement, size=(120, 90), dots=60, per_dot=40, seed=1) -> WindowEvents:
    """Dots of either polarity that move together, px per window; events on whole pixels."""
    rng = np.random.default_rng(seed)
    width, height = size
    start = rng.uniform((0, 0), size, (dots, 1, 2))
    s = rng.random((dots, per_dot)).astype(np.float32)
    at = start + s[..., None] * np.array(displacement)
    x, y = np.moveaxis(np.rint(at + rng.normal(scale=0.3, size=at.shape)), -1, 0)
    on = np.broadcast_to(rng.random((dots, 1)) < 0.5, s.shape)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y, s, on = (column[inside] for column in (x, y, s, on))
    order = np.argsort(s)
    return WindowEvents.prepare(
        x[order].astype(np.float32), y[order].astype(np.float32), s[order], on[order]
    )


def on_pixels(columns, rows) -> list[np.ndarray]:
    """Places on the sensor, px, that full resolution shows in the middle of pixels of the image."""
    return [(np.array(n) + 0.5 - kernels.MARGIN) / SAMPLING - 0.5 for n in (columns, rows)]


def constant(u, v, lattice=LATTICE):
    return np.broadcast_to(np.float32([u, v]), lattice.shape).copy()


def equations_at(contrast, events, flow) -> NormalEquations:
    equations = NormalEquations(contrast.lattice, 0)
    add_cells(*contrast.linearise(events, flow), equations.vector, equations.band)
    return equations


def value_at(contrast, events, flow) -> float:
    """The contrast between parts: that of all events without those of each part by itself."""
    total = contrast.sharpen(events, flow)
    cuts = [len(events) * k // PARTS for k in range(PARTS + 1)]
    columns = (events.x, events.y, events.s, events.weights)
    parts = [WindowEvents(*(c[i:j] for c in columns)) for i, j in pairwise(cuts)]
    return PAIRS * (total - sum(contrast.sharpen(part, flow) for part in parts))


def warped(events, flow):
    """Positions (2, N) px in the middle of the window, in the order of time."""
    here = events.on(LATTICE)
    position = np.empty((2, len(events)), np.float32)
    kernels.warp(here, 0.5, flow, LATTICE.acceleration(flow), position)
    order = np.lexsort((events.y, events.x, events.s))
    result = np.empty_like(position)
    result[:, order] = position[:, np.lexsort((here.y, here.x, here.s))]
    return result


def away_from_kinks(events, flow, scale) -> WindowEvents:
    """Leave out events warped onto the border of a pixel, where bilinear votes have no slope."""
    position = warped(events, flow)
    part = ((position + 0.5) * SAMPLING * scale - 0.5) % 1
    keep = (np.abs(part - 0.5) < 0.499).all(axis=0)
    return WindowEvents(events.x[keep], events.y[keep], events.s[keep], events.weights[keep])


def reference_gradient(events, flow, scale):
    """Autograd, double precision, of the same contrast; (u . grad) u is held fixed."""

    def tensor(values):
        return torch.as_tensor(np.asarray(values, np.float64))

    def hats(position, count):
        return (1 - (position[:, None] - torch.arange(count)).abs()).clamp(min=0)

    x, y, s, weights = map(tensor, (events.x, events.y, events.s, events.weights))
    per_px = LATTICE.per_px.astype(np.float64)
    in_space = torch.einsum(
        "ni,nj->nij", hats(x * per_px[0], LATTICE.columns), hats(y * per_px[1], LATTICE.rows)
    )
    field = tensor(flow).requires_grad_()
    u = torch.einsum("nij,nk,ijkd->dn", in_space, hats(s, 2), field)
    # Of the acceleration, the flow's change in time moves with the field.
    change = field[:, :, 1] - field[:, :, 0]
    carried = tensor(LATTICE.acceleration(flow)) - change.detach()
    bend = torch.einsum("nij,ijd->dn", in_space, carried + change)
    dt = 0.5 - s
    position = torch.stack([x, y]) + dt * u + 0.5 * dt**2 * bend
    zoom = SAMPLING * scale
    at = kernels.MARGIN + (position + 0.5) * zoom - 0.5
    h, w = Contrast(LATTICE, scale).image.shape
    corner = at.detach().floor()
    (fx, fy), (j, i) = at - corner, corner.long()
    part = torch.arange(PARTS).repeat_interleave(
        torch.tensor([(k + 1) * len(x) // PARTS - k * len(x) // PARTS for k in range(PARTS)])
    )
    image = torch.zeros(PARTS * h * w, dtype=torch.float64)
    for di, dj, share in (
        (0, 0, (1 - fx) * (1 - fy)), (0, 1, fx * (1 - fy)), (1, 0, (1 - fx) * fy), (1, 1, fx * fy)
    ):  # fmt: skip
        image = image.index_add(0, part * h * w + (i + di) * w + j + dj, weights * share)
    taps = tensor(TAPS)
    image = image.reshape(PARTS, 1, h, w)
    # Wide enough that nothing is lost between the first and the second smoothing.
    image = torch.nn.functional.pad(image, (len(taps),) * 4)
    for kernel in (taps.reshape(1, 1, -1, 1), taps.reshape(1, 1, 1, -1)):
        padding = tuple(n // 2 for n in kernel.shape[2:])
        image = torch.nn.functional.conv2d(image, kernel, padding=padding)
    between = image.sum(dim=0).square().sum() - image.square().sum()
    contrast = 0.5 * zoom**2 * PARTS / (PARTS - 1) * between
    contrast.backward()
    return contrast.item(), field.grad.numpy().ravel()


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("roughness", [0.0, 1.5])
def test_gradient_is_that_of_autograd(scale, roughness):
    """Float32 positions are off by up to 1e-5 px of a gradient that changes over a pixel."""
    rng = np.random.default_rng(2)
    flow = constant(6.2, -3.9) + rng.normal(scale=roughness, size=LATTICE.shape)
    flow = flow.astype(np.float32)
    events = away_from_kinks(moving_dots((8, -5)), flow, scale)
    equations = equations_at(Contrast(LATTICE, scale), events, flow)
    value = value_at(Contrast(LATTICE, scale), events, flow)
    expected_value, expected = reference_gradient(events, flow, scale)
    assert value == pytest.approx(expected_value, rel=1e-5)
    assert np.linalg.norm(equations.vector - expected) < 5e-5 * np.linalg.norm(expected)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("u", [(0.3, 0.2), (6.2, -3.9), (-4.1, 2.7)])
def test_gradient_is_the_slope_of_the_contrast(scale, u):
    """A constant flow that shifts as a whole, by finite differences."""
    events = away_from_kinks(moving_dots((8, -5)), constant(*u), scale)
    contrast = Contrast(LATTICE, scale)
    equations = equations_at(contrast, events, constant(*u))
    h = 0.01
    for axis, (du, dv) in enumerate(((h, 0), (0, h))):
        ahead = value_at(contrast, events, constant(u[0] + du, u[1] + dv))
        behind = value_at(contrast, events, constant(u[0] - du, u[1] - dv))
        slope = equations.vector[axis::2].sum()
        size = np.abs(equations.vector).sum()  # the sum is of many nodes, either sign
        assert (ahead - behind) / (2 * h) == pytest.approx(slope, rel=0.01, abs=2e-3 * size)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("off", [2.0, -1.5])
def test_gradient_by_a_change_within_the_window(scale, off):
    """From a flow that changes by more, or less, than the true one."""
    events, contrast, h = moving_dots((8, -5)), Contrast(LATTICE, scale), 0.01
    change = np.ones(LATTICE.shape, np.float32) * np.float32([-1, 1])[:, None]
    flow = constant(8, -5) + np.float32(off) * change
    ahead = value_at(contrast, events, flow + h * change)
    behind = value_at(contrast, events, flow - h * change)
    slope = (ahead - behind) / (2 * h)
    gradient = equations_at(contrast, events, flow).vector @ change.ravel()
    assert gradient == pytest.approx(slope, rel=0.02)


def test_curvature_is_positive_semidefinite_and_leads_uphill():
    """With so many events that the corners of single bilinear votes do not show."""
    events = moving_dots((8, -5), per_dot=160)
    contrast = Contrast(LATTICE, 1.0)
    flow = constant(7.0, -4.2)
    for _ in range(8):
        before = value_at(contrast, events, flow)
        equations = equations_at(contrast, events, flow)
        equations.band[:, 0] += 1.0
        flow = flow + equations.solve().reshape(LATTICE.shape).astype(np.float32)
        after = value_at(contrast, events, flow)
        assert after > before - 1e-3 * before
    middle = flow[1:-1, 1:-1].mean(axis=(0, 1, 2))
    np.testing.assert_allclose(middle, [8, -5], atol=0.25)


def test_one_event_by_hand():
    """Half the sum of squares of a smoothed dot of the event's weight."""
    events = WindowEvents(*np.float32([*on_pixels([43], [31]), [0.5], [3.0]]))
    contrast = Contrast(LATTICE, 1.0)
    value = contrast.sharpen(events, constant(5, 5))
    squares = (TAPS.astype(np.float64) ** 2).sum()
    assert value == pytest.approx(0.5 * 9 * SAMPLING**2 * squares**2, rel=1e-5)
    assert contrast.image[31, 43] == contrast.image.max()  # already at the reference time
    assert contrast.image.sum() == pytest.approx(3.0, rel=1e-5)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e21])
@pytest.mark.parametrize("width", [120, 121])
def test_events_that_a_flow_takes_nowhere_are_left_out(bad, width):
    """Neither read nor written outside the images, of even and odd widths."""
    lattice = Lattice(width, 90, 5, 4)
    events = moving_dots((8, -5))
    flow = constant(8, -5, lattice)
    for part in (slice(0, 2), slice(None)):
        flow[part] = bad
        for scale in SCALES:
            contrast = Contrast(lattice, scale)
            contrast.linearise(events, flow)
            contrast.sharpen(events, flow)
    assert contrast.sharpen(events, flow) == 0


def test_a_lattice_of_other_times_is_refused():
    with pytest.raises(ValueError, match="needs a lattice of 2 times, not 3"):
        Contrast(Lattice(120, 90, 5, 4, 3), 1.0)


@pytest.mark.parametrize("scale", SCALES)
def test_contrast_is_highest_for_the_true_flow(scale):
    events = moving_dots((8, -5))
    contrast = Contrast(LATTICE, scale)
    at_truth = contrast.sharpen(events, constant(8, -5))
    for u, v in ((0, 0), (8, 5), (-8, 5), (16, -10), (4, -2.5)):
        assert contrast.sharpen(events, constant(u, v)) < 0.97 * at_truth


def test_scores_are_the_contrasts_of_constant_flows():
    events, contrast = moving_dots((8, -5)), Contrast(LATTICE, 0.5)
    flows = np.array([(8, -5), (-3.5, 12.25), (200, 0)], np.float32)
    expected = [contrast.sharpen(events, constant(*flow)) for flow in flows]
    np.testing.assert_allclose(contrast.scores(events, flows), expected, rtol=1e-4)


@pytest.mark.parametrize("displacement", [(0, 0), (12, -7), (-31, 22), (3.4, 44)])
def test_search_of_a_constant_flow(displacement):
    size = (240, 180)
    lattice = Lattice.with_spacing(*size, 30.0)
    events = moving_dots(displacement, size, dots=200, per_dot=20, seed=3)
    found = best_constant_flow(Contrast(lattice, 0.25), events, 48.0)
    np.testing.assert_allclose(found, displacement, atol=1.0)


def test_events_of_one_part_do_not_count_among_themselves():
    """A burst at one place is no contrast between parts; the same events over the window are."""
    at = np.float32(on_pixels([43] * 8, [31] * 8))
    s = np.linspace(0.4, 0.6, 8, dtype=np.float32)
    together = WindowEvents(*at, s, np.float32([1, 1, 0, 0, 0, 0, 0, 0]))
    apart = WindowEvents(*at, s, np.float32([1, 0, 0, 0, 0, 0, 0, 1]))
    contrast, still = Contrast(LATTICE, 1.0), constant(0, 0)
    unmoved = np.zeros((1, 2), np.float32)
    np.testing.assert_allclose(
        contrast.scores(together, unmoved), contrast.scores(apart, unmoved), rtol=1e-6
    )
    assert value_at(contrast, together, still) == pytest.approx(0, abs=1e-6)
    peak = SAMPLING**2 * (TAPS.astype(np.float64) ** 2).sum() ** 2
    assert value_at(contrast, apart, still) == pytest.approx(PARTS / (PARTS - 1) * peak, rel=1e-5)


@pytest.mark.parametrize("copies", [2, 5])
def test_contrast_grows_with_the_number_of_events(copies):
    """Each event k times: k events of weight 1 / sqrt(k), the contrast k times as large."""
    once = moving_dots((8, -5))
    columns = (np.repeat(c, copies) for c in (once.x, once.y, once.s, once.weights > 0))
    often = WindowEvents.prepare(*columns)
    contrast, flow = Contrast(LATTICE, 1.0), constant(7, -4)
    np.testing.assert_allclose(often.weights[::copies], once.weights / np.sqrt(copies), rtol=1e-5)
    assert contrast.sharpen(often, flow) == pytest.approx(
        copies * contrast.sharpen(once, flow), rel=1e-4
    )
