"""The gyro of an evaluation: which one, and its readings on the events' clock."""

import argparse
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from emoflow_ros.core.config import Config
from emoflow_ros.core.gyro_config import GyroConfig
from emoflow_ros.core.gyro_readings import GyroReadings
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers import Recording
from emoflow_ros.readers.ecd import read_imu_text
from emoflow_ros.readers.recording import Imu

OFF = "off"
_SHARE = re.compile(r": \d+ % of windows")


@dataclass(frozen=True)
class GyroInput:
    """A recording's IMU, and what it says in the camera's frame.

    Attributes:
        imu: as it was read.
        readings: mounted as the parameters say.
    """

    imu: Imu
    readings: GyroReadings

    @property
    def description(self) -> str:
        """For example `imu.txt, 1430 readings at 1000 Hz`."""
        return f"{self.imu.name}, {len(self.imu)} readings at {self.imu.rate:.0f} Hz"


def add_imu_options(parser: argparse.ArgumentParser) -> None:
    """Add --imu and --check-imu."""
    parser.add_argument(
        "--imu",
        metavar="TOPIC|FILE|off",
        help="use this gyro: a topic of the bag, or a file 't ax ay az gx gy gz' in s, m/s^2 and "
        "rad/s (default: as imu.use says, the recording's own)",
    )
    parser.add_argument(
        "--check-imu",
        action="store_true",
        help="estimate without the gyro, and report the rotation, units and time offset that fit "
        "best between it and the events",
    )


def with_choice(config: Config, choice: str | None, *, check: bool = False) -> Config:
    """Return the configuration with `imu.use` as the options say, if one was given.

    Raises:
        InputError: an IMU is to be checked and none to be used.
    """
    if check and choice == OFF:
        raise InputError("--check-imu", "there is nothing to check with --imu off", "name the IMU")
    if choice is None and not check:
        return config
    use = OFF if choice == OFF else "require"
    return replace(config, imu=replace(config.imu, use=use))


def read_gyro(recording: Recording, config: GyroConfig, choice: str | None) -> GyroInput | None:
    """Read the IMU that the options ask for; None where none is to be used, or there is none.

    Args:
        recording: opened.
        config: `use` counts.
        choice: a topic of a bag, or a file like ECD's imu.txt; None takes the recording's own.

    Raises:
        InputError: an IMU is required and not there, its data cannot be used, its mounting is not
            known, or its times are not those of the events.
    """
    if config.use == OFF:
        return None
    rotation = config.matrix()
    named = choice if choice != OFF else None
    if named is not None and Path(named).is_file():
        imu: Imu | None = read_imu_text(Path(named))
    else:
        imu = recording.imu(named)
    if imu is None:
        if config.use == "require":
            raise InputError(
                recording.path, "has no IMU", "give a file with --imu FILE, or --imu off"
            )
        return None
    readings = GyroReadings.mounted(imu.t, imu.angular, rotation, config.time_offset_ns)
    _require_common_time(recording, imu.name, readings)
    return GyroInput(imu, readings)


def _require_common_time(recording: Recording, name: str, readings: GyroReadings) -> None:
    """Refuse an IMU on another clock.

    Raises:
        InputError: it has no reading in the recording's time.
    """
    chunks = recording.event_chunks()
    first = next((int(events.t[0]) for events in chunks if len(events)), None)
    if first is None:
        return
    length = np.inf if recording.duration is None else recording.duration * NS_PER_S
    begin, end = int(readings.t[0]), int(readings.t[-1])
    if end < first or begin > first + length:
        raise InputError(
            name,
            f"its times, {begin / NS_PER_S:.3f} to {end / NS_PER_S:.3f} s, are not those of the "
            f"events, from {first / NS_PER_S:.3f} s on",
            "bring them to the events' clock, or give --imu off",
        )


def shares(statuses: Iterable[str]) -> str:
    """Count what the windows say of the gyro, for example `used 95 %, none 5 %`.

    The shares of windows in their own reasons are left out.
    """
    counts = Counter(_SHARE.sub("", status) for status in statuses)
    total = max(1, sum(counts.values()))
    return ", ".join(f"{name} {100 * n / total:.0f} %" for name, n in counts.most_common())
