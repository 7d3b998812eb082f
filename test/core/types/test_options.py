from dataclasses import dataclass, field

import pytest

from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.types.options import option, options_of, replace_options
from emoflow_ros.errors import InputError


@dataclass(frozen=True)
class Inner:
    weight: float = option(1.5, "a weight", unit="kg", minimum=0.0, maximum=10.0)
    count: int = option(3, "a number", minimum=1)
    mode: str = option("slow", "how", choices=("slow", "fast"))
    verbose: bool = option(False, "say more")

    def __post_init__(self) -> None:
        if self.mode == "fast" and self.count > 5:
            raise InputError("inner.count", "too many for fast", "use 5")


@dataclass(frozen=True)
class Outer:
    name: str = option("x", "a name")
    inner: Inner = field(default_factory=Inner)


def test_options_are_listed_under_dotted_names_with_their_facts():
    options = {o.name: o for o in options_of(Outer(inner=Inner(weight=2.0)))}
    assert list(options) == ["name", "inner.weight", "inner.count", "inner.mode", "inner.verbose"]
    weight = options["inner.weight"]
    assert (weight.value, weight.unit, weight.description) == (2.0, "kg", "a weight")
    assert (weight.minimum, weight.maximum, weight.choices) == (0.0, 10.0, ())
    assert options["inner.count"].maximum is None
    assert options["inner.mode"].choices == ("slow", "fast")


def test_replacing_changes_a_copy():
    before = Outer()
    after = replace_options(before, {"name": "y", "inner.count": 4, "inner.mode": "fast"})
    assert after == Outer("y", Inner(count=4, mode="fast"))
    assert before == Outer()
    assert replace_options(before, {}) == before


def test_whole_numbers_serve_as_floats():
    weight = replace_options(Outer(), {"inner.weight": 2}).inner.weight
    assert (weight, type(weight)) == (2.0, float)


@pytest.mark.parametrize("value", [0.0, 10.0])
def test_ranges_include_their_ends(value):
    assert replace_options(Outer(), {"inner.weight": value}).inner.weight == value


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("inner.weight", 10.1, r"inner\.weight: 10\.1 is out of range; use 0 to 10"),
        ("inner.weight", -1, r"inner\.weight: -1\.0 is out of range"),
        ("inner.weight", float("nan"), "nan is out of range"),
        ("inner.count", 0, "0 is out of range; use 1 to inf"),
        ("inner.count", 2.0, r"2\.0 is not of type int"),
        ("inner.count", True, "True is not of type int"),
        ("inner.count", None, "None is not of type int"),
        ("inner.weight", "1", "'1' is not of type float"),
        ("inner.weight", "1e", "'1e' is not of type float"),
        ("inner.weight", "1e9", "is out of range; use 0 to 10"),
        ("inner.weight", True, "True is not of type float"),
        ("inner.verbose", 1, "1 is not of type bool"),
        ("inner.mode", 3, "3 is not of type str"),
        ("inner.mode", "medium", "unknown value 'medium'; use one of slow, fast"),
        (
            "inner.wait",
            1,
            r"^inner\.wait: no such option, the nearest is inner\.weight; "
            r"known here: inner\.weight, inner\.count, inner\.mode, inner\.verbose$",
        ),
        ("inner", 1, "inner: no such option, .*; known here: name, inner.weight"),
        ("name.first", "a", "name.first: no such option"),
        ("inner.", 1, "no such option"),
        ("", 1, "no such option"),
    ],
)
def test_what_is_refused(name, value, message):
    with pytest.raises(InputError, match=message):
        replace_options(Outer(), {name: value})


def test_values_are_checked_together():
    """Options that only fit together may be given in any order."""
    together = {"inner.count": 9, "inner.mode": "slow"}
    start = Outer(inner=Inner(count=5, mode="fast"))
    assert replace_options(start, together).inner == Inner(count=9, mode="slow")
    with pytest.raises(InputError, match="too many for fast"):
        replace_options(Outer(), {"inner.mode": "fast", "inner.count": 6})


def test_off_which_yaml_reads_as_false_is_a_choice() -> None:
    assert replace_options(GyroConfig(use="auto"), {"use": False}).use == "off"
    with pytest.raises(InputError, match="use: True is not of type str"):
        replace_options(GyroConfig(), {"use": True})
