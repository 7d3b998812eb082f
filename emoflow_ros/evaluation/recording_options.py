"""Command-line options of commands over recordings, and what they select.

They select a recording, a configuration and, for an evaluation, a gyro.
"""

import argparse
import math
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from emoflow_ros.config import Config
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.benchmark_sequences import BenchmarkSequence
from emoflow_ros.readers import Recording, open_recording
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.column_arguments import add_column_options
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.readers.reader_base import Imu
from emoflow_ros.readers.text_tables import read_imu_text

OFF = "off"
_MOST = "window.max_displacement_px"
_SHARE = re.compile(r": \d+ % of windows")


@dataclass(frozen=True)
class Source:
    """Where a recording is and how it is opened.

    Attributes:
        path: a recording of any known format.
        topic: the event topic, where it has several.
        calibration: a file that takes the place of the recording's own calibration.
        columns: what the user says of columns of numbers.
        sequence: of a benchmark, if any; topic and calibration come before what it prescribes.
    """

    path: Path
    topic: str | None = None
    calibration: Path | None = None
    sequence: BenchmarkSequence | None = None
    columns: ColumnOptions | None = None

    def resolved(self) -> "Source":
        """Return the same with absolute paths, for other processes."""
        calibration = self.calibration and self.calibration.resolve()
        return replace(self, path=self.path.resolve(), calibration=calibration)

    def open(self) -> Recording:
        """Open the recording: use it as a context manager.

        Raises:
            InputError: see `open_recording`.
        """
        topic = self.topic
        if self.sequence and topic is None and BagRecording.matches(self.path):
            topic = self.sequence.topic
        recording = open_recording(
            self.path, topic=topic, calibration=self.calibration, columns=self.columns
        )
        if self.sequence and self.sequence.camera and self.calibration is None:
            recording.camera = self.sequence.camera
        return recording


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add --calib, --topic, --layout, --time-unit and --sequence."""
    parser.add_argument(
        "--calib",
        type=Path,
        metavar="FILE",
        help="calibration: camera_info YAML, Kalibr camchain, OpenCV YAML or ECD calib.txt "
        "(default: the recording's own)",
    )
    parser.add_argument("--topic", metavar="T", help="event topic, where the recording has several")
    add_column_options(parser)
    parser.add_argument(
        "--sequence",
        metavar="NAME",
        help="a benchmark's sequence, for example indoor_flying1: sets calibration and event "
        "topic, and the frames and rows that protocols count",
    )


def add_configuration_options(parser: argparse.ArgumentParser) -> None:
    """Add --profile, --window-ms, --stride-ms and --set."""
    parser.add_argument(
        "--profile", default="realtime", metavar="NAME", help="configuration (default: realtime)"
    )
    parser.add_argument(
        "--window-ms",
        type=float,
        metavar="MS",
        help="take whole windows of this length, however fast the motion is, unless --set "
        f"{_MOST}=PX bounds it (default: the profile's windows)",
    )
    parser.add_argument(
        "--stride-ms",
        type=float,
        metavar="MS",
        help="from one window's start to the next one's; more than a window's length counts as "
        "that (default: the length given with --window-ms, else the profile's stride)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="overrides",
        help="any option by its dotted name, for example estimator.max_events=20000; repeatable",
    )


def overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Collect option values by dotted name; --set counts after the shorthands.

    Windows of --window-ms are whole and follow one another: a profile's bound on their motion and
    its stride belong to the profile's own length.

    Raises:
        InputError: a --set that is not NAME=VALUE.
    """
    values: dict[str, Any] = {}
    if options.window_ms is not None:
        values["window.duration_ms"] = options.window_ms
        values["window.stride_ms"] = 0.0
        values[_MOST] = 0.0
    if options.stride_ms is not None:
        values["window.stride_ms"] = options.stride_ms
    for text in options.overrides:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError(f"--set {text}", "not of the form NAME=VALUE", "write name=value")
        try:
            values[name] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise InputError(f"--set {text}", "not a value", "write a number or a word") from None
    return values


def positive(text: str) -> int:
    """Parse a count of at least 1, for argparse."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a number of at least 1")
    return int(text)


def positive_number(text: str) -> float:
    """Parse a number above 0, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a number above 0")
    return value


def make_folder(folder: Path) -> None:
    """Make the folder of --out, where it is not there.

    Raises:
        InputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(folder, f"cannot be made ({reason})", "give another --out") from None


@dataclass(frozen=True)
class GyroInput:
    """A recording's IMU, and its angular velocity in the camera's frame.

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
        InputError: an IMU is to be checked, but --imu is off.
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
    elif named is not None and "." in named:  # no topic has a dot
        raise InputError(f"--imu {named}", "no such file", "check the path")
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
    """Count the windows by what became of the gyro, for example `used 95 %, none 5 %`.

    The shares of windows in their own reasons are left out.
    """
    counts = Counter(_SHARE.sub("", status) for status in statuses)
    total = max(1, sum(counts.values()))
    return ", ".join(f"{name} {100 * n / total:.0f} %" for name, n in counts.most_common())
