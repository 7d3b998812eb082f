"""The factors of a random recording: what is drawn, and from which distribution."""

import dataclasses
import difflib
import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emoflow_ros.errors import InputError

Value = str | int | float
Draw = Callable[[np.random.Generator], Value]

SCENE_KINDS = ("room", "corridor", "street", "open_ground", "table_top", "plane")
TEXTURE_KINDS = ("leaves", "blotches", "noise", "stripes", "checker", "text")
MOTION_KINDS = (
    "hover",
    "calm",
    "shake",
    "turn_and_stop",
    "walking",
    "drone",
    "driving",
    "slider",
    "pan_tilt",
    "rotation",
    "stop_and_go",
    "still",
)
SENSORS = {
    "240x180": (240, 180),
    "346x260": (346, 260),
    "640x480": (640, 480),
    "1280x720": (1280, 720),
}


@dataclass(frozen=True)
class FactorSpec:
    """How one factor is drawn.

    Attributes:
        unit: of the value; empty for names and counts.
        distribution: in words, as the documentation has it.
        draw: draws a value.
        choices: the allowed names; empty for numbers.
        low, high: the allowed range of a number, ends included.
    """

    unit: str
    distribution: str
    draw: Draw
    choices: tuple[str, ...] = ()
    low: float = -math.inf
    high: float = math.inf


def _choice(shares: Mapping[str, float]) -> Any:
    names, weights = tuple(shares), np.array(list(shares.values()))
    text = ", ".join(f"{name} {100 * share:g} %" for name, share in shares.items())

    def draw(rng: np.random.Generator) -> str:
        return names[int(rng.choice(len(names), p=weights / weights.sum()))]

    return field(metadata={"spec": FactorSpec("", text, draw, choices=names)})


def _number(unit: str, text: str, low: float, high: float, draw: Draw) -> Any:
    def clipped(rng: np.random.Generator) -> Value:
        value = draw(rng)
        return type(value)(min(max(value, low), high))

    return field(metadata={"spec": FactorSpec(unit, text, clipped, low=low, high=high)})


def _uniform(unit: str, low: float, high: float) -> Any:
    text = f"uniform {low:g} to {high:g}"
    return _number(unit, text, low, high, lambda rng: float(rng.uniform(low, high)))


def _log_uniform(unit: str, low: float, high: float) -> Any:
    text = f"log-uniform {low:g} to {high:g}"
    logs = (math.log(low), math.log(high))
    return _number(unit, text, low, high, lambda rng: float(np.exp(rng.uniform(*logs))))


def _log_normal(unit: str, median: float, spread: float, low: float, high: float) -> Any:
    text = f"log-normal, median {median:g}, spread x{spread:g}, {low:g} to {high:g}"
    sigma = math.log(spread)
    return _number(
        unit, text, low, high, lambda rng: float(median * np.exp(sigma * rng.standard_normal()))
    )


def _beta(unit: str, a: float, b: float, high: float) -> Any:
    text = f"beta({a:g}, {b:g})" if high == 1 else f"{high:g} x beta({a:g}, {b:g})"
    return _number(unit, text, 0, high, lambda rng: float(high * rng.beta(a, b)))


def _count(text: str, high: int, draw: Callable[[np.random.Generator], int]) -> Any:
    return _number("", text, 0, high, draw)


def _sometimes(unit: str, chance: float, low: float, high: float) -> Any:
    """Zero, or with `chance` a value between low and high."""
    text = f"0, or with {100 * chance:.0f} % uniform {low:g} to {high:g}"

    def draw(rng: np.random.Generator) -> float:
        present, value = rng.random() < chance, float(rng.uniform(low, high))
        return value if present else 0.0

    return _number(unit, text, 0, high, draw)


@dataclass(frozen=True)
class Factors:
    """Everything that is drawn about a random recording.

    Each field's metadata holds its FactorSpec under "spec"; docs/simulation.md explains them.
    `seed` decides the details below the factors: where each box stands, the phases of the
    motion, the noise of each pixel.
    """

    seed: int

    scene: str = _choice(
        {
            "room": 0.34,
            "corridor": 0.16,
            "street": 0.16,
            "open_ground": 0.12,
            "table_top": 0.12,
            "plane": 0.10,
        }
    )
    depth_ratio: float = _log_normal("", 5.0, 2.0, 1.0, 50.0)
    clutter: int = _count("Poisson, mean 7, at most 30", 30, lambda rng: int(rng.poisson(7)))
    poles: int = _count("Poisson, mean 1, at most 8", 8, lambda rng: int(rng.poisson(1)))
    slants: int = _count("Poisson, mean 0.6, at most 5", 5, lambda rng: int(rng.poisson(0.6)))
    texture: str = _choice(
        {
            "leaves": 0.45,
            "blotches": 0.18,
            "noise": 0.12,
            "stripes": 0.07,
            "checker": 0.06,
            "text": 0.12,
            "photo": 0.0,
        }
    )
    feature_px: float = _log_normal("px", 6.0, 1.6, 2.0, 25.0)
    contrast: float = _log_normal("", 0.26, 1.6, 0.05, 0.7)
    blank_share: float = _beta("", 2.2, 1.6, 1.0)

    motion: str = _choice(
        {
            "hover": 0.13,
            "calm": 0.08,
            "shake": 0.12,
            "turn_and_stop": 0.08,
            "walking": 0.13,
            "drone": 0.14,
            "driving": 0.10,
            "slider": 0.04,
            "pan_tilt": 0.04,
            "rotation": 0.04,
            "stop_and_go": 0.04,
            "still": 0.06,
        }
    )
    image_motion: float = _log_normal("px per 100 ms", 7.0, 2.4, 0.1, 60.0)

    sensor: str = _choice({"240x180": 0.30, "346x260": 0.48, "640x480": 0.17, "1280x720": 0.05})
    focal: float = _log_normal("widths", 0.72, 1.25, 0.5, 1.5)
    lens: str = _choice(
        {"none": 0.25, "plumb_bob": 0.40, "equidistant": 0.35, "rational_polynomial": 0.0}
    )
    threshold: float = _log_normal("log intensity", 0.22, 1.3, 0.1, 0.4)
    off_ratio: float = _log_normal("", 0.93, 1.2, 0.6, 1.6)
    mismatch: float = _uniform("", 0.02, 0.12)
    refractory_us: int = _number(
        "us",
        "log-uniform 100 to 3000",
        0,
        10_000,
        lambda rng: round(math.exp(rng.uniform(math.log(100), math.log(3000)))),
    )
    noise_hz: float = _log_normal("Hz per pixel", 0.12, 5.0, 0.01, 10.0)
    leak_hz: float = _log_uniform("Hz per pixel", 0.001, 0.2)
    hot_pixels: int = _count(
        "geometric, mean 9, at most 100", 100, lambda rng: int(rng.geometric(0.1)) - 1
    )
    lowpass_hz: float = _log_uniform("Hz", 30.0, 1000.0)
    flicker: float = _sometimes("of the image", 0.08, 0.03, 0.3)
    lost: float = _sometimes("of the time", 0.1, 0.02, 0.3)
    calibration_error: float = _sometimes("", 1 / 3, 0.002, 0.02)

    movers: int = _count(
        "0: 70 %, 1: 18 %, 2: 8 %, 3: 4 %",
        3,
        lambda rng: int(rng.choice(4, p=(0.70, 0.18, 0.08, 0.04))),
    )
    mover_share: float = _beta("of the image", 1.5, 2.5, 0.4)
    mover_motion: float = _log_normal("px per 100 ms", 5.0, 2.0, 0.3, 30.0)

    def as_dict(self) -> dict[str, Value]:
        """Names and values, in order."""
        return dataclasses.asdict(self)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the sensor in pixels."""
        return SENSORS[self.sensor]

    def generator(self, part: str) -> np.random.Generator:
        """Return the random generator of one part of the recording ("layout", "noise", ...)."""
        return _generator(self.seed, part)


def factor_specs() -> dict[str, FactorSpec]:
    """All factors but the seed, by name."""
    fields = dataclasses.fields(Factors)
    return {f.name: f.metadata["spec"] for f in fields if "spec" in f.metadata}


def draw_factors(seed: int, fixed: Mapping[str, str] | None = None) -> Factors:
    """Draw every factor from its distribution, but for those that are given.

    Each factor has a generator of its own: fixing one leaves the others as they are.

    Args:
        seed: 0 or more.
        fixed: values by factor name, as text.

    Raises:
        InputError: a negative seed, an unknown factor, or a value that is not allowed.
    """
    if seed < 0:
        raise InputError("seed", str(seed), "give 0 or more")
    specs = factor_specs()
    fixed = fixed or {}
    for name in fixed:
        if name not in specs:
            near = difflib.get_close_matches(name, specs, n=1, cutoff=0.5)
            names = ", ".join(specs)
            fix = f"did you mean '{near[0]}'?" if near else f"use one of {names}"
            raise InputError("factor", f"unknown name '{name}'", fix)
    drawn = {name: spec.draw(_generator(seed, name)) for name, spec in specs.items()}
    given = {name: _parse(name, specs[name], drawn[name], text) for name, text in fixed.items()}
    return Factors(seed=seed, **{**drawn, **given})  # type: ignore[arg-type]


def _generator(seed: int, name: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def _parse(name: str, spec: FactorSpec, drawn: Value, text: str) -> Value:
    """Turn text into a value of the type of the drawn one."""
    if spec.choices:
        if text not in spec.choices:
            raise InputError(
                f"factor {name}", f"unknown value '{text}'", f"use one of {', '.join(spec.choices)}"
            )
        return text
    kind = "a whole number" if isinstance(drawn, int) else "a number"
    allowed = f"give {kind} from {spec.low:g} to {spec.high:g}"
    try:
        value = type(drawn)(text)
    except ValueError:
        raise InputError(f"factor {name}", f"'{text}'", allowed) from None
    if not spec.low <= float(value) <= spec.high:
        raise InputError(f"factor {name}", text, allowed)
    return value
