"""The numbers that tune the use of a gyro are in one table."""

import ast
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest

from emoflow_ros.core import gyro_settings
from emoflow_ros.core.gyro_settings import GYRO, GyroSettings

OF_FORM = {"_NS_PER_S", "_DEG", "(UNLIKELY_6, UNLIKELY_3)", "AXES", "Array", "Times", "_REACH_NS"}
FOLDER = Path(gyro_settings.__file__).parent


@pytest.mark.parametrize("module", ["gyro", "gyro_checks", "gyro_clock", "gyro_measurement"])
def test_modules_hold_no_tuning_numbers_of_their_own(module):
    tree = ast.parse((FOLDER / f"{module}.py").read_text())
    named = set()
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            named.add(ast.unparse(target))
    assert named - OF_FORM == set()


def test_the_table_is_frozen_and_tells_of_each_number():
    with pytest.raises(FrozenInstanceError):
        GYRO.reach_ns = 0
    assert all(field.name in GyroSettings.__doc__ for field in fields(GyroSettings))
