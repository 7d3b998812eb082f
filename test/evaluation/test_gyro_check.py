"""Rotation, units and time offset between a gyro and the events, in closed form."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.gyro.checks import axis_names
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.measurement import GyroMeans
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.evaluation.gyro_check import align, check_lines, mirrored_axes, nearest_axes
from emoflow_ros.evaluation.recording_options import GyroInput
from emoflow_ros.readers.reader_base import Imu

MS = 1_000_000
S = 1_000_000_000
START = 1_500_000_000 * S


def motion(t):
    """Angular velocity (N, 3) at t (N,) ns: varied, about all axes."""
    x = ((t - START) / S)[:, None]
    waves = np.sin(2 * np.pi * x * [0.7, 1.1, 1.9] + [0.0, 1.0, 2.0])
    return waves * [0.6, 0.5, 0.4]


def gyro_of(matrix, *, bias=(0.0, 0.0, 0.0), offset=0, seconds=6.0, noise=0.3):
    """Readings whose stamps lack `offset` ns, in the axes that `matrix` turns into the camera's."""
    t = START + np.arange(0, round(seconds * S), MS)
    w = motion(t) @ np.asarray(matrix)  # the inverse of a rotation, applied to rows
    w = w + np.radians(bias) + np.radians(noise) * np.random.default_rng(1).normal(size=w.shape)
    return t - offset, w


def intervals(seconds=6.0, stride=45):
    starts = START + np.arange(100 * MS, round((seconds - 0.4) * S), stride * MS)
    return starts, starts + 45 * MS


def events_of(starts, ends, sigma=1.0, outliers=0):
    rng = np.random.default_rng(2)
    w = motion((starts + ends) // 2) + np.radians(sigma) * rng.normal(size=(len(starts), 3))
    wrong = rng.permutation(len(starts))[:outliers]
    w[wrong] += rng.normal(size=(outliers, 3))
    return w


@pytest.mark.parametrize("angles", [(0, 0, 0), (3, -2, 1), (90, 0, 90), (170, 40, -30)])
@pytest.mark.parametrize("offset_ms", [0, 12.5, -80])
def test_rotation_bias_and_offset_are_found(angles, offset_ms):
    rotation = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    t, w = gyro_of(rotation, bias=(2, -1, 3), offset=round(offset_ms * MS))
    starts, ends = intervals()
    found = align(GyroMeans(t, w), starts, ends, events_of(starts, ends, outliers=25))
    apart = Rotation.from_matrix(found.rotation @ rotation.T).magnitude()
    assert np.degrees(apart) < 0.6
    assert found.scale == pytest.approx(1, abs=0.01)
    np.testing.assert_allclose(np.degrees(found.bias), (2, -1, 3), atol=0.4)
    assert found.offset_ns / MS == pytest.approx(offset_ms, abs=1.5)
    assert np.degrees(found.residual) < 2
    np.testing.assert_allclose(np.degrees(found.spread), np.degrees([0.42, 0.35, 0.28]), atol=6)


@pytest.mark.parametrize("unit", [np.degrees(1.0), np.radians(1.0)])
def test_units_show_in_the_scale(unit):
    t, w = gyro_of(np.eye(3))
    starts, ends = intervals()
    found = align(GyroMeans(t, w * unit), starts, ends, events_of(starts, ends))
    assert found.scale / unit == pytest.approx(1, abs=0.02)


def test_a_short_and_slow_recording_is_not_fitted_by_a_wild_gyro():
    t, w = gyro_of(np.eye(3), seconds=1.4)
    starts, ends = intervals(1.4)
    events = events_of(starts, ends, sigma=4.0)
    found = align(GyroMeans(t, w), starts, ends, events)
    assert abs(found.offset_ns) < 40 * MS
    assert np.degrees(np.abs(found.bias)).max() < 8


def test_too_few_windows_tell_nothing():
    t, w = gyro_of(np.eye(3))
    starts, ends = intervals()
    assert align(GyroMeans(t, w), starts[:7], ends[:7], events_of(starts[:7], ends[:7])) is None
    far = starts + 100 * S
    assert align(GyroMeans(t, w), far, far + 45 * MS, events_of(starts, ends)) is None


def test_means_are_integrals():
    t = np.arange(0, 100 * MS, 10 * MS)
    w = np.stack([t / S, np.ones(10), (t / S) ** 2], axis=1)
    means = GyroMeans(t, w).over(np.array([5 * MS, -1]), np.array([55 * MS, 50 * MS]))
    np.testing.assert_allclose(means[0, :2], [0.03, 1.0], atol=3e-4)
    assert np.isnan(means[1]).all()


def test_axes_have_names():
    matrix = np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0.0]])
    assert axis_names(matrix) == "+y, -z, -x"
    turned = Rotation.from_euler("xyz", (8, -5, 6), degrees=True).as_matrix() @ matrix
    np.testing.assert_array_equal(nearest_axes(turned), matrix)


def test_a_mirrored_axis_is_told_from_a_rotation():
    starts, ends = intervals()
    events = events_of(starts, ends)
    for matrix, mirrored in ((np.diag([-1.0, 1, 1]), True), (np.diag([-1.0, -1, 1]), False)):
        t, w = gyro_of(matrix)
        means = GyroMeans(t, w)
        found = align(means, starts, ends, events)
        axes = mirrored_axes(means.over(starts, ends), events, found.rotation)
        assert (axes is not None) is mirrored
        if mirrored:
            np.testing.assert_array_equal(axes, matrix)


def report(t, w, config=None):
    config = config or GyroConfig()
    imu = Imu("imu.txt", t, w, None)
    starts, ends = intervals()
    events = events_of(starts, ends)
    windows = [
        SimpleNamespace(ok=True, t_start=int(a) - 45 * MS, t_end=int(b) + 45 * MS, angular=e)
        for a, b, e in zip(starts, ends, events, strict=True)
    ]
    readings = GyroReadings.mounted(t, w, config.matrix(), config.time_offset_ns)
    return "\n".join(check_lines(windows, GyroInput(imu, readings), config))


def test_the_report_can_be_copied_into_parameters():
    rotation = Rotation.from_euler("xyz", (2, 0, 90), degrees=True).as_matrix()
    text = report(*gyro_of(rotation, bias=(2, -1, 3), offset=20 * MS))
    assert "imu.txt, 6000 readings at 1000 Hz" in text
    assert "the camera's (x, y, z) are (-y, +x, +z) of the IMU, and 2." in text
    line = next(line for line in text.splitlines() if "scale" in line)
    assert float(line.split()[4]) == pytest.approx(1, abs=0.01)
    assert line.endswith("times what the events show")
    assert "time offset: 20." in text or "time offset: 19." in text
    values = dict(word.split("=") for word in text.splitlines()[-1].split()[1:])
    config = GyroConfig(
        rotation=values["imu.rotation"], time_offset_ms=float(values["imu.time_offset_ms"])
    )
    apart = Rotation.from_matrix(config.matrix() @ rotation.T).magnitude()
    assert np.degrees(apart) < 0.6
    assert float(values["imu.bias_deg_s"]) == pytest.approx(3, abs=0.5)


def test_the_report_names_wrong_units_mirrors_and_still_cameras():
    t, w = gyro_of(np.eye(3))
    assert "its unit is deg/s and has to be rad/s" in report(t, np.degrees(w))
    assert "it was converted to rad/s twice" in report(t, np.radians(w))
    assert "(-x, +y, +z) of the IMU fit best" in report(*gyro_of(np.diag([-1.0, 1, 1])))
    text = report(*gyro_of(np.eye(3)))
    assert "mirror" not in text
    assert "fewer than 8 windows" in report(t + 100 * S, w)


def test_present_parameters_are_compared_with_the_best_ones():
    text = report(*gyro_of(np.eye(3)), GyroConfig(rotation="0,0,90"))
    line = next(line for line in text.splitlines() if "left between" in line)
    left, present = (float(word) for word in line.split() if word.replace(".", "").isdigit())
    assert left < 2 < 20 < present


@pytest.mark.parametrize("case", ["double speed", "unrelated", "another recording's"])
def test_an_imu_that_does_not_fit_gets_no_parameters(case):
    t, w = gyro_of(np.eye(3))
    if case == "double speed":
        t, w = gyro_of(np.eye(3), seconds=12.0)
        t = START + (t - START) // 2
    elif case == "unrelated":
        rng = np.random.default_rng(5)
        smooth = np.ones(150) / np.sqrt(150)
        w = np.stack([np.convolve(rng.normal(size=len(t)), smooth, "same") for _ in range(3)], 1)
    else:
        w = w[::-1]
    text = report(t, 0.6 * w)
    [line] = [line for line in text.splitlines() if "nothing fits" in line]
    explained, least = (int(share) for share in re.findall(r"(\d+)%", line))
    left, moving = (float(value) for value in re.findall(r"\d+\.\d+", line))
    assert explained < least == 70
    assert explained == pytest.approx(100 * (1 - (left / moving) ** 2), abs=1)
    assert "parameters" not in text


def test_a_gyro_that_fits_says_how_much_it_explains():
    text = report(*gyro_of(np.eye(3)))
    assert "which explain 100% of the rotation" in text.replace("99%", "100%")
    assert "parameters: imu.rotation=" in text
    mirrored = report(*gyro_of(np.diag([-1.0, 1, 1])))
    assert "no parameters can mend it" in mirrored
    assert "parameters: " not in mirrored
