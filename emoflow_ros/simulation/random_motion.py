"""How the camera of a random recording moves: sums of waves, steady rates and steps."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.simulation.scene import PITCH, ROLL, YAW, Step, Trajectory, Wave, X, Y, Z

_PLACE, _ROTATION = (X, Y, Z), (YAW, PITCH, ROLL)
_LARGEST_ROTATION = 0.45  # rad, amplitude of one wave: the scene stays in view
_FASTEST_HZ = 5.0


@dataclass(frozen=True)
class Demand:
    """What a motion has to achieve.

    Attributes:
        speed: RMS of the linear velocity if all image motion came from it, m/s.
        rate: the same for the angular velocity, rad/s.
        reach: how far the camera may move to and fro, m.
        duration: of the recording, s.
    """

    speed: float
    rate: float
    reach: float
    duration: float


@dataclass(frozen=True)
class Path:
    """The parts of a trajectory, which can be made larger and smaller.

    Attributes:
        waves, steps: on all channels.
        velocity: constant linear velocity (3,), m/s.
        lever: as in Trajectory.
    """

    waves: tuple[Wave, ...] = ()
    steps: tuple[Step, ...] = ()
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lever: tuple[float, float, float] | None = None

    def scaled(self, place: float, rotation: float) -> "Path":
        """Scale all translations and all rotations; the lever stays."""
        factor = [place] * 3 + [rotation] * 3
        return Path(
            tuple(replace(w, amplitude=w.amplitude * factor[w.channel]) for w in self.waves),
            tuple(replace(s, height=s.height * factor[s.channel]) for s in self.steps),
            (self.velocity[0] * place, self.velocity[1] * place, self.velocity[2] * place),
            self.lever,
        )

    def trajectory(
        self, yaw: float, pitch: float, start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Trajectory:
        """Start at a point (3,) in m with the given gaze in rad."""
        offset = np.array([*start, yaw, pitch, 0.0])
        for wave in self.waves:
            if wave.channel in _PLACE:
                offset[wave.channel] -= wave.amplitude * np.sin(wave.phase)
        if self.lever is not None:
            offset[:3] -= self.lever
        return Trajectory(
            tuple(offset), (*self.velocity, 0.0, 0.0, 0.0), self.waves, self.steps, self.lever
        )


def random_path(kind: str, demand: Demand, rng: np.random.Generator) -> Path:
    """Draw a motion of a kind (one of factors.MOTION_KINDS)."""
    return _KINDS[kind](demand, rng)


def mover_path(demand: Demand, rng: np.random.Generator) -> Path:
    """Draw the motion of an object: to and fro across the image, turning a little."""
    across = _waves((X, Y), demand.speed, (0.2, 1.0), demand.reach, rng)
    along = _waves((Z,), 0.3 * demand.speed, (0.2, 0.6), 0.3 * demand.reach, rng)
    return Path(
        across + along + _waves(_ROTATION, 0.3 * demand.rate, (0.2, 0.8), _LARGEST_ROTATION, rng)
    )


def _hover(demand: Demand, rng: np.random.Generator) -> Path:
    return _floating(demand, rng, rng.uniform(0.3, 0.7), (0.2, 0.9))


def _calm(demand: Demand, rng: np.random.Generator) -> Path:
    return _floating(demand, rng, rng.uniform(0.3, 0.6), (0.1, 0.35))


def _shake(demand: Demand, rng: np.random.Generator) -> Path:
    return _floating(demand, rng, rng.uniform(0.75, 0.95), (1.0, _FASTEST_HZ))


def _turn_and_stop(demand: Demand, rng: np.random.Generator) -> Path:
    """Quick turns with rests between them, held by hand."""
    steps = []
    t, gaze = float(rng.uniform(-0.2, 0.3)), np.zeros(2)
    while t < demand.duration:
        length = float(rng.uniform(0.3, 0.7))
        # The RMS over turn and rest is about half of the turn's mean rate.
        turn = rng.normal(0, 1, 2) * (1.0, 0.5) * 2 * demand.rate * length
        turn = np.clip(gaze + turn, -0.6, 0.6) - gaze
        gaze += turn
        steps += [Step(YAW, float(turn[0]), t, length), Step(PITCH, float(turn[1]), t, length)]
        t += length + float(rng.uniform(0.15, 0.7))
    rest = _floating(demand, rng, 0.5, (0.3, 1.5)).scaled(0.1, 0.1)
    return Path(rest.waves, tuple(steps))


def _walking(demand: Demand, rng: np.random.Generator) -> Path:
    """Ahead at a steady pace; every step lifts, sways and rolls the camera."""
    share = rng.uniform(0.3, 0.6)
    pace = float(rng.uniform(1.7, 2.2))  # steps per second
    phase = float(rng.uniform(0, 2 * np.pi))
    speed, rate = np.sqrt(1 - share) * demand.speed, np.sqrt(share) * demand.rate
    bob = 0.25 * speed / (2 * np.pi * pace)
    waves = [
        Wave(Y, bob, pace, phase),
        Wave(X, 1.2 * bob, pace / 2, phase + 1.0),
        Wave(PITCH, 0.5 * rate / (2 * np.pi * pace), pace, phase + 0.7),
        Wave(ROLL, 0.5 * rate / (np.pi * pace), pace / 2, phase + 1.6),
    ]
    look = _waves(_ROTATION, 0.8 * rate, (0.2, 1.2), _LARGEST_ROTATION, rng)
    return _ahead(speed, demand, (*waves, *look), rng)


def _drone(demand: Demand, rng: np.random.Generator) -> Path:
    """Slow flight in any direction, tilts that go with it, and a little vibration."""
    share = rng.uniform(0.25, 0.6)
    speed, rate = np.sqrt(1 - share) * demand.speed, np.sqrt(share) * demand.rate
    waves = (
        *_waves(_PLACE, 0.6 * speed, (0.15, 0.8), demand.reach, rng),
        *_waves(_ROTATION, 0.9 * rate, (0.2, 1.5), _LARGEST_ROTATION, rng),
        *_waves(_ROTATION, 0.1 * rate, (3.0, _FASTEST_HZ), _LARGEST_ROTATION, rng),
    )
    return _ahead(0.8 * speed, demand, waves, rng)


def _driving(demand: Demand, rng: np.random.Generator) -> Path:
    """Ahead, with slow turns and the nodding of the suspension."""
    share = rng.uniform(0.05, 0.3)
    speed, rate = np.sqrt(1 - share) * demand.speed, np.sqrt(share) * demand.rate
    waves = (
        *_waves((YAW,), rate, (0.1, 0.4), 0.25, rng),
        *_waves((PITCH, ROLL), 0.25 * rate, (1.0, 2.0), 0.05, rng),
        *_waves((Y,), 0.02 * speed, (1.0, 2.0), 0.1 * demand.reach, rng),
    )
    return _ahead(speed, demand, waves, rng)


def _slider(demand: Demand, rng: np.random.Generator) -> Path:
    """Along a line, without any rotation."""
    axis = rng.normal(0, 1, 3) * (1.0, 0.4, 0.4)
    axis /= np.linalg.norm(axis)
    if demand.speed * demand.duration < 2 * demand.reach:
        start = demand.speed * axis
        return Path(velocity=(float(start[0]), float(start[1]), float(start[2])))
    wave = _waves((X,), demand.speed, (0.1, 0.3), demand.reach, rng)[0]
    return Path(_along(wave, axis, _PLACE))


def _pan_tilt(demand: Demand, rng: np.random.Generator) -> Path:
    """Turns about a point that is not the camera's centre."""
    waves = _waves((YAW, PITCH), demand.rate, (0.1, 0.8), 0.6, rng)
    lever = rng.uniform((-0.06, -0.1, 0.03), (0.06, 0.1, 0.2))
    return Path(waves, lever=(float(lever[0]), float(lever[1]), float(lever[2])))


def _rotation(demand: Demand, rng: np.random.Generator) -> Path:
    """Turns about one axis in any direction through the camera's centre."""
    axis = rng.normal(0, 1, 3)
    axis /= np.linalg.norm(axis)
    waves = _waves((YAW,), demand.rate, (0.15, 1.5), 0.6, rng)
    return Path(tuple(part for wave in waves for part in _along(wave, axis, _ROTATION)))


def _stop_and_go(demand: Demand, rng: np.random.Generator) -> Path:
    """Moves from rest to rest on all channels, with waits between them."""
    share = rng.uniform(0.3, 0.7)
    scale = np.repeat([np.sqrt(1 - share) * demand.speed, np.sqrt(share) * demand.rate], 3)
    limit = np.repeat([demand.reach, _LARGEST_ROTATION], 3)
    steps, t, place = [], float(rng.uniform(-0.3, 0.6)), np.zeros(6)
    while t < demand.duration:
        length = float(rng.uniform(0.4, 1.2))
        move = rng.normal(0, 1, 6) * scale * length
        move = np.clip(place + move, -limit, limit) - place
        place += move
        steps += [Step(k, float(move[k]), t, length) for k in range(6)]
        t += length + float(rng.uniform(0.2, 0.8))
    return Path(steps=tuple(steps))


def _still(demand: Demand, rng: np.random.Generator) -> Path:
    return Path()


_KINDS: dict[str, Callable[[Demand, np.random.Generator], Path]] = {
    "hover": _hover,
    "calm": _calm,
    "shake": _shake,
    "turn_and_stop": _turn_and_stop,
    "walking": _walking,
    "drone": _drone,
    "driving": _driving,
    "slider": _slider,
    "pan_tilt": _pan_tilt,
    "rotation": _rotation,
    "stop_and_go": _stop_and_go,
    "still": _still,
}


def _floating(
    demand: Demand, rng: np.random.Generator, share: float, band: tuple[float, float]
) -> Path:
    """Waves on all channels; `share` of the image's motion (its square) comes from rotation."""
    place = _waves(_PLACE, np.sqrt(1 - share) * demand.speed, band, demand.reach, rng)
    return Path(
        place + _waves(_ROTATION, np.sqrt(share) * demand.rate, band, _LARGEST_ROTATION, rng)
    )


def _ahead(speed: float, demand: Demand, waves: tuple[Wave, ...], rng: np.random.Generator) -> Path:
    """Move ahead steadily at twice the speed: points straight ahead move little in the image."""
    return Path(waves, velocity=(float(0.1 * speed * rng.normal()), 0.0, float(2 * speed)))


def _waves(
    channels: tuple[int, ...],
    rms: float,
    band: tuple[float, float],
    largest: float,
    rng: np.random.Generator,
) -> tuple[Wave, ...]:
    """Two waves on each channel whose rates of change have the given RMS together.

    Args:
        channels: share the motion at random.
        rms: of the velocity, in the channels' unit per second.
        band: lowest and highest frequency, Hz; raised where the amplitude would be too large.
        largest: amplitude of one wave.
        rng: draws shares, frequencies and phases.
    """
    shares = rng.dirichlet(np.full(2 * len(channels), 1.0))
    low, high = np.log(band)
    drawn = np.exp(rng.uniform(low, high, len(shares)))
    phases = rng.uniform(0, 2 * np.pi, len(shares))
    waves = []
    for k, (share, hz, phase) in enumerate(zip(shares, drawn, phases, strict=True)):
        peak = np.sqrt(2 * share) * rms
        hz = min(max(hz, peak / (2 * np.pi * largest)), _FASTEST_HZ)
        waves.append(
            Wave(channels[k // 2], float(peak / (2 * np.pi * hz)), float(hz), float(phase))
        )
    return tuple(waves)


def _along(wave: Wave, axis: NDArray[np.float64], channels: tuple[int, ...]) -> tuple[Wave, ...]:
    """The same wave on three channels at once, along an axis (3,)."""
    return tuple(
        Wave(channel, wave.amplitude * float(part), wave.frequency, wave.phase)
        for channel, part in zip(channels, axis, strict=True)
    )
