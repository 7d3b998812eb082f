"""Command-line options that executables over recordings share, and what they mean."""

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from emoflow_ros.errors import InputError
from emoflow_ros.offline.sequences import Sequence
from emoflow_ros.readers import Recording, open_recording
from emoflow_ros.readers.bag import BagRecording

_MOST = "window.max_displacement_px"


@dataclass(frozen=True)
class Source:
    """Where a recording is and how it is opened.

    Attributes:
        path: a recording of any known format.
        topic: the event topic, where it has several.
        calibration: a file that takes the place of the recording's own calibration.
        sequence: a benchmark's; what it prescribes yields to topic and calibration.
    """

    path: Path
    topic: str | None = None
    calibration: Path | None = None
    sequence: Sequence | None = None

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
        recording = open_recording(self.path, topic=topic, calibration=self.calibration)
        if self.sequence and self.sequence.camera and self.calibration is None:
            recording.camera = self.sequence.camera
        return recording


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add --calib, --topic and --sequence."""
    parser.add_argument(
        "--calib",
        type=Path,
        metavar="FILE",
        help="calibration: camera_info YAML or ECD calib.txt (default: the recording's own)",
    )
    parser.add_argument("--topic", metavar="T", help="event topic, where the recording has several")
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
