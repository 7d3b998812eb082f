"""The executable on each kind of input: files without a known length, without events, damaged."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from known import Known

from emoflow_ros.commands import evaluate as evaluate_command
from emoflow_ros.commands import info
from emoflow_ros.core.types.events import WindowPolicy, WindowSlicer
from emoflow_ros.evaluation.window_run import evaluate as evaluate_all
from emoflow_ros.readers import READERS, open_recording
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.truth import Truth

CALIBRATION = "200 200 119.5 89.5 0 0 0 0 0"
RAW_HEADER = b"% evt 2.0\n% geometry 240x180\n% end\n"


@pytest.fixture
def calib(tmp_path):
    path = tmp_path / "calib.txt"
    path.write_text(CALIBRATION)
    return path


@pytest.fixture
def call(monkeypatch, capsys):
    """Run an executable's main: exit code, standard output and the error lines."""

    def run(tool, *arguments):
        monkeypatch.setattr("sys.argv", ["it", *map(str, arguments)])
        code = tool.main()
        out, err = capsys.readouterr()
        return code, out, [line for line in err.splitlines() if line.startswith("error: ")]

    return run


def write_raw(path, microseconds):
    """EVT 2.0: one event at each time, on a diagonal."""
    words = []
    for k, us in enumerate(microseconds):
        words += [8 << 28 | us >> 6, (us & 63) << 22 | (k % 240) << 11 | k % 180]
    path.write_bytes(RAW_HEADER + np.array(words, "<u4").tobytes())
    return path


def write_npz(path, count, **others):
    k = np.arange(count)
    np.savez(path, x=k % 240, y=k % 180, t=k * 1e-4, p=k % 2, **others)
    return path


@pytest.mark.usefixtures("without_page")
def test_raw_file_whose_length_only_reading_tells(call, tmp_path, calib):
    path = write_raw(tmp_path / "a.raw", range(0, 100_000, 100))
    arguments = ("--calib", calib, "--window-ms", 20, "--out", tmp_path / "out")
    code, out, errors = call(evaluate_command, path, *arguments)
    assert (code, errors) == (1, [])
    assert "0 of 4 windows estimated" in out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [w["status"] for w in report["windows"]] == ["bounded"] * 4


@pytest.mark.parametrize(
    ("duration", "words"),
    [(None, "a.npz: 0.9 s ["), (0.0, "0.9/0.0 s ["), (0.2, "0.9/? s ["), (0.9, "0.9/0.9 s [")],
)
def test_bar_of_an_unknown_or_wrong_length(tmp_path, calib, capsys, duration, words):
    """What a recording says of its length is for progress alone."""
    with open_recording(write_npz(tmp_path / "a.npz", 10_000), calibration=calib) as recording:
        recording.duration = duration
        slicer = WindowSlicer(WindowPolicy(duration_ms=100.0))
        run = evaluate_all(recording, Known(recording.camera), slicer, Truth(), progress_bar=True)
    assert len(run.windows) == 9
    bar = capsys.readouterr().err.rpartition("\r")[2]
    assert words in bar
    assert "9 windows" in bar


@pytest.mark.parametrize("name", ["empty.npz", "empty.raw"])
def test_file_without_events(call, tmp_path, calib, name):
    path = tmp_path / name
    write_npz(path, 0) if path.suffix == ".npz" else write_raw(path, [])
    code, out, errors = call(evaluate_command, path, "--calib", calib, "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert errors == [f"error: {path}: holds no events; give a recording that has some"]


@pytest.mark.usefixtures("without_page")
def test_aedat4_file(call, tmp_path, calib):
    """200 events in 2 ms, written by dv-processing; of a DAVIS346."""
    pytest.importorskip("aedat", reason="the optional package aedat is not installed")
    path = Path(__file__).parents[1] / "recordings" / "events.aedat4"
    wide = tmp_path / "wide.yaml"
    wide.write_text(
        "image_width: 346\nimage_height: 260\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [200, 0, 173, 0, 200, 130, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    options = ("--window-ms", 1, "--out", tmp_path / "out")
    code, out, errors = call(evaluate_command, path, "--calib", wide, *options)
    assert (code, errors) == (1, [])
    assert "0 of 1 windows estimated" in out


@pytest.mark.parametrize("tool", [evaluate_command, info])
def test_help_lists_every_input(tool, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["it", "--help"])
    with pytest.raises(SystemExit):
        tool.main()
    text = " ".join(capsys.readouterr().out.split())
    for reader in READERS:
        assert reader.FORMAT in text
    for words in (".bag", ".mcap", ".db3", "events.txt", ".raw", ".aedat4", "*_data.hdf5",
                  "DSEC", "events.h5", ".npz"):  # fmt: skip
        assert words in text


@pytest.fixture
def ecd(tmp_path):
    """One event every 0.1 ms for 0.1 s."""
    folder = tmp_path / "shapes"
    folder.mkdir()
    (folder / "calib.txt").write_text(CALIBRATION)
    (folder / "motion.txt").write_text("0.1 0.2 0.3")
    lines = (f"{1 + k / 10_000:.4f} {k % 240} {k % 180} {k % 2}" for k in range(1000))
    (folder / "events.txt").write_text("\n".join(lines) + "\n")
    return folder


def test_events_txt_is_its_folder_to_info(call, ecd):
    told = [json.loads(call(info, path, "--json")[1]) for path in (ecd, ecd / "events.txt")]
    assert [t.pop("input") for t in told] == [str(ecd), str(ecd / "events.txt")]
    assert told[0] == told[1]
    (topic,) = told[0]["topics"]
    assert (topic["name"], topic["type"]) == ("events.txt", "ecd/events.txt")
    assert (topic["width"], topic["height"], topic["events"]) == (240, 180, 1000)
    assert told[0]["missing"] == []


@pytest.mark.usefixtures("without_page")
def test_events_txt_is_its_folder_to_evaluate(call, ecd, tmp_path):
    """Its calibration and its truth are found, too."""
    arguments = ("--window-ms", 50, "--out", tmp_path / "out")
    code, out, errors = call(evaluate_command, ecd / "events.txt", *arguments)
    assert (code, errors) == (1, [])
    assert "0 of 1 windows estimated" in out
    assert "motion.txt" in str(json.loads((tmp_path / "out" / "report.json").read_text())["truth"])


def test_other_text_files_are_no_recordings(call, ecd):
    code, _, errors = call(info, ecd / "motion.txt")
    assert code == 2
    assert errors[0].endswith(
        "motion.txt: lines of 3 numbers; a line is 't x y p'; name other columns with --layout"
    )


def test_streams_of_files_have_names_and_short_types(call, tmp_path):
    for path, expected in (
        (write_npz(tmp_path / "a.npz", 10), ("a.npz", "npz")),
        (write_raw(tmp_path / "b.raw", [5, 6]), ("b.raw", "prophesee/raw")),
    ):
        code, out, _ = call(info, path, "--json")
        (topic,) = json.loads(out)["topics"]
        assert (code, topic["name"], topic["type"]) == (0, *expected)
    types = [reader.TYPE for reader in READERS if reader is not BagRecording]
    assert len(set(types)) == len(types)
    assert all(len(name.split()) == 1 for name in types)


def damage(path, kind):
    """Make an archive that cannot be used, each in another way."""
    k = np.arange(2000)
    good = {"x": k % 9, "y": k % 7, "t": k, "p": k % 2}
    if kind == "garbage":
        path.write_bytes(b"no archive at all" * 100)
    elif kind == "cut":
        np.savez_compressed(path, **good)
        path.write_bytes(path.read_bytes()[:-200])
    elif kind == "bits":
        np.savez_compressed(path, **good)
        data = bytearray(path.read_bytes())
        data[60:400] = bytes(340)
        path.write_bytes(data)
    elif kind == "member":
        np.savez(path, **good)
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data[:8] + b"?" * 200 if name == "y.npy" else data)
    elif kind == "array":
        with path.open("wb") as file:
            np.save(file, k)
    elif kind == "text":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("x", "no array")
    elif kind == "size":
        np.savez(path, **good, width=[346, 346])
    else:
        np.savez(path, **good | {"x": np.array([None] * 2000, dtype=object)})


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("garbage", "not a NumPy archive"),
        ("cut", "not a NumPy archive"),
        ("array", "not a NumPy archive"),
        ("bits", "damaged NumPy archive"),
        ("member", "damaged NumPy archive"),
        ("text", "no array"),
        ("size", "width and height"),
        ("objects", "x holds Python objects"),
    ],
)
def test_npz_that_is_damaged(call, tmp_path, kind, words):
    path = tmp_path / "a.npz"
    damage(path, kind)
    code, out, errors = call(info, path)
    assert (code, out, len(errors)) == (2, "", 1)
    assert errors[0].startswith(f"error: {path}: ")
    assert words in errors[0]
    assert "pickle" not in errors[0]
    assert ";" in errors[0]  # what to do
