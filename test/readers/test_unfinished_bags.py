"""Bags whose recorder was killed: read as far as they are whole, with a line that says how far."""

import subprocess
import sys
from pathlib import Path
from shutil import copyfile

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2.storage_mcap import McapWriter

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.bag_files import open_bag

CHUNK = 2000  # bytes: several chunks
BATCHES = 12
EVENTS = 100


@pytest.fixture
def batches(make_events) -> list[Events]:
    return [make_events(EVENTS, start_s=1 + i) for i in range(BATCHES)]


@pytest.fixture(params=["ros1", "ros1-lz4", "ros1-bz2", "mcap", "mcap-zstd"])
def bag(request, tmp_path, batches, write_event_bag, monkeypatch) -> Path:
    """A finished bag of many chunks."""
    storage, _, compression = request.param.partition("-")
    writer = rosbag1.Writer if storage == "ros1" else rosbag2.Writer
    start, write = writer.__init__, McapWriter.write

    def init(self, *args, **kwargs):
        start(self, *args, **kwargs)
        self.chunk_threshold = CHUNK
        if storage == "ros1" and compression:
            self.set_compression(self.CompressionFormat[compression.upper()])
        elif compression:
            self.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)

    def write_small_chunks(self, *args):
        write(self, *args)
        if self.chunk.bio.tell() > CHUNK:
            self.close_chunk()

    monkeypatch.setattr(writer, "__init__", init)
    monkeypatch.setattr(McapWriter, "write", write_small_chunks)
    path = tmp_path / ("a.bag" if storage == "ros1" else "a")
    write_event_bag(path, batches, storage=storage)
    return path if storage == "ros1" else next(path.glob("*.mcap"))


def read(path: Path) -> Events:
    with open_recording(path) as recording:
        return Events.concatenate(list(recording.event_chunks()))


def refusal(path: Path) -> str:
    """Why a bag cannot be read; empty if it can."""
    try:
        read(path)
    except InputError as error:
        return str(error)
    return ""


def unfinished(bag: Path, length: int) -> Path:
    """As the recorder leaves a file that it had no time to finish."""
    data = bag.read_bytes()[:length]
    if bag.suffix == ".bag":  # these are written last
        for name, size in ((b"index_pos=", 8), (b"conn_count=", 4), (b"chunk_count=", 4)):
            at = data.index(name) + len(name)
            data = data[:at] + bytes(size) + data[at + size :]
    path = bag.with_name(f"cut_{length}{bag.suffix}")  # each is said once
    path.write_bytes(data)
    return path


def test_bag_is_read_as_far_as_it_is_whole(bag, batches, capsys):
    size = bag.stat().st_size
    written = Events.concatenate(batches)
    seen = []
    for length in np.linspace(size * 0.15, size, 40).astype(int).tolist():
        path = unfinished(bag, length - 1)
        if not seen and refusal(path):
            assert "damaged bag" in refusal(path)
            continue
        events = read(path)
        said = capsys.readouterr().err.splitlines(keepends=True)[-1]
        start = f"{path}: cut off while recording; read as far as it is whole: "
        assert said.startswith(start)
        messages = int(said.removeprefix(start).split()[0])
        assert messages - len(events) // EVENTS in (0, 1)  # the camera_info, written last
        np.testing.assert_array_equal(events.t, written.t[: len(events)])
        np.testing.assert_array_equal(events.x, written.x[: len(events)])
        seen.append(len(events))
    assert seen == sorted(seen)
    assert len(set(seen)) >= 4
    assert seen[-1] == len(written)


def test_finished_bag_is_read_without_a_word(bag, batches, capsys):
    assert len(read(bag)) == EVENTS * BATCHES
    assert capsys.readouterr().err == ""


def test_last_file_of_a_split_bag_may_be_cut(bag, make_events, capsys):
    if bag.suffix == ".bag":
        pytest.skip("ROS 1 bags are files of their own")
    folder = bag.parent
    copyfile(bag, folder / "b_1.mcap")
    (folder / "metadata.yaml").unlink()
    cut = folder / "b_1.mcap"
    cut.write_bytes(cut.read_bytes()[:-50])
    with open_bag(folder) as reader:
        count = sum(connection.msgcount for connection in reader.connections)
    assert count >= 2 * BATCHES
    assert capsys.readouterr().err.startswith(f"{cut}: cut off while recording")


@pytest.mark.parametrize("mode", ["WAL", "DELETE"])
def test_database_with_a_journal(tmp_path, batches, write_event_bag, capsys, mode):
    """Its process dies within a transaction, behind one that is committed."""
    folder = write_event_bag(tmp_path / "a", batches, storage="sqlite3")
    file = next(folder.glob("*.db3"))
    (folder / "metadata.yaml").unlink()
    code = f"""
import os, sqlite3
database = sqlite3.connect({str(file)!r}, isolation_level=None)
database.execute("PRAGMA journal_mode={mode}")
database.execute("PRAGMA cache_size=1")
database.execute("PRAGMA wal_autocheckpoint=0")
last = "SELECT max(timestamp) FROM messages WHERE topic_id=1"
database.execute(f"DELETE FROM messages WHERE timestamp=({{last}}) AND topic_id=1")
database.execute("BEGIN")
database.execute("DELETE FROM messages")
database.execute("UPDATE topics SET name='/lost'")
os._exit(0)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    assert any(f.name.endswith(("-wal", "-journal")) and f.stat().st_size for f in folder.iterdir())
    assert len(read(folder)) == EVENTS * (BATCHES - 1)
    assert f"{file}: cut off while recording; read as far" in capsys.readouterr().err
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == before


def test_walk_over_any_bytes_ends(bag, capsys):
    """Damage beside the cut: what is read is a beginning, or one line says why nothing is."""
    rng = np.random.default_rng(2)
    whole = bag.read_bytes()
    for _ in range(60):
        data = bytearray(whole[: rng.integers(20, len(whole))])
        for at in rng.integers(13, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(256)
        path = bag.with_name(f"bad{bag.suffix}")
        path.write_bytes(data)
        assert "\n" not in refusal(path)


def test_chunk_that_was_being_written_is_read_as_far_as_it_is_whole(
    tmp_path, batches, write_event_bag
):
    """The recorder fills in a chunk's length when it is full; here all is in the first one."""
    bag = write_event_bag(tmp_path / "a.bag", batches)
    data = bag.read_bytes()
    at = data.index(b"size=") + len(b"size=")
    while data[at - 60 : at].find(b"compression=none") < 0:
        at = data.index(b"size=", at) + len(b"size=")
    length = int.from_bytes(data[at : at + 4], "little")
    (length_at,) = (k for k in range(at + 4, at + 60) if data[k : k + 4] == data[at : at + 4])
    seen = set()
    for share in (0.2, 0.35, 0.6, 1.0):
        cut = length_at + 4 + int(length * share)
        for known in (True, False):
            part = bytearray(data[:cut])
            if not known:
                part[at : at + 4] = part[length_at : length_at + 4] = bytes(4)
            bag.write_bytes(part)
            path = unfinished(bag, cut)
            events = read(path)
            written = Events.concatenate(batches)
            np.testing.assert_array_equal(events.t, written.t[: len(events)])
            seen.add(len(events))
    assert len(seen) == 4
    assert max(seen) == EVENTS * BATCHES
