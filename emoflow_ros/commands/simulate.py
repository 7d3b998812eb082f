"""The executable `simulate`: write a synthetic recording with exact ground truth."""

import argparse
from pathlib import Path

import numpy as np

from emoflow_ros.cli import run
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.options import options_of, replace_options
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.factors import draw_factors, factor_specs
from emoflow_ros.simulation.messages import EVENT_ARRAY, POINT_CLOUD
from emoflow_ros.simulation.random_recording import simulate_random
from emoflow_ros.simulation.recording import LENSES, SCENES, SimulatedRecording, davis346, simulate
from emoflow_ros.simulation.recording_files import (
    FORMATS,
    OutputPaths,
    write_factors,
    write_recording,
)
from emoflow_ros.simulation.sensor import SensorModel
from emoflow_ros.simulation.simulated_truth import PERFECT, ImuModel

RANDOM = "random"
_EVENT_TYPES = {name.rpartition("/")[2]: name for name in (EVENT_ARRAY, POINT_CLOUD)}
_FIRST_START_OF_CLOUDS = 1  # s; before it their times could count from zero
_OF_SCENES = ("distortion", "fps", "threshold", "mismatch", "refractory_us", "noise")
# The options by the names that the simulation has for their values.
_OPTIONS = {
    "duration": "--duration",
    "fps": "--fps",
    "sensor.threshold": "--threshold",
    "sensor.mismatch": "--mismatch",
    "sensor.refractory_us": "--refractory-us",
    "sensor.noise_hz": "--noise",
}
_DISTORTION, _FPS = "equidistant", 1000
_LAST_START = 2**31 - 3600  # ROS 2 stamps hold seconds in 31 bits

_EPILOG = """\
writes to DIR:
  NAME_data.bag          /davis/left/events, /davis/left/camera_info, /davis/left/imu
  NAME_gt.bag            /davis/left/depth_image_rect, /davis/left/pose
  NAME_gt_flow_dist.npz  timestamps (s), x_flow_dist, y_flow_dist (px to the next stamp), moving
                         (pixels that see an object of its own motion)
  NAME_calib.yaml        camera_info
  NAME_factors.yaml      what was drawn (scene random)
(with --format rosbag2 the bags are the folders NAME_data and NAME_gt)

The scene random draws layout, textures, motion, camera and pixels from the seed; --set fixes
some of that, and the options --distortion to --noise, without --format, are not for it.

examples:
  simulate calm --out recordings --duration 2 --seed 1
  simulate random --out recordings --duration 3 --seed 7 --set motion=shake --set noise_hz=2
"""


def main() -> int:
    """Run the command line."""
    return run(lambda: _run(_parser().parse_args()))


def _parser() -> argparse.ArgumentParser:
    sensor = SensorModel()
    parser = argparse.ArgumentParser(
        prog="simulate",
        description="Simulate an event camera (DAVIS346) that moves through a textured 3-D "
        "scene, and write an MVSEC-shaped recording with exact ground truth. The same options "
        "give the same events.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    scenes = (*SCENES, RANDOM)
    add("scene", choices=scenes, metavar="SCENE", help=f"one of {', '.join(scenes)}")
    add("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    add("--name", help="start of the file names (default: the scene)")
    add("--duration", type=float, default=1.0, metavar="S", help="seconds (default: 1)")
    add("--seed", type=int, default=0, help="of everything random (default: 0)")
    add(
        "--set",
        action="append",
        default=[],
        metavar="FACTOR=VALUE",
        help=f"fix a factor of the scene random: {', '.join(factor_specs())}",
    )
    add("--format", choices=FORMATS, default=FORMATS[0], help="of the bags (default: rosbag1)")
    add(
        "--events",
        choices=_EVENT_TYPES,
        default="EventArray",
        help="message type: EventArray of dvs_msgs (default), or PointCloud2 of sensor_msgs, which "
        "every installation of ROS can replay",
    )
    add(
        "--distortion",
        choices=LENSES,
        help="lens model (default: equidistant, MVSEC's)",
    )
    add("--fps", type=int, help="rendered images per second (default: 1000)")
    add(
        "--threshold",
        type=float,
        help=f"change of log intensity per event (default: {sensor.threshold_on})",
    )
    add(
        "--mismatch",
        type=float,
        help=f"spread of the threshold over the pixels (default: {sensor.mismatch})",
    )
    add(
        "--refractory-us",
        type=int,
        metavar="US",
        help=f"dead time of a pixel in microseconds (default: {sensor.refractory_us})",
    )
    add(
        "--noise",
        type=float,
        metavar="HZ",
        help="background events per second and pixel (default: 0.1; 6 in the scene noisy)",
    )
    add(
        "--start-time",
        type=float,
        default=1_500_000_000.0,
        metavar="S",
        help="time of the first event in seconds since 1970 (default: 1500000000)",
    )
    add("--force", action="store_true", help="overwrite what is there")
    _add_imu_options(parser)
    return parser


def _add_imu_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "IMU", "in the camera's centre; each axis draws its bias and its scale"
    )
    for info in options_of(ImuModel()):
        flag = "--imu-" + info.name.replace("_", "-")
        help_text = f"{info.description} (default: {info.value:g})"
        group.add_argument(flag, type=float, metavar="X", help=help_text)
    group.add_argument(
        "--imu-perfect", action="store_true", help="no noise, bias or limit but those given"
    )


def _imu_model(args: argparse.Namespace) -> ImuModel:
    """Read the --imu options.

    Raises:
        InputError: one of them is out of range.
    """
    values = dict(PERFECT) if args.imu_perfect else {}
    names = [info.name for info in options_of(ImuModel())]
    given = {name: getattr(args, f"imu_{name}") for name in names}
    values |= {name: value for name, value in given.items() if value is not None}
    return replace_options(ImuModel(), values, "imu.")


def _run(args: argparse.Namespace) -> None:
    try:
        _simulate(args)
    except InputError as error:
        raise InputError(_as_option(error.where), error.wrong, error.fix) from None


def _as_option(where: str) -> str:
    """Name what is wrong as the command line does."""
    names = [info.name for info in options_of(ImuModel())]
    of_imu = {f"imu.{name}": "--imu-" + name.replace("_", "-") for name in names}
    return (_OPTIONS | of_imu).get(where, where)


def _simulate(args: argparse.Namespace) -> None:
    if args.seed < 0:
        raise InputError("--seed", str(args.seed), "give 0 or more")
    name = args.name or args.scene
    if Path(name).name != name:
        raise InputError("--name", f"'{name}' is a path", "give a name, and the folder with --out")
    if not 0 <= args.start_time <= _LAST_START:
        raise InputError("--start-time", f"{args.start_time} s", f"give 0 to {_LAST_START}")
    if args.events == "PointCloud2" and args.start_time < _FIRST_START_OF_CLOUDS:
        raise InputError(
            "--start-time",
            f"{args.start_time} s with --events PointCloud2",
            f"give {_FIRST_START_OF_CLOUDS} or more",
        )
    _imu_model(args)  # bad values are refused before the simulation starts
    if args.scene == RANDOM:
        _simulate_random(args, name)
    else:
        _simulate_scene(args, name)


def _simulate_scene(args: argparse.Namespace, name: str) -> None:
    if args.set:
        raise InputError("--set", f"the scene {args.scene} has no factors", "use the scene random")
    usual = SensorModel()
    sensor = SensorModel(
        threshold_on=usual.threshold_on if args.threshold is None else args.threshold,
        threshold_off=usual.threshold_off if args.threshold is None else args.threshold,
        mismatch=usual.mismatch if args.mismatch is None else args.mismatch,
        refractory_us=usual.refractory_us if args.refractory_us is None else args.refractory_us,
        noise_hz=args.noise,
    )
    paths = OutputPaths.within(args.out, name, args.format)
    paths.check(overwrite=args.force)
    recording = simulate(
        args.scene,
        duration_s=args.duration,
        seed=args.seed,
        camera=davis346(args.distortion or _DISTORTION),
        fps=_FPS if args.fps is None else args.fps,
        sensor=sensor,
        start_ns=round(args.start_time * NS_PER_S),
        progress=True,
    )
    _write(args, recording, paths)
    for path in paths:
        print(path)


def _simulate_random(args: argparse.Namespace, name: str) -> None:
    for option in _OF_SCENES:
        if getattr(args, option) is not None:
            flag = "--" + option.replace("_", "-")
            raise InputError(flag, "is not for the scene random", "fix a factor with --set")
    factors = draw_factors(args.seed, _assignments(args.set))
    paths = OutputPaths.within(args.out, name, args.format, factors=True)
    paths.check(overwrite=args.force)
    recording = simulate_random(
        factors,
        duration_s=args.duration,
        start_ns=round(args.start_time * NS_PER_S),
        progress=True,
    )
    _write(args, recording.as_given(), paths)
    assert paths.factors is not None
    write_factors(paths.factors, factors)
    for factor, value in factors.as_dict().items():
        print(f"{factor}: {value}")
    for path in paths:
        print(path)


def _assignments(words: list[str]) -> dict[str, str]:
    """Split FACTOR=VALUE."""
    for word in words:
        if "=" not in word:
            raise InputError("--set", f"'{word}'", "give FACTOR=VALUE")
    return dict(word.split("=", 1) for word in words)


def _write(args: argparse.Namespace, recording: SimulatedRecording, paths: OutputPaths) -> None:
    imu = write_recording(
        recording,
        paths,
        args.format,
        event_type=_EVENT_TYPES[args.events],
        imu=_imu_model(args),
        progress=True,
    )
    rate = len(recording.events) / args.duration / 1e6
    print(f"{len(recording.events)} events ({rate:.2f} Mev/s)")
    bias = ", ".join(f"{value:.2f}" for value in np.degrees(imu.bias))
    print(f"{len(imu.stamps)} readings of the IMU, bias of its gyro ({bias}) deg/s")
