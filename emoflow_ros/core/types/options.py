"""Options: dataclass fields that carry their unit, range and meaning.

One declaration serves the command line, the YAML profiles, the node's parameters and their
documentation.
"""

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from emoflow_ros.errors import InputError

# Options that only another method has, by name: what is wrong, and what to do.
_OF_OTHERS = {
    "estimator.device": (
        "only the profiles paper* have a device, this one runs on the processor",
        "leave it out",
    ),
}
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?e[-+]?\d+", re.IGNORECASE)


def option(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare a dataclass field with the facts that its users need."""
    return dataclasses.field(
        default=default,
        metadata={
            "description": description,
            "unit": unit,
            "minimum": minimum,
            "maximum": maximum,
            "choices": choices,
        },
    )


@dataclass(frozen=True, slots=True)
class OptionInfo:
    """One option of a configuration tree, under its dotted name."""

    name: str
    value: Any
    description: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]


def options_of(tree: Any, prefix: str = "") -> Iterator[OptionInfo]:
    """List the options of a dataclass instance and of those nested in it."""
    for f in dataclasses.fields(tree):
        value = getattr(tree, f.name)
        if dataclasses.is_dataclass(value):
            yield from options_of(value, f"{prefix}{f.name}.")
        else:
            yield OptionInfo(f"{prefix}{f.name}", value, **f.metadata)


def replace_options[T](tree: T, values: Mapping[str, Any], prefix: str = "") -> T:
    """Return a copy of a configuration tree with the options of these dotted names changed.

    Raises:
        InputError: a name is unknown, or a value has the wrong type or range.
    """
    fields = {f.name: f for f in dataclasses.fields(tree)}  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        head, _, rest = name.partition(".")
        if head not in fields or dataclasses.is_dataclass(getattr(tree, head)) != bool(rest):
            raise unknown_option(prefix + name, (o.name for o in options_of(tree, prefix)))
        if rest:
            nested.setdefault(head, {})[rest] = value
        else:
            meta = fields[head].metadata
            changes[head] = _checked(prefix + name, value, getattr(tree, head), meta)
    for head, inner in nested.items():
        changes[head] = replace_options(getattr(tree, head), inner, f"{prefix}{head}.")
    return dataclasses.replace(tree, **changes)  # type: ignore[type-var]


def coerced(value: Any, default: Any, choices: tuple[str, ...]) -> Any:
    """Return a value in the type of the option's default, if only YAML made it another one.

    YAML reads `1` as an integer, `off` as false, `1e-5` as a text, and a name of digits as a
    number. A value that is of another type all the same is returned as it is.
    """
    match default, value:
        case str(), bool():
            word = "on" if value else "off"
            return word if word in choices else value
        case str(), int() | float() if not choices:
            return str(value)
        case float(), int() if not isinstance(value, bool):
            return float(value)
        case float(), str() if _EXPONENT.fullmatch(value):
            return float(value)
    return value


def unknown_option(name: str, known: Iterable[str]) -> InputError:
    """Refuse a name: with the nearest of the known ones, and those of its group or all."""
    if name in _OF_OTHERS:
        return InputError(name, *_OF_OTHERS[name])
    names = list(known)
    nearest = get_close_matches(name, names, n=1)
    group = f"{name.rpartition('.')[0]}."
    listed = [n for n in names if n.startswith(group)] or names
    wrong = f"no such option, the nearest is {nearest[0]}" if nearest else "no such option"
    return InputError(name, wrong, f"known here: {', '.join(listed)}")


def _checked(name: str, value: Any, default: Any, meta: Mapping[str, Any]) -> Any:
    kind = type(default)
    value = coerced(value, default, meta["choices"])
    if type(value) is not kind:
        raise InputError(name, f"{value!r} is not of type {kind.__name__}", "correct the value")
    if meta["choices"] and value not in meta["choices"]:
        raise InputError(
            name, f"unknown value '{value}'", f"use one of {', '.join(meta['choices'])}"
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        low = -math.inf if meta["minimum"] is None else meta["minimum"]
        high = math.inf if meta["maximum"] is None else meta["maximum"]
        if not low <= value <= high:  # NaN fails, too
            raise InputError(name, f"{value} is out of range", f"use {low:g} to {high:g}")
    return value
