"""A short run of `make fuzz` over the readers: damaged files end in one line, or are read."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.event_columns import times_ns

SCRIPT = Path(__file__).parent / "fuzz_readers.py"
FILES = 20


def test_damaged_files_of_every_format_end_in_one_line() -> None:
    command = [sys.executable, SCRIPT, "--runs", str(FILES), "--seed", "1"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-3000:]
    found = re.findall(r"^== (\S+): (\d+) files, (\d+) refused$", ran.stdout, re.MULTILINE)
    names = {name for name, _, _ in found}
    assert names >= {"ros1", "sqlite3", "mcap", "raw", "npz", "dsec", "mvsec", "hdf5", "ecd"}
    assert names >= {"calib_txt", "calib_yaml", "motion_txt", "imu_txt", "groundtruth_txt"}
    assert names >= {"npy", "fields", "table", "compound", "calib_kalibr", "calib_opencv"}
    assert {count for _, count, _ in found} == {str(FILES)}
    assert sum(int(refused) for _, _, refused in found) > len(found) * FILES / 4


def test_byte_above_127_in_ecd_events_is_one_line(tmp_path: Path) -> None:
    lines = [b"0.1 1 2 1\n", b"0.2 1 2 1\n", b"0.3 1 \xb2 1\n", b"0.4 1 2 1\n"]
    (tmp_path / "events.txt").write_bytes(b"".join(lines))
    with pytest.raises(InputError) as caught:
        open_recording(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / 'events.txt'}: not a text file; a line is")


@pytest.mark.parametrize("time", [float("nan"), float("inf"), 1e300, -1e11])
def test_times_that_no_clock_shows_are_refused(time: float) -> None:
    assert times_ns(Path("a"), np.array([1.5])).tolist() == [1_500_000_000]
    with pytest.raises(InputError, match=r"^a: event times that are not finite"):
        times_ns(Path("a"), np.array([1.5, time]))


def test_recordings_with_one_change_give_the_right_events() -> None:
    command = [sys.executable, SCRIPT.with_name("fuzz_variants.py"), "--runs", str(FILES)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-3000:]
    found = re.findall(r"^== (\S+): (\d+) recordings$", ran.stdout, re.MULTILINE)
    kinds = [
        "mcap_index",
        "mcap_profile",
        "early_events",
        "lost_words",
        "active_bag",
        "moved_files",
    ]
    assert found == [(kind, str(FILES)) for kind in kinds]
