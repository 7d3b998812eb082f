"""Valid recordings with one change that the field makes, and the right events: in `make fuzz`.

A recorder saves an index, a converter writes a profile, a cable loses words, a killed process
leaves a file, somebody renames or unpacks one. Each run makes one such recording of random events
and compares what is read with what was written.

    python test/readers/fuzz_variants.py [--runs N] [--seed N] [--kind NAME]
"""

import argparse
import contextlib
import io
import sqlite3
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from backports import zstd

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS / "recordings"), str(TESTS / "msg_adapters")]

from encoders import evt3  # noqa: E402
from event_bags import EVENT_ARRAY, event_array_bytes, write_event_bag  # noqa: E402
from mcap_files import McapLayout, Topic, write_mcap  # noqa: E402
from rosbags import rosbag1  # noqa: E402

from emoflow_ros.core.types.events import Events  # noqa: E402
from emoflow_ros.readers import open_recording, unordered  # noqa: E402

SIZE = (64, 48)
CDR = Topic("/cam/events", (EVENT_ARRAY, "ros2msg", ""), "cdr")
ROS1 = Topic("/cam/events", ("dvs_msgs/EventArray", "ros1msg", ""), "ros1")
OTHER = Topic("/web", ("foxglove.Grid", "protobuf", ""), "protobuf")

type Random = np.random.Generator
type Made = tuple[Path, Events, int]  # what to read, the right events, how many are left out
type Make = Callable[[Path, Random], Made]


def main() -> int:
    """Make and read recordings of one kind or all; an AssertionError at the first wrong one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100, help="recordings of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, help="default: all")
    options = parser.parse_args()
    for number, (kind, make) in enumerate(KINDS.items()):
        if options.kind in (None, kind):
            for run in range(options.runs):
                check(make, kind, (options.seed, number, run))
            print(f"== {kind}: {options.runs} recordings", flush=True)
    return 0


def check(make: Make, kind: str, seed: tuple[int, int, int]) -> None:
    """Make a recording, read it, and compare.

    Raises:
        AssertionError: other events than the right ones, or another number left out.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()):
        path, expected, left_out = make(Path(folder), np.random.default_rng(seed))
        with open_recording(path) as recording:
            read = Events.concatenate(list(recording.event_chunks()))
            assert unordered(recording) == left_out, f"{kind}, seed {seed}"
    for name in ("x", "y", "t", "p"):
        one, two = getattr(read, name), getattr(expected, name)
        assert one.tolist() == two.tolist(), f"{kind}, seed {seed}: {name}"


def some_events(rng: Random, count: int, step_us: int = 2000) -> Events:
    """Make events in order, `step_us` apart at most."""
    t = np.cumsum(rng.integers(0, step_us, count)) + 1_000_000
    x, y = rng.integers(0, SIZE[0], count), rng.integers(0, SIZE[1], count)
    return Events(x.astype(np.uint16), y.astype(np.uint16), t * 1000, rng.random(count) < 0.5)


def parts(events: Events, rng: Random) -> list[Events]:
    """Cut into messages of random length, of which none is empty."""
    most = max(1, len(events) - 1)
    cuts = np.unique(rng.integers(1, most + 1, rng.integers(1, 20)))
    return [
        p for p in (events[a:b] for a, b in zip([0, *cuts], [*cuts, None], strict=True)) if len(p)
    ]


def mcap_index(folder: Path, rng: Random) -> Made:
    """Any index missing, chunks of any size or none, messages logged out of order."""
    events = some_events(rng, int(rng.integers(50, 500)))
    messages = _messages(parts(events, rng), 0, ros1=False)
    messages += [(1, int(m[1]) + 1, b"x") for m in messages[::3]]
    rng.shuffle(messages)
    layout = McapLayout("ros2", int(rng.integers(0, 6)), *(rng.random(4) < 0.5).tolist())
    return write_mcap(folder / "a.mcap", [CDR, OTHER], messages, layout), events, 0


def mcap_profile(folder: Path, rng: Random) -> Made:
    """Messages of ROS 1 and ROS 2 on one topic, in a file of any profile."""
    events = some_events(rng, int(rng.integers(50, 500)))
    both = _messages(parts(events, rng), 0, ros1=False)
    for i in np.flatnonzero(rng.random(len(both)) < rng.random()):
        _, time, _ = both[i]
        both[i] = (1, time, _messages(parts_of(both, events)[i : i + 1], 1, ros1=True)[0][2])
    profile = str(rng.choice(["", "ros1", "ros2", "other"]))
    layout = McapLayout(profile, int(rng.integers(0, 6)))
    return write_mcap(folder / "a.mcap", [CDR, ROS1, OTHER], both, layout), events, 0


def parts_of(messages: list[tuple[int, int, bytes]], events: Events) -> list[Events]:
    """Cut events as the messages are: they are logged at their first events."""
    starts = np.searchsorted(np.arange(len(events)), [time for _, time, _ in messages])
    return [events[a:b] for a, b in zip(starts, [*starts[1:], None], strict=True)]


def _messages(batches: list[Events], topic: int, *, ros1: bool) -> list[tuple[int, int, bytes]]:
    """Serialise; a message is logged at the number of its first event, in ns."""
    found, number = [], 0
    for batch in batches:
        found.append((topic, number, event_array_bytes(batch, *SIZE, ros1)))
        number += len(batch)
    return found


def early_events(folder: Path, rng: Random) -> Made:
    """Single events too early by 20 us to 1 s, in a bag of any kind."""
    events = some_events(rng, int(rng.integers(500, 3000)))
    places = np.arange(2, len(events), 2)  # none beside another
    wrong = rng.choice(places, int(rng.integers(1, 9)), replace=False)
    events.t[wrong] = events.t[wrong - 1] - rng.integers(20_000, 1_000_000_000, len(wrong))
    storage = str(rng.choice(["ros1", "sqlite3", "mcap"]))
    path = folder / ("a.bag" if storage == "ros1" else "a")
    write_event_bag(path, parts(events, rng), size=SIZE, storage=storage)
    return path, events[np.delete(np.arange(len(events)), wrong)], len(wrong)


def lost_words(folder: Path, rng: Random) -> Made:
    """EVT3 whose packets have lost words of time, which come again within 4 ms."""
    events = some_events(rng, 5000, step_us=40)
    words = evt3(events)
    high, low = words >> 12 == 0x8, words >> 12 == 0x6
    lost = (high | low) & (rng.random(len(words)) < 0.03)
    lost[: np.flatnonzero(low)[0] + 1] = False
    header = f"% evt 3.0\n% geometry {SIZE[0]}x{SIZE[1]}\n% end\n".encode()
    path, whole = folder / "a.raw", folder / "whole.raw"
    path.write_bytes(header + words[~lost].tobytes())
    whole.write_bytes(header + words.tobytes())
    with open_recording(path) as recording:
        read = Events.concatenate(list(recording.event_chunks()))
        left_out = unordered(recording)
    # Without the upper half of its time a sensor lags for 4 ms, of some 200 events.
    assert left_out <= 250 * np.count_nonzero(lost & high) + np.count_nonzero(lost), left_out
    assert len(read) + left_out == len(events)
    assert (np.diff(read.t) >= 0).all()
    assert abs(int(read.t[-1]) - int(events.t[-1])) < 10_000_000
    return whole, events, 0


def active_bag(folder: Path, rng: Random) -> Made:
    """A ROS 1 bag of a killed recorder, cut off at any place behind some whole chunks."""
    events = some_events(rng, int(rng.integers(200, 1000)))
    batches = parts(events, rng)
    path = folder / "a.bag.active"
    started = rosbag1.Writer.__init__

    def with_small_chunks(self: rosbag1.Writer, *args: object) -> None:
        started(self, *args)  # type: ignore[arg-type]
        self.chunk_threshold = 1  # a message each

    rosbag1.Writer.__init__ = with_small_chunks  # type: ignore[method-assign,assignment]
    try:
        write_event_bag(folder / "a.bag", batches, size=SIZE, with_info=False)
    finally:
        rosbag1.Writer.__init__ = started  # type: ignore[method-assign]
    data = (folder / "a.bag").read_bytes()
    ends = _ends_of_chunks(data)
    whole = int(rng.integers(1, len(batches) + 1))
    following = ends[whole] if whole < len(ends) else len(data)
    cut = int(rng.integers(ends[whole - 1], following))
    for name, size in ((b"index_pos=", 8), (b"conn_count=", 4), (b"chunk_count=", 4)):
        at = data.index(name) + len(name)
        data = data[:at] + bytes(size) + data[at + size :]
    path.write_bytes(data[:cut])
    return path, Events.concatenate(batches[:whole]), 0


def _ends_of_chunks(data: bytes) -> list[int]:
    """Find where the chunks end, of a message each; their indexes stand behind them."""
    ends, at = [], data.index(b"\n") + 1
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "little")
        is_chunk = b"op=\x05" in data[at : at + 4 + length]
        at += 4 + length
        at += 4 + int.from_bytes(data[at : at + 4], "little")
        ends += [at] if is_chunk else []
    return ends


def moved_files(folder: Path, rng: Random) -> Made:
    """A rosbag2 folder, packed, unpacked or renamed, with its metadata.yaml or without."""
    events = some_events(rng, int(rng.integers(50, 500)))
    storage = str(rng.choice(["sqlite3", "mcap"]))
    bag = write_event_bag(folder / "a", parts(events, rng), size=SIZE, storage=storage)
    file = next(f for f in bag.iterdir() if f.suffix != ".yaml")
    metadata = bag / "metadata.yaml"
    if storage == "sqlite3" and rng.random() < 0.5:
        _compress_messages(file)
    if rng.random() < 0.5:
        metadata.write_text(metadata.read_text().replace(file.name, file.name + ".zstd"))
    if rng.random() < 0.5:
        packed = file.with_name(file.name + ".zstd")
        packed.write_bytes(zstd.compress(file.read_bytes()))
        file.unlink()
        file = packed
    if rng.random() < 0.5:
        file = file.rename(file.with_name("renamed" + "".join(file.suffixes)))
    match rng.integers(3):
        case 0:
            metadata.unlink()
        case 1:
            metadata.write_text("")
    return (bag, file)[rng.integers(2)], events, 0


def _compress_messages(file: Path) -> None:
    database = sqlite3.connect(file)
    rows = database.execute("SELECT id, data FROM messages").fetchall()
    packed = [(zstd.compress(data), number) for number, data in rows]
    database.executemany("UPDATE messages SET data=? WHERE id=?", packed)
    database.commit()
    database.close()


KINDS: dict[str, Make] = {
    "mcap_index": mcap_index,
    "mcap_profile": mcap_profile,
    "early_events": early_events,
    "lost_words": lost_words,
    "active_bag": active_bag,
    "moved_files": moved_files,
}

if __name__ == "__main__":
    sys.exit(main())
