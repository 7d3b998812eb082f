"""Recordings read from a time on: the same events as the end of a whole read, found quickly."""

import h5py
import numpy as np
import pytest

from emoflow_ros.core.types.events import Events
from emoflow_ros.readers import bag_events, mvsec, open_recording

START_NS, STEP_NS, COUNT = 1_000_000_000, 1_000_000, 20_000  # 20 s at 1 kHz


@pytest.fixture
def events(make_events) -> Events:
    return make_events(COUNT)


def write_mvsec(path, events):
    seconds = events.t / 1e9
    with h5py.File(path, "w") as file:
        rows = np.column_stack([events.x, events.y, seconds, np.where(events.p, 1, -1)])
        file.create_dataset("davis/left/events", data=rows, chunks=(1000, 4), compression="gzip")
    return path


def write_dsec(path, events):
    with h5py.File(path, "w") as file:
        file["events/x"], file["events/y"], file["events/p"] = events.x, events.y, events.p
        file["events/t"] = ((events.t - START_NS) // 1000).astype(np.uint32)
        file["t_offset"] = START_NS // 1000
    return path


def write_npz(path, events):
    np.savez(path, x=events.x, y=events.y, t_ns=events.t, p=events.p)
    return path


def write_ecd(path, events):
    path.mkdir()
    columns = zip((events.t / 1e9).tolist(), events.x, events.y, events.p, strict=True)
    rows = (f"{t:09.6f} {x:02d} {y:02d} {p:d}\n" for t, x, y, p in columns)  # of one length
    (path / "events.txt").write_text("".join(rows))
    return path


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (write_mvsec, "a.hdf5"),
        (write_dsec, "events.h5"),
        (write_npz, "a.npz"),
        (write_ecd, "ecd"),
    ],
)
@pytest.mark.parametrize("first", [0, 1, 2, 777, COUNT - 1, COUNT])
def test_files(tmp_path, events, write, name, first):
    """`since` is met exactly and between two events; after the last one there is nothing."""
    path = write(tmp_path / name, events)
    with open_recording(path) as recording:
        for since in (START_NS + first * STEP_NS, START_NS + first * STEP_NS - STEP_NS // 2):
            found = Events.concatenate(list(recording.event_chunks(since)))
            for column in ("x", "y", "t", "p"):
                expected = getattr(events, column)[first:]
                np.testing.assert_array_equal(getattr(found, column), expected)


@pytest.mark.parametrize(
    ("write", "name"), [(write_mvsec, "a.hdf5"), (write_dsec, "events.h5"), (write_ecd, "ecd")]
)
@pytest.mark.parametrize("middle", [1, 2, 3])
@pytest.mark.parametrize("shift_s", [-9, 9])
def test_events_out_of_order_do_not_lead_past_what_is_sought(
    tmp_path, events, write, name, middle, shift_s
):
    """The first looks of the bisection, at a quarter, half and three quarters, meet such events."""
    wrong = slice(COUNT * middle // 4 - 40, COUNT * middle // 4 + 40)  # 80 ms
    events.t[wrong] += shift_s * 1_000_000_000
    path = write(tmp_path / name, events)
    with open_recording(path) as recording:
        whole = Events.concatenate(list(recording.event_chunks()))
        assert COUNT - 80 <= len(whole) < COUNT
        for first in range(500, COUNT, 1000):
            since = START_NS + first * STEP_NS
            found = Events.concatenate(list(recording.event_chunks(since)))
            np.testing.assert_array_equal(found.t, whole.t[np.searchsorted(whole.t, since) :])


def test_rows_before_are_not_read(tmp_path, events, monkeypatch):
    monkeypatch.setattr(mvsec, "CHUNK", 100)
    with open_recording(write_mvsec(tmp_path / "a.hdf5", events)) as recording:
        chunks = recording.event_chunks(START_NS + 15_000 * STEP_NS)
        first = next(events for events in chunks if len(events))
    assert len(first) < 300  # of the rows from the last one before on, 100 at a time
    assert first.t[0] == START_NS + 15_000 * STEP_NS


@pytest.fixture
def decoded(monkeypatch):
    """Count the messages that were decoded."""
    count = []
    make = bag_events.make_decoder

    def counting(*arguments):
        decoder = make(*arguments)

        class Counting:
            def decode(self, data):
                count.append(len(data))
                return decoder.decode(data)

        return Counting()

    monkeypatch.setattr(bag_events, "make_decoder", counting)
    return count


def bag_of(tmp_path, events, write, storage, log_times=None):
    """A bag of 200 messages of 100 events, logged 5 s late unless told otherwise."""
    batches = [events[k : k + 100] for k in range(0, COUNT, 100)]
    path = tmp_path / ("a.bag" if storage == "ros1" else "a")
    log_times = log_times or [int(batch.t[0]) + 5_000_000_000 for batch in batches]
    return write(path, batches, storage=storage, log_times=log_times)


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag_is_entered_in_the_middle(tmp_path, events, write_event_bag, storage, decoded):
    path = bag_of(tmp_path, events, write_event_bag, storage)
    with open_recording(path) as recording:
        found = Events.concatenate(list(recording.event_chunks(START_NS + 18_050 * STEP_NS)))
    np.testing.assert_array_equal(found.t, events.t[18_050:])
    np.testing.assert_array_equal(found.x, events.x[18_050:])
    assert len(decoded) < 40  # of 200: one look at the start, one at 1 s before, and the rest


def test_bag_with_jumping_log_times_loses_nothing(tmp_path, events, write_event_bag):
    """The recorder began 8 s late, with all that had waited: the first guess is 7 s too late."""
    late = [max(int(events.t[k]), 9_000_000_000) + k for k in range(0, COUNT, 100)]
    path = bag_of(tmp_path, events, write_event_bag, "mcap", late)
    with open_recording(path) as recording:
        for first in (5_000, 9_990, 15_050, 19_999):
            found = Events.concatenate(list(recording.event_chunks(int(events.t[first]))))
            np.testing.assert_array_equal(found.t, events.t[first:])
