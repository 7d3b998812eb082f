import dataclasses
from collections import Counter
from pathlib import Path

import pytest

from emoflow_ros.errors import InputError
from emoflow_ros.simulation.factors import Factors, draw_factors, factor_specs

DOCS = Path(__file__).parents[2] / "docs" / "simulation.md"
SPECS = factor_specs()
ASKED_FOR = {"photo", "rational_polynomial"}  # 0 %: drawn only where they are named


@pytest.fixture(scope="module")
def drawn() -> list[Factors]:
    return [draw_factors(seed) for seed in range(400)]


def test_seed_decides_and_another_seed_differs() -> None:
    assert draw_factors(7) == draw_factors(7)
    first, other = draw_factors(7).as_dict(), draw_factors(8).as_dict()
    assert sum(first[name] != other[name] for name in SPECS) > 15


@pytest.mark.parametrize("name", SPECS)
def test_fixing_one_factor_leaves_the_others(name: str) -> None:
    spec, free = SPECS[name], draw_factors(3).as_dict()
    text = spec.choices[-1] if spec.choices else f"{spec.high:g}"
    fixed = draw_factors(3, {name: text}).as_dict()
    assert str(fixed[name]) in (text, f"{float(spec.high)}")
    assert type(fixed[name]) is type(free[name])
    assert {k: v for k, v in fixed.items() if k != name} == {
        k: v for k, v in free.items() if k != name
    }


@pytest.mark.parametrize("name", SPECS)
def test_draws_are_plain_values_within_their_range(name: str, drawn) -> None:
    spec, values = SPECS[name], [factors.as_dict()[name] for factors in drawn]
    assert {type(value) for value in values} <= {str, int, float}
    if spec.choices:
        assert set(values) == set(spec.choices) - ASKED_FOR
    else:
        assert all(spec.low <= value <= spec.high for value in values)
        assert len(set(values)) > 3


def test_shares_are_those_of_real_recordings(drawn) -> None:
    sensors = Counter(factors.sensor for factors in drawn)
    assert 0.72 < (sensors["240x180"] + sensors["346x260"]) / 400 < 0.84
    assert 0.01 < sensors["1280x720"] / 400 < 0.09
    assert 0.63 < sum(factors.movers == 0 for factors in drawn) / 400 < 0.77
    assert 0.04 < sum(factors.flicker > 0 for factors in drawn) / 400 < 0.13
    assert 0.26 < sum(factors.calibration_error > 0 for factors in drawn) / 400 < 0.41
    motion = sorted(factors.image_motion for factors in drawn)
    assert 5 < motion[200] < 9
    assert motion[20] < 2.5
    assert motion[380] > 20


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("senor", "240x180", "unknown name 'senor'; did you mean 'sensor'"),
        ("xyz", "1", "unknown name 'xyz'; use one of scene, depth_ratio"),
        ("motion", "fly", "unknown value 'fly'; use one of hover, calm"),
        ("threshold", "0.5", "factor threshold: 0.5; give a number from 0.1 to 0.4"),
        ("movers", "1.5", "factor movers: '1.5'; give a whole number from 0 to 3"),
        ("noise_hz", "nan", "factor noise_hz: nan; give a number from 0.01 to 10"),
    ],
)
def test_values_that_are_not_allowed_are_named(name: str, value: str, line: str) -> None:
    with pytest.raises(InputError, match=line):
        draw_factors(0, {name: value})


def test_negative_seed_is_refused() -> None:
    with pytest.raises(InputError, match="seed: -1; give 0 or more"):
        draw_factors(-1)


def test_documentation_lists_every_factor_as_it_is_drawn() -> None:
    rows = [
        tuple(cell.strip().strip("`") for cell in line.split("|")[1:4])
        for line in DOCS.read_text(encoding="utf-8").splitlines()
        if line.startswith("| `") and line.count("|") == 5
    ]
    assert rows == [(name, spec.unit, spec.distribution) for name, spec in SPECS.items()]
    assert [field.name for field in dataclasses.fields(Factors)] == ["seed", *SPECS]
