"""NumPy files and HDF5 tables of events, as tools write them, and their unit of time."""

from zipfile import ZipFile

import h5py
import numpy as np
import pytest
from column_files import ARRAY_WRITERS, steady_events, write_hdf5, write_npy
from event_bags import assert_equal

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.truth.mvsec_truth import MvsecFlowMaps, SmoothedOdometry

N = 3000


@pytest.fixture
def events() -> Events:
    """3000 events at 330 000 per second from 2 s on, times in whole microseconds."""
    return steady_events(N)


def read_all(path, **options):
    with open_recording(path, columns=ColumnOptions(**options)) as recording:
        return Events.concatenate(list(recording.event_chunks()))


def refusal(path, **options) -> str:
    with pytest.raises(InputError) as error:
        read_all(path, **options)
    line = str(error.value)
    assert "\n" not in line
    return line


ALL = list(ARRAY_WRITERS.values())


@pytest.mark.parametrize("write", ALL)
@pytest.mark.parametrize(
    ("ns", "dtype", "said"),
    [
        (10**9, float, ""),
        (10**6, float, "milliseconds"),
        (10**3, float, ""),
        (10**3, np.int64, ""),
        (1, np.int64, "nanoseconds"),
    ],
)
def test_units_of_time(tmp_path, events, write, ns, dtype, said, capsys):
    path = write(tmp_path, events, (events.t / ns).astype(dtype))
    assert_equal(read_all(path), events)
    told = capsys.readouterr().err
    assert (f"t is taken as {said}, 330000 events per second" in told) == bool(said)


@pytest.mark.parametrize("write", ALL)
def test_whole_milliseconds(tmp_path, events, write, capsys):
    """330 events share each of them: 330 million a second, were they microseconds."""
    t = 2000 + np.arange(N) // 330
    assert read_all(write(tmp_path, events, t)).t.tolist() == (t * 10**6).tolist()
    assert "t is taken as milliseconds, 330000 events per second" in capsys.readouterr().err


@pytest.mark.parametrize("write", ALL)
def test_the_users_unit_counts(tmp_path, events, write):
    path = write(tmp_path, events, events.t // 1000)
    assert read_all(path, time_unit="ms").t.tolist() == (events.t * 1000).tolist()


@pytest.mark.parametrize("write", ALL)
def test_decimals_that_may_be_seconds_or_milliseconds_are_refused(tmp_path, events, write):
    t = 0.25 + np.arange(N) / 3000.0
    path = write(tmp_path, events, t)
    line = refusal(path)
    assert line == (
        f"{path}: the unit of t cannot be told: 3000 events are 3000 events per second in seconds, "
        "3 million events per second in milliseconds; say which unit t has with --time-unit s, ms, "
        "us or ns"
    )
    assert read_all(path, time_unit="s").t[-1] == pytest.approx(t[-1] * 1e9, abs=1)


def test_columns_of_one_row_each(tmp_path, events):
    columns = {"x": events.x, "y": events.y, "t": events.t // 1000, "p": events.p}
    columns = {name: column.reshape(-1, 1) for name, column in columns.items()}
    np.savez(tmp_path / "a.npz", **columns)
    assert_equal(read_all(tmp_path / "a.npz"), events)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, column in columns.items():
            file[name] = column
    assert_equal(read_all(tmp_path / "a.h5"), events)


def test_other_names_in_an_archive(tmp_path, events):
    t = events.t // 1000
    names = {"xs": events.x, "ys": events.y, "timestamps": t, "polarity": events.p}
    np.savez(tmp_path / "a.npz", **names)
    assert_equal(read_all(tmp_path / "a.npz"), events)


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_table_of_any_order(tmp_path, events, transposed, name, capsys):
    table = np.stack([events.x, events.y, events.p, events.t // 1000], axis=1)
    save = np.save if name == "a.npy" else np.savez
    save(tmp_path / name, table.T if transposed else table)
    assert_equal(read_all(tmp_path / name), events)
    assert capsys.readouterr().err == (
        f"{tmp_path / name}: columns are taken as x y p t, t is taken as microseconds, 330000 "
        "events per second; --layout and --time-unit say otherwise\n"
    )
    swapped = read_all(tmp_path / name, layout="yxpt")
    np.testing.assert_array_equal(swapped.x, events.y)


def test_mvsec_and_dsec_of_other_units_are_told(tmp_path, events, capsys):
    with h5py.File(tmp_path / "a_data.hdf5", "w") as file:
        table = [events.x, events.y, events.t / 1e3, np.where(events.p, 1, -1)]
        file["davis/left/events"] = np.stack(table, axis=1)
    assert_equal(read_all(tmp_path / "a_data.hdf5"), events)
    assert "t is taken as microseconds" in capsys.readouterr().err
    folder = tmp_path / "dsec"
    folder.mkdir()
    (folder / "rectify_map.h5").touch()
    path = write_hdf5(folder, events, events.t + 1)
    path = path.rename(folder / "events.h5")
    read = read_all(path)
    assert read.t.tolist() == (events.t + 1).tolist()
    assert "t is taken as nanoseconds" in capsys.readouterr().err
    line = "--layout: the format of {} says it; leave the option out"
    assert refusal(path, layout="xytp") == line.format(path)


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("a.npy", np.zeros((5, 3)), "an array of shape (5, 3) and type float64; save an array"),
        ("a.npy", np.zeros((5, 4), complex), "an array of shape (5, 4) and type complex128"),
        ("a.npy", np.zeros(5, [("a", "f8"), ("b", "f8")]), "an array with the fields a, b; save"),
        ("a.npy", np.array([{}], object), "holds Python objects"),
        ("a.npy", np.zeros((0, 4)), "holds no events"),
        ("a.npy", np.full((9, 4), 3.5), "its columns (3.5 to 3.5, "),
        ("a.npz", np.zeros((5, 3)), "an array of shape (5, 3)"),
    ],
)
def test_other_arrays_are_refused_with_what_was_found(tmp_path, name, array, words):
    path = tmp_path / name
    (np.save if name == "a.npy" else np.savez)(path, array)
    line = refusal(path)
    assert line.startswith(f"{path}: ")
    assert words in line


def test_damaged_npy(tmp_path, events):
    path = write_npy(tmp_path, events, events.t // 1000)
    path.write_bytes(path.read_bytes()[:5000])
    assert refusal(path) == f"{path}: damaged NumPy array; copy it again"
    path.write_bytes(b"123")
    assert refusal(path) == f"{path}: damaged NumPy array; copy it again"


HEADER = "{'descr': '<f8', 'fortran_order': False, 'shape': (9, 4), }"
HEADERS = [
    HEADER + "\n \x93 \0",  # SystemError
    HEADER.replace("9", 30 * "9"),  # OverflowError
    HEADER.replace("9", 15 * "9"),  # MemoryError
    HEADER.replace("}", ""),  # TokenError
    HEADER.replace("'<f8'", "',f8'"),  # SyntaxError
    HEADER.replace("'shape'", "{}"),  # TypeError
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("header", HEADERS)
def test_damaged_headers_of_arrays_are_one_line(tmp_path, header):
    text = header.ljust(117).encode("latin-1") + b"\n"
    array = b"\x93NUMPY\1\0" + len(text).to_bytes(2, "little") + text + bytes(9 * 4 * 8)
    npy = tmp_path / "a.npy"
    npy.write_bytes(array)
    assert refusal(npy) == f"{npy}: damaged NumPy array; copy it again"
    npz = tmp_path / "a.npz"
    with ZipFile(npz, "w") as archive:
        archive.writestr("timestamps.npy", array)
    part = "(timestamps cannot be read)"
    assert refusal(npz) == f"{npz}: damaged NumPy archive {part}; copy it again"
    for truth in (MvsecFlowMaps, SmoothedOdometry):
        with pytest.raises(InputError, match=rf"^{npz}: not an? (flow|odom)"):
            truth(npz)


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("a.dat", b"% Data file\n", "a Prophesee .dat file, which is not read; convert it with"),
        ("a.aedat", b"#!AER-DAT3.1\n", "an AEDAT 1 to 3 file, which is not read; convert it"),
        ("a.xyz", b"1", "not a recording of a known format: a '.xyz' file; give a bag"),
        (
            "chain.yaml",
            b"cam0: 1",
            "a YAML file, no recording; give a calibration with --calib FILE",
        ),
        ("a.xyz", b"", "an empty file; record or copy it again"),
    ],
)
def test_what_was_found_is_named(tmp_path, name, content, line):
    (tmp_path / name).write_bytes(content)
    assert refusal(tmp_path / name).startswith(f"{tmp_path / name}: {line}")


def test_folders_and_hdf5_files_are_named_by_what_they_hold(tmp_path):
    folder = tmp_path / "f"
    folder.mkdir()
    assert "a folder with nothing in it" in refusal(folder)
    for k in range(8):
        (folder / f"{k}.png").touch()
    assert "a folder with 0.png, 1.png, 2.png, 3.png, 4.png, 5.png and 2 more; give" in refusal(
        folder
    )
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frames"] = np.zeros((2, 3, 4))
    assert refusal(tmp_path / "a.h5") == (
        f"{tmp_path / 'a.h5'}: an HDF5 file without columns of events; it holds frames (2, 3, 4); "
        "give data sets x, y, t and p of equal length in one group, or a table (N, 4)"
    )
