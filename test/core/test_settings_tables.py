"""The numbers that tune gyro, lattice, stream and latest twist are in a table for each."""

import ast
import re
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest

import emoflow_ros.core
from emoflow_ros.core.gyro.settings import GYRO, GyroSettings
from emoflow_ros.core.lattice.settings import LATTICE, LatticeSettings
from emoflow_ros.core.products.settings import PRESENT, STREAM, PresentSettings, StreamSettings

FOLDER = Path(emoflow_ros.core.__file__).parent
NO_NUMBERS = {"Array", "F32", "F64", "_compiled", "_compiler", "_inlined"}
OF_FORM = {
    "gyro/gyro": {"_NS_PER_S"},
    "gyro/checks": {"UNLIKELY_6", "UNLIKELY_3", "_DEG", "AXES"},
    "gyro/clock": {"_REACH_NS", "Times"},
    "gyro/measurement": set(),
    "lattice/blending": {"_LEAST"},
    "lattice/known": {"INFORMATION_EXCESS", "_MEAN", "_SLOPE"},
    "lattice/confinement": {"_FEWEST_NODES"},
    "lattice/constraints": {"_STRUCTURE_INLIER_PX"},
    "lattice/egomotion": {"_UNKNOWN", "MOTION_UNKNOWNS", "OF_W", "OF_V"},
    "lattice/flow_starts": set(),
    "lattice/memory": {"_EXTRAPOLATIONS"},
    "lattice/preparation": {"_BLOCK"},
    "lattice/refinement": {"_TIMES", "_LEAST"},
    "lattice/rotations": {"_LEAST_FLOW_PX"},
    "lattice/estimator": set(),
    "lattice/selection": set(),
    "lattice/uncertainty": set(),
    "products/continuous": {"BRIGHTNESS"},
    "products/gauge": {"_LEVER"},
    "products/motion_prior": set(),
    "products/present_motion": set(),
    "products/present_scene": set(),
    "products/wide": set(),
}


@pytest.mark.parametrize("module", OF_FORM)
def test_modules_hold_no_tuning_numbers_of_their_own(module):
    named: set[str] = set()
    for node in ast.parse((FOLDER / f"{module}.py").read_text()).body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            named |= {name.id for name in ast.walk(target) if isinstance(name, ast.Name)}
    assert named - NO_NUMBERS == OF_FORM[module]


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        (GYRO, GyroSettings),
        (LATTICE, LatticeSettings),
        (STREAM, StreamSettings),
        (PRESENT, PresentSettings),
    ],
)
def test_a_table_is_frozen_and_tells_of_each_number(table, kind):
    for field in fields(kind):
        assert re.search(rf"^ +(\w+, )*{field.name}[,:]", kind.__doc__, re.MULTILINE)
        with pytest.raises(FrozenInstanceError):
            setattr(table, field.name, 0)
