"""The README's animation: what its pictures show, and what is written."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.animation import __main__ as command
from benchmarks.animation import drawing
from benchmarks.animation.drawing import OFF, ON, Flight, Step
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window

ROOT = Path(__file__).resolve().parents[1]
CAMERA = Camera(60, 40, 50.0, 50.0, 30.0, 20.0)
SPEED = 100.0  # px/s, to the right


class Sliding:
    """The flow of an image that moves to the right."""

    def velocity(self, t: int) -> np.ndarray:
        return np.full((40, 60, 2), (SPEED, 0.0), np.float32)

    def tracks(self, points: np.ndarray, times) -> np.ndarray:
        seconds = (np.array(times) - times[0]) / 1e9
        return points + seconds[:, None, None] * (SPEED, 0.0)


def step(number: int, *, found: bool = True) -> Step:
    """A window of 100 ms in which a vertical edge moves by 10 px, one event per pixel and ms."""
    start = number * 100 * NS_PER_MS
    t = np.repeat(np.arange(100), 40)
    x = 10 + np.floor(SPEED * t / 1000)
    events = Events(
        x.astype(np.uint16),
        np.tile(np.arange(40), 100).astype(np.uint16),
        start + t * NS_PER_MS,
        np.tile(np.arange(40) % 2 == 0, 100),
    )
    window = Window(start, start + 100 * NS_PER_MS, events)
    middle = start + 50 * NS_PER_MS
    if not found:
        return Step(window, Estimate(start, window.t_end, middle, Status.LOST, Quality(0)))
    return Step(
        window,
        Estimate(
            start, window.t_end, middle, Status.OK, Quality(4000), MotionModel.ROTATION,
            angular=np.radians([0.0, 10.0, 0.0]), covariance=np.diag([-1, 0, 0, 1e-3, 1e-3, 1e-3]),
            flow=Sliding(), motion=object(),
        ),
    )  # fmt: skip


def test_events_are_those_of_the_middle_in_two_colours():
    image = drawing.recent(step(0).window, 50 * NS_PER_MS, CAMERA)
    lit = (image != drawing._rgb(drawing.BACKGROUND)).any(axis=-1)
    assert np.unique(np.nonzero(lit)[1]).tolist() == [13, 14, 15, 16]  # 35 to 65 ms
    assert image[2, 14].tolist() == list(ON) and image[3, 14].tolist() == list(OFF)


def test_sharpened_picture_has_the_edge_where_it_is_in_the_middle():
    _, sharp, flow = drawing.panels(CAMERA, step(0), SPEED)
    bright = sharp.sum(axis=(0, 2))
    assert np.argmax(bright) == 15 and bright[15] > 3 * bright[13]
    red, green, blue = flow[20, 15].astype(int)  # to the right is red
    assert red > 200 and red > 2 * max(green, blue)


def test_window_without_an_estimate_has_events_alone():
    raw, sharp, flow = drawing.panels(CAMERA, step(0, found=False), SPEED)
    assert (raw != sharp).any() and (sharp == flow).all() and len(np.unique(flow)) <= 3


def test_curves_end_where_the_animation_is():
    steps = [step(0), step(1, found=False), step(2), step(3)]
    flight = Flight(CAMERA, step(0).window.events, None)
    green = np.array([98, 210, 111])  # the colour of y
    first, last = (drawing.chart(flight, steps, i).astype(int) for i in (0, 3))
    assert first.shape == (drawing.CHART_PX, drawing.WIDTH_PX, 3)
    assert (np.abs(last - green).sum(-1) < 60).sum() > (np.abs(first - green).sum(-1) < 60).sum()


@pytest.mark.parametrize("ending", [".webp", ".gif", ".png"])
def test_animation_is_written(tmp_path, ending):
    frames = [np.full((20, 30, 3), value, np.uint8) for value in (0, 100, 200)]
    drawing.save(tmp_path / f"a{ending}", frames, 80.0)
    with Image.open(tmp_path / f"a{ending}") as image:
        assert (image.n_frames, image.size) == (3, (30, 20))
        image.seek(1)
        assert abs(int(image.convert("RGB").getpixel((5, 5))[0]) - 100) < 4


def test_bad_ending_is_refused_before_anything_is_simulated(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["animation", "--out", "flight.mp4"])
    assert command.main() == 2
    assert "give one of .webp, .gif, .png" in capsys.readouterr().err


def test_recording_is_shown_without_truth(shared_data, monkeypatch, tmp_path, capsys):
    folder = shared_data / "ecd" / "shapes_rotation"
    words = [str(folder), "--duration", "0.5", "--out", str(tmp_path / "real.gif")]
    monkeypatch.setattr("sys.argv", ["animation", *words, "--profile", "realtime"])
    seen: list[object] = []

    def estimated(flight, profile):
        seen.extend([flight.camera.size, len(flight.events)])
        return iter([step(0), step(1)])

    monkeypatch.setattr(command, "estimated", estimated)
    dark = np.zeros((180, 240, 3), np.uint8)
    monkeypatch.setattr(drawing, "panels", lambda *_: (dark, dark, dark))
    assert command.main() == 0
    assert capsys.readouterr().out.startswith("2 frames")
    assert seen == [(240, 180), 20_000]


def test_animation_of_the_readme_is_small_and_moves():
    path = ROOT / "docs" / "images" / "flight.webp"
    assert path.stat().st_size <= command.MOST_BYTES
    with Image.open(path) as image:
        assert image.n_frames > 20
    assert "docs/images/flight.webp" in (ROOT / "README.md").read_text()
