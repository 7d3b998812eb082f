"""Real packets: counts, polarities and times as the recordings' own documentation has them."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag2 import Reader as Rosbag2Reader

from emoflow_ros.core.types.events import Events
from emoflow_ros.readers.bag_files import open_bag
from msg_adapters import make_decoder


def decode(messages, serialization: str):
    decoder = make_decoder("event_camera_msgs/msg/EventPacket", serialization)
    parts = [decoder.decode(data) for _, _, data in messages]
    assert all(part.width and part.dropped_outside == 0 for part in parts)
    return Events.concatenate([part.events for part in parts]), decoder.statistics


@pytest.mark.parametrize(
    ("name", "reader", "serialization"),
    [("test_events_1", Rosbag2Reader, "cdr"), ("test_events_1.bag", Rosbag1Reader, "ros1")],
)
def test_evt3(recordings: Path, name, reader, serialization):
    with reader(recordings / name) as bag:
        events, statistics = decode(bag.messages(), serialization)
    assert len(events) == 343_474
    assert np.count_nonzero(events.p) == 125_183
    assert (events.t[0], events.t[-1]) == (7_139_845_000, 9_218_023_000)
    assert np.all(events.t[1:] >= events.t[:-1])
    assert (events.x.max(), events.y.max()) == (639, 479)
    assert (statistics.messages, statistics.seq_gaps, statistics.skipped) == (517, 0, 0)
    assert statistics.triggers == 4157


def test_libcaer_cmp(recordings: Path):
    with open_bag(recordings / "test_events_2") as bag:
        events, statistics = decode(bag.messages(), "cdr")
    assert len(events) == 571_266
    assert np.count_nonzero(events.p) == 211_043
    assert events.t[0] == 1_744_227_144_732_712_000
    assert 0.999e9 < events.t[-1] - events.t[0] < 1.001e9
    assert np.all(events.t[1:] >= events.t[:-1])
    assert (events.x.max(), events.y.max()) == (345, 259)
    assert (statistics.messages, statistics.seq_gaps, statistics.skipped) == (100, 0, 0)
