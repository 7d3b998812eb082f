"""A short run of `make fuzz`: every target decodes its inputs, and a wrong index is found."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from checked_arrays import checked_njit
from encoders import ENCODERS

from msg_adapters import supported_types

SCRIPT = Path(__file__).parent / "fuzz_decoders.py"
INPUTS = 400


def test_every_target_survives_a_short_run():
    pytest.importorskip("atheris")
    command = [sys.executable, SCRIPT, "--runs", str(INPUTS), "--seed", "1"]
    ran = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    assert ran.returncode == 0, ran.stdout[-3000:]
    targets = re.findall(r"^== (\S+): (\d+) inputs$", ran.stdout, re.MULTILINE)
    done = re.findall(r"^Done (\d+) in ", ran.stdout, re.MULTILINE)
    assert [int(count) for count in done] == [INPUTS] * len(targets)
    messages = {f"{t}:{s}" for t in supported_types() for s in ("cdr", "ros1")}
    packets = {f"event_camera_msgs/msg/EventPacket:{encoding}" for encoding in ENCODERS}
    assert {target for target, _ in targets} > messages | packets


@pytest.mark.parametrize("index", [-1, 3, np.int64(-1)])
def test_kernels_under_the_fuzzer_cannot_index_out_of_bounds(index):
    @checked_njit("a signature", nogil=True)
    def write(values, at):
        values[at] = 7
        return values[at]

    values = np.zeros(3)
    assert write(values, 2) == 7
    assert values.tolist() == [0, 0, 7]
    with pytest.raises(IndexError, match=f"index {index} of 3"):
        write(values, index)
