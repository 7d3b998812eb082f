"""Typed configuration: defaults in the dataclasses, profiles in config/, overrides by name.

It refuses a configuration that needs PyTorch where that is not installed. Only the published method
does, so it is imported late.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml

from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import WindowPolicy
from emoflow_ros.core.types.options import option, options_of, replace_options
from emoflow_ros.errors import InputError, say
from emoflow_ros.published.implicit_config import ImplicitConfig

_ESTIMATORS: dict[str, type[LatticeConfig | ImplicitConfig]] = {
    "lattice": LatticeConfig,
    "implicit": ImplicitConfig,
}

# Options of earlier versions, and what takes their place.
_REMOVED = {
    "estimator.max_doubt": "nothing is withheld any more, the covariance says how sure a twist is; "
    "output.max_angular_sd and output.max_direction_sd hold back what is wider",
    "estimator.spline_roughness": "w and v change linearly over a window now; "
    "estimator.motion_stiffness weighs how much",
    "estimator.memory": "positions are always remembered, with estimator.model auto",
}

_INSTALL_TORCH = "install it (pip install torch torchdiffeq)"


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
        if isinstance(self.estimator, LatticeConfig) and self.estimator.remembers:
            most = max(most, self.estimator.tracked_events)
        return EventBudget(self.window, most)

    @property
    def device(self) -> str:
        """Where the estimator runs; only the published method has a choice."""
        return "cpu" if isinstance(self.estimator, LatticeConfig) else self.estimator.device

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


def require_torch(config: Config) -> None:
    """Refuse a configuration that needs PyTorch where that is not installed.

    Raises:
        InputError: it is missing; the line names what asks for it.
    """
    if isinstance(config.estimator, LatticeConfig):
        return
    if find_spec("torch") is None or find_spec("torchdiffeq") is None:
        raise InputError(
            "method",
            f"{config.method} (profile {config.profile}) needs PyTorch",
            f"{_INSTALL_TORCH}, or use the method lattice (profile realtime)",
        )
