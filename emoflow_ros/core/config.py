"""Typed configuration: defaults in the dataclasses, profiles in config/, overrides by name.

It holds the options of the gyro, too, and refuses a configuration that needs PyTorch or a CUDA
device where there is none. Only the published method and CUDA need PyTorch, so it is imported late.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.events import WindowPolicy
from emoflow_ros.core.implicit.implicit_config import ImplicitConfig
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.options import option, options_of, replace_options
from emoflow_ros.core.thinning import EventBudget
from emoflow_ros.errors import InputError, say

ROTATION_FROM_TF = "tf"
# DAVIS drivers publish the IMU in the camera's axes, and so do MVSEC's bags.
ROTATIONS = {"davis": (0.0, 0.0, 0.0), "mvsec": (0.0, 0.0, 0.0)}

_ESTIMATORS: dict[str, type[LatticeConfig | ImplicitConfig]] = {
    "lattice": LatticeConfig,
    "implicit": ImplicitConfig,
}

# Options of earlier versions, and what takes their place.
_REMOVED = {
    "estimator.max_doubt": "nothing is withheld any more, the covariance says how sure a twist is; "
    "output.max_angular_sd and output.max_direction_sd hold back what is wider",
}

_INSTALL_TORCH = "install it (pip install torch torchdiffeq)"


@dataclass(frozen=True)
class GyroConfig:
    """Whether a gyro is used, how it is mounted, and its errors; docs/operations.md explains them.

    Raises:
        InputError: `rotation` is neither three angles nor a known name.
    """

    use: str = option(
        "off",
        "off: use no gyro; auto: use one if there is one; require: the same, and report an error "
        "while there is none",
        choices=("off", "auto", "require"),
    )
    rotation: str = option(
        "0,0,0",
        "orientation of the IMU in the camera's optical frame: roll,pitch,yaw in degrees (about "
        f"x, then y, then z, as in URDF), {' or '.join(ROTATIONS)}, or tf",
    )
    time_offset_ms: float = option(
        0.0,
        "added to the IMU's stamps to get the events' time",
        unit="ms",
        minimum=-10_000.0,
        maximum=10_000.0,
    )
    noise: float = option(
        0.01,
        "noise density of the gyro",
        unit="deg/s per square root of Hz",
        minimum=1e-5,
        maximum=10.0,
    )
    bias_deg_s: float = option(
        1.0,
        "standard deviation of the gyro's bias before anything is known of it",
        unit="deg/s",
        minimum=0.0,
        maximum=100.0,
    )
    bias_walk: float = option(
        0.02,
        "random walk of the bias",
        unit="deg/s per square root of a second",
        minimum=0.0,
        maximum=10.0,
    )
    scale_error: float = option(
        0.01, "relative standard deviation of the gyro's scale", minimum=0.0, maximum=0.5
    )
    rotation_error_deg: float = option(
        0.3,
        "standard deviation of the rotation between IMU and camera",
        unit="deg",
        minimum=0.0,
        maximum=30.0,
    )
    range_deg_s: float = option(
        2000.0,
        "angular velocity that the gyro cannot exceed; 0 if it is not known",
        unit="deg/s",
        minimum=0.0,
        maximum=1e5,
    )

    def __post_init__(self) -> None:
        if self.rotation != ROTATION_FROM_TF:
            self.matrix()

    def matrix(self) -> NDArray[np.float64]:
        """Rotation (3, 3) from the IMU's axes to the optical frame.

        Raises:
            InputError: `rotation` is tf, which only the node knows, or no rotation at all.
        """
        text = self.rotation.strip()
        angles = ROTATIONS.get(text) or _angles(text)
        if angles is None:
            wrong, names = f"'{text}' is no rotation", ", ".join((*ROTATIONS, ROTATION_FROM_TF))
            if text == ROTATION_FROM_TF:
                wrong, names = "only the node has tf", ", ".join(ROTATIONS)
            raise InputError(
                "imu.rotation", wrong, f"give 'roll,pitch,yaw' in degrees, or one of {names}"
            )
        return np.asarray(Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), np.float64)

    @property
    def time_offset_ns(self) -> int:
        """What is added to the IMU's stamps, ns."""
        return round(self.time_offset_ms * 1e6)


def _angles(text: str) -> tuple[float, ...] | None:
    """Three finite numbers with commas between them; None if that is not what it is."""
    try:
        angles = tuple(float(word) for word in text.split(","))
    except ValueError:
        return None
    return angles if len(angles) == 3 and np.isfinite(angles).all() else None


@dataclass(frozen=True)
class Config:
    """The whole configuration of an estimation run."""

    profile: str = option("realtime", "profile that the values came from")
    method: str = option(
        "lattice",
        "estimator: the real-time lattice field, or the published coordinate network",
        choices=tuple(_ESTIMATORS),
    )
    window: WindowPolicy = field(default_factory=WindowPolicy)
    estimator: LatticeConfig | ImplicitConfig = field(default_factory=LatticeConfig)
    imu: GyroConfig = field(default_factory=GyroConfig)

    @property
    def event_budget(self) -> EventBudget:
        """How many events of a window are used at all."""
        most = self.estimator.max_events
        if isinstance(self.estimator, LatticeConfig) and self.estimator.memory:
            most = max(most, self.estimator.tracked_events)
        return EventBudget(self.window, most)

    def flat(self) -> dict[str, Any]:
        """All values by dotted name, as written beside every result."""
        return {o.name: o.value for o in options_of(self)}


def load_config(
    profile: str = "realtime",
    overrides: Mapping[str, Any] | None = None,
    params_file: Path | None = None,
) -> Config:
    """Resolve a configuration: the profile, then the file, then the overrides.

    Args:
        profile: the name of a file in config/.
        overrides: values by dotted name, for example {"window.duration_ms": 50.0}.
        params_file: a YAML file of nested or dotted names.

    Raises:
        InputError: an unknown profile or name, or a value that its option refuses.
    """
    folder = _config_folder()
    path = folder / f"{profile}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in folder.glob("*.yaml")))
        raise InputError("profile", f"unknown profile '{profile}'", f"use one of {known}")
    values = dict(_read(path))
    if params_file is not None:
        values.update(_read(params_file))
    values.update(overrides or {})
    values = without_removed(values, lambda name, line: say(name, line))
    method = values.pop("method", Config.method)
    if not isinstance(method, str) or method not in _ESTIMATORS:
        raise InputError("method", f"unknown {method!r}", f"use {' or '.join(_ESTIMATORS)}")
    if values.pop("profile", profile) != profile:
        raise InputError(
            "profile", "cannot be changed by a file or an override", "choose it by its own option"
        )
    start = Config(profile=profile, method=method, estimator=_ESTIMATORS[method]())
    return replace_options(start, values)


def without_removed(values: Mapping[str, Any], warn: Callable[[str, str], None]) -> dict[str, Any]:
    """Leave out options of earlier versions, and warn of each: its name and what to do instead."""
    for name in _REMOVED.keys() & values.keys():
        warn(name, f"no longer an option, left out: {_REMOVED[name]}")
    return {name: value for name, value in values.items() if name not in _REMOVED}


def _config_folder() -> Path:
    """Find config/ beside the sources, or under share/ of the installation."""
    for parent in Path(__file__).resolve().parents:
        for folder in (parent / "config", parent / "share" / "emoflow_ros" / "config"):
            if (folder / "realtime.yaml").is_file():
                return folder
    raise InputError("config", "the profiles are missing", "install the package again")


def _read(path: Path) -> Iterator[tuple[str, Any]]:
    try:
        tree = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(path, f"cannot be read ({reason})", "give a YAML file") from error
    if not isinstance(tree, Mapping | None):
        raise InputError(path, "holds no mapping", "write name: value lines")
    yield from _flatten("", tree or {})


def _flatten(prefix: str, tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flatten(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", value


def require_cuda() -> None:
    """Refuse a machine without a CUDA device.

    Raises:
        InputError: there is none, or torch cannot use it.
    """
    import torch

    if not torch.cuda.is_available():
        raise InputError(
            "estimator.device", "no CUDA device was found", "use cpu, or check the driver"
        )


def require_torch(config: Config) -> None:
    """Refuse a configuration that needs PyTorch where that is not installed.

    Raises:
        InputError: it is missing; the line names what asks for it.
    """
    if find_spec("torch") is not None and find_spec("torchdiffeq") is not None:
        return
    if not isinstance(config.estimator, LatticeConfig):
        raise InputError(
            "method",
            f"{config.method} (profile {config.profile}) needs PyTorch",
            f"{_INSTALL_TORCH}, or use the method lattice (profile realtime)",
        )
    if config.estimator.device != "cpu":
        raise InputError("estimator.device", "CUDA needs PyTorch", f"{_INSTALL_TORCH}, or use cpu")
