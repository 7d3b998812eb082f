"""Bags whose files were compressed, unpacked, renamed, or left without metadata.yaml."""

import sqlite3
from pathlib import Path

import pytest
from backports import zstd
from event_bags import assert_equal, make_events, write_event_bag

from emoflow_ros.commands.info import inspect
from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording

BATCHES = [make_events(50, start_s=1 + i) for i in range(6)]
SUFFIX = {"sqlite3": ".db3", "mcap": ".mcap"}


@pytest.fixture(params=["sqlite3", "mcap"])
def folder(request, tmp_path) -> Path:
    return write_event_bag(tmp_path / "a", BATCHES, storage=request.param)


def storage_of(folder: Path) -> Path:
    return next(f for f in folder.iterdir() if f.suffix != ".yaml")


def read(path: Path) -> Events:
    with open_recording(path) as recording:
        assert recording.camera is not None
        return Events.concatenate(list(recording.event_chunks()))


def pack(file: Path, suffix: str = ".zstd") -> Path:
    """As `ros2 bag record --compression-mode file --compression-format zstd` leaves it."""
    packed = file.with_name(file.name + suffix)
    packed.write_bytes(zstd.compress(file.read_bytes()))
    file.unlink()
    return packed


def compress_messages(folder: Path) -> None:
    """As `--compression-mode message` does."""
    with sqlite3.connect(storage_of(folder)) as database:
        rows = database.execute("SELECT id, data FROM messages").fetchall()
        database.executemany(
            "UPDATE messages SET data=? WHERE id=?", [(zstd.compress(d), i) for i, d in rows]
        )
    database.close()


def edit_metadata(folder: Path, old: str, new: str) -> None:
    path = folder / "metadata.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("form", ["folder", "file"])
@pytest.mark.parametrize("metadata", ["whole", "none", "empty"])
def test_compressed_files(folder, metadata, form, capsys):
    file = pack(storage_of(folder))
    if metadata == "whole":
        edit_metadata(folder, f"- {file.stem}\n", f"- {file.name}\n")
        edit_metadata(folder, "compression_mode: ''", "compression_mode: FILE")
        edit_metadata(folder, "compression_format: ''", "compression_format: zstd")
    elif metadata == "none":
        (folder / "metadata.yaml").unlink()
    else:
        (folder / "metadata.yaml").write_text("")
    assert_equal(read(folder if form == "folder" else file), Events.concatenate(BATCHES))
    assert capsys.readouterr().err == ""
    assert {f.name for f in folder.iterdir()} == {file.name, "metadata.yaml"} - (
        {"metadata.yaml"} if metadata == "none" else set()
    )


@pytest.mark.parametrize("form", ["folder", "file"])
@pytest.mark.parametrize("metadata", ["whole", "wrong", "none"])
def test_compressed_messages(tmp_path, metadata, form, capsys):
    """What metadata.yaml says about it, right or wrong, does not matter."""
    folder = write_event_bag(tmp_path / "a", BATCHES, storage="sqlite3")
    compress_messages(folder)
    if metadata == "whole":
        edit_metadata(folder, "compression_mode: ''", "compression_mode: MESSAGE")
        edit_metadata(folder, "compression_format: ''", "compression_format: zstd")
    elif metadata == "none":
        (folder / "metadata.yaml").unlink()
    path = folder if form == "folder" else storage_of(folder)
    assert_equal(read(path), Events.concatenate(BATCHES))
    assert capsys.readouterr().err == f"{path}: its messages are compressed one by one (zstd)\n"


def test_damaged_compressed_message_is_one_line(tmp_path):
    folder = write_event_bag(tmp_path / "a", BATCHES, storage="sqlite3")
    compress_messages(folder)
    with sqlite3.connect(storage_of(folder)) as database:
        database.execute("UPDATE messages SET data=substr(data, 1, length(data) - 9)")
    database.close()
    with pytest.raises(InputError, match=r"a: damaged bag \(.*\); repair it") as caught:
        read(folder)
    assert "\n" not in str(caught.value)


def test_unpacked_by_hand_while_metadata_names_the_packed_one(folder, capsys):
    name = storage_of(folder).name
    edit_metadata(folder, f"- {name}\n", f"- {name}.zstd\n")
    edit_metadata(folder, "compression_mode: ''", "compression_mode: FILE")
    edit_metadata(folder, "compression_format: ''", "compression_format: zstd")
    assert_equal(read(folder), Events.concatenate(BATCHES))
    assert capsys.readouterr().err == (
        f"{folder}: metadata.yaml names {name}.zstd, which is not there; {name} is read in its "
        "place\n"
    )


@pytest.mark.parametrize("suffix", [".zstd", ".zst"])
def test_packed_by_hand_while_metadata_names_the_other(folder, suffix, capsys):
    path = pack(storage_of(folder), suffix)
    name = path.name
    assert_equal(read(path), Events.concatenate(BATCHES))
    assert_equal(read(folder), Events.concatenate(BATCHES))
    assert f"; {name} is read in its place\n" in capsys.readouterr().err


def test_packed_file_beside_its_unpacked_one_counts_once(folder):
    file = storage_of(folder)
    data = file.read_bytes()
    pack(file)
    file.write_bytes(data)
    (folder / "metadata.yaml").unlink()
    assert len(read(folder)) == 300


def test_renamed_file(folder, capsys):
    file = storage_of(folder)
    file.rename(folder / f"lab_monday{file.suffix}")
    assert_equal(read(folder), Events.concatenate(BATCHES))
    said = capsys.readouterr().err
    assert said == (
        f"{folder}: metadata.yaml names {file.name}, which is not there; "
        f"lab_monday{file.suffix} is read in its place\n"
    )


def test_renamed_files_of_which_several_may_be_meant(folder):
    file = storage_of(folder)
    for name in ("one", "two"):
        (folder / f"{name}{file.suffix}").write_bytes(file.read_bytes())
    file.unlink()
    with pytest.raises(InputError) as caught:
        read(folder)
    assert str(caught.value) == (
        f"{folder}: {file.name} missing, which metadata.yaml names; there is "
        f"one{file.suffix}, two{file.suffix}; copy what is missing, or give one of the files"
    )


def test_files_that_metadata_does_not_name_are_left_out_and_named(folder, capsys):
    file = storage_of(folder)
    (folder / f"copy_of_it{file.suffix}").write_bytes(file.read_bytes())
    assert_equal(read(folder), Events.concatenate(BATCHES))
    said = f"{folder}: metadata.yaml does not name copy_of_it{file.suffix}, which is left out\n"
    assert capsys.readouterr().err == said


def test_metadata_alone(folder):
    file = storage_of(folder)
    file.unlink()
    with pytest.raises(
        InputError, match=f"{file.name} is missing, which metadata.yaml names; copy"
    ):
        read(folder)


@pytest.mark.parametrize("name", ["recording", "recording.db3.bak", "recording.bag"])
def test_what_a_file_is_its_first_bytes_say(folder, name, tmp_path):
    path = tmp_path / name
    storage_of(folder).rename(path)
    assert_equal(read(path), Events.concatenate(BATCHES))


def test_split_bag_is_read_as_one(tmp_path, folder):
    """Each file has the topic as a connection of its own: its messages come from all of them."""
    file = storage_of(folder)
    later = [make_events(50, start_s=7 + i) for i in range(6)]
    times = [2 * 10**9 + i for i in range(6)]
    other = write_event_bag(
        tmp_path / "b",
        later,
        storage=next(s for s in SUFFIX if SUFFIX[s] == file.suffix),
        log_times=times,
    )
    storage_of(other).rename(folder / f"a_1{file.suffix}")
    edit_metadata(folder, f"- {file.name}\n", f"- {file.name}\n  - a_1{file.suffix}\n")
    assert_equal(read(folder), Events.concatenate(BATCHES + later))
    info = inspect(folder)
    assert [(t.name, t.packets, t.events) for t in info.topics] == [("/cam/events", 12, 600)]
    assert [t["messages"] for t in info.other_topics] == [2]


def test_active_bag_of_a_killed_recorder(tmp_path, capsys):
    bag = write_event_bag(tmp_path / "a.bag", BATCHES)
    active = tmp_path / "b.bag.active"
    bag.rename(active)
    assert_equal(read(active), Events.concatenate(BATCHES))
    assert capsys.readouterr().err == ""
    data = active.read_bytes()  # the index is written last
    for name, size in ((b"index_pos=", 8), (b"conn_count=", 4), (b"chunk_count=", 4)):
        at = data.index(name) + len(name)
        data = data[:at] + bytes(size) + data[at + size :]
    active.write_bytes(data[:-100])
    assert_equal(read(active), Events.concatenate(BATCHES))
    said = f"{active}: cut off while recording; read as far as it is whole: 7 messages in 0.0 s\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("form", ["", "control_msg_zstd.db3"])
def test_field_recording_without_metadata(shared_data, form, capsys):
    path = shared_data / "field" / "msg_zstd_no_metadata" / form
    with open_recording(shared_data / "field" / "control.mcap") as control:
        expected = Events.concatenate(list(control.event_chunks()))
    assert_equal(read(path), expected)
    assert len(expected) == 18109
    assert capsys.readouterr().err == f"{path}: its messages are compressed one by one (zstd)\n"


def test_hidden_files_of_other_systems_are_none_of_the_bag(folder, capsys):
    file = storage_of(folder)
    (folder / f"._{file.name}").write_bytes(b"\0\5\26\7Mac OS X")
    (folder / "metadata.yaml").unlink()
    assert_equal(read(folder), Events.concatenate(BATCHES))
    assert capsys.readouterr().err == ""
