import itertools

import numpy as np
import pytest
from encoders import assert_equal, synthetic
from messages import point_cloud, serialize, typestore

from emoflow_ros.core.types.events import Events
from msg_adapters import DecodeError, make_decoder

S = 1_000_000_000
STAMP = 1_700_000_000 * S


def structured(fields: list[tuple[str, str]], values: dict[str, np.ndarray]) -> np.ndarray:
    points = np.zeros(len(values["x"]), np.dtype(fields))
    for name, _ in fields:
        points[name] = values.get(name, 99)
    return points


def decode(points: np.ndarray, serialization: str = "cdr", stamp: int = STAMP) -> Events:
    data = point_cloud(points, serialization, stamp=stamp)
    return make_decoder("sensor_msgs/msg/PointCloud2", serialization).decode(data).events


def absolute(events: Events) -> dict[str, np.ndarray]:
    return {"x": events.x, "y": events.y, "p": events.p, "t": events.t / 1e9}


@pytest.mark.parametrize("order", list(itertools.permutations("xytp")))
def test_fields_in_any_order(rng, order):
    events = synthetic(rng, 40)
    types = {"x": "<u2", "y": "<u2", "t": "<f8", "p": "u1"}
    points = structured([(name, types[name]) for name in order], absolute(events))
    assert_equal(decode(points, stamp=0), events)


def test_first_part_of_a_cloud(rng):
    events = synthetic(rng, 41)
    types = {"x": "<u2", "y": "<u2", "t": "<f8", "p": "u1"}
    data = point_cloud(structured(list(types.items()), absolute(events)), "cdr", stamp=0)
    found = make_decoder("sensor_msgs/msg/PointCloud2", "cdr").decode(data, 8).events
    assert_equal(found, events[:6])


@pytest.mark.parametrize("coordinate", ["u2", "i2", "u4", "i4", "f4", "f8"])
@pytest.mark.parametrize("polarity", ["u1", "i1", "u2", "i4", "f4", "f8"])
@pytest.mark.parametrize("byte_order", ["<", ">"])
def test_fields_of_any_type(rng, serialization, coordinate, polarity, byte_order):
    events = synthetic(rng, 40)
    fields = [("x", coordinate), ("y", coordinate), ("t", "f8"), ("p", polarity)]
    fields = [(name, byte_order + code) for name, code in fields]
    assert_equal(decode(structured(fields, absolute(events)), serialization, stamp=0), events)


def test_small_coordinate_types(rng):
    events = synthetic(rng, 40)
    small = events[(events.x < 128) & (events.y < 128)]
    for code in ("u1", "i1"):
        fields = [("x", code), ("y", code), ("t", "<f8"), ("p", code)]
        assert_equal(decode(structured(fields, absolute(small)), stamp=0), small)


def test_extra_fields_and_gaps_are_ignored(rng):
    events = synthetic(rng, 40)
    dtype = np.dtype(
        {
            "names": ["z", "x", "intensity", "y", "timestamp", "polarity"],
            "formats": ["<f4", "<f4", "<u2", "<f4", "<f8", "u1"],
            "offsets": [3, 8, 12, 17, 25, 40],
            "itemsize": 48,
        }
    )
    points = np.zeros(40, dtype)
    points["x"], points["y"] = events.x, events.y
    points["timestamp"], points["polarity"] = events.t / 1e9, events.p
    assert_equal(decode(points, stamp=0), events)


@pytest.mark.parametrize(("off", "code"), [(0, "u1"), (-1, "i1"), (-1, "f4")])
def test_polarity_is_on_where_positive(off, code):
    p = np.array([1, off, 1, off])
    values = {"x": np.arange(4), "y": np.arange(4), "t": np.arange(4) * 1e-6, "p": p}
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", code)]
    assert decode(structured(fields, values)).p.tolist() == [True, False, True, False]


@pytest.mark.parametrize(
    ("name", "code", "first", "unit", "expected"),
    [
        pytest.param("t", "f8", STAMP / 1e9, 1e-9, STAMP, id="epoch seconds"),
        pytest.param("t", "f8", STAMP / 1e3, 1e-3, STAMP, id="epoch microseconds"),
        pytest.param("t", "f8", STAMP, 1.0, STAMP, id="epoch nanoseconds"),
        pytest.param("t", "f8", 7.25, 1e-9, 7.25 * S, id="sensor seconds"),
        pytest.param("t", "u4", 7_250_000, 1e-3, 7.25 * S, id="sensor microseconds"),
        pytest.param("t", "f4", 0, 1e-9, STAMP, id="relative seconds"),
        pytest.param("t", "u4", 0, 1e-3, STAMP, id="relative microseconds"),
        pytest.param("t", "u4", 0, 1.0, STAMP, id="relative nanoseconds"),
        pytest.param("t_us", "f8", 0, 1e-3, STAMP, id="relative, unit in the name"),
        pytest.param("t_ns", "f8", 7.25 * S, 1.0, 7.25 * S, id="sensor, unit in the name"),
    ],
)
def test_time_units_and_origins(name, code, first, unit, expected):
    dt = np.arange(20) * 1_000_000  # ns: a message of 19 ms
    values = {"x": np.arange(20), "y": np.arange(20), "p": np.ones(20), name: first + dt * unit}
    fields = [("x", "<u2"), ("y", "<u2"), (name, "<" + code), ("p", "u1")]
    t = decode(structured(fields, values)).t
    resolution = 1 if first == 0 else 512  # float64 of epoch times
    np.testing.assert_allclose(t - int(expected), dt, atol=resolution, rtol=0)


@pytest.mark.parametrize("start_s", [0.0, 7.25])
@pytest.mark.parametrize(("scale", "exact"), [(1e-9, 1), (1e-6, 1), (1e-3, 1)])
def test_decimals_of_dense_messages_tell_their_unit(start_s, scale, exact):
    """2000 events in 10 ms: as seconds, milliseconds (10 s, were they seconds) and microseconds."""
    dt = np.arange(2000) * 5000
    t = (start_s * 1e9 + dt) * scale
    values = {"x": np.arange(2000) % 99, "y": np.arange(2000) % 9, "p": np.ones(2000), "t": t}
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")]
    expected = dt + round(start_s * S) if start_s else dt + STAMP
    np.testing.assert_allclose(decode(structured(fields, values)).t, expected, atol=exact, rtol=0)


def test_decimals_of_sparse_messages_are_seconds():
    t = np.arange(5) * 0.4
    values = {"x": np.arange(5), "y": np.arange(5), "p": np.ones(5), "t": 9.0 + t}
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")]
    assert decode(structured(fields, values)).t.tolist() == np.rint((9.0 + t) * 1e9).tolist()


def test_absolute_times_of_a_clock_that_starts_at_zero():
    decoder = make_decoder("sensor_msgs/msg/PointCloud2", "cdr")
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")]
    for start in np.arange(0, 5, 0.05):
        t = start + np.arange(5) * 0.01
        values = {"x": np.arange(5), "y": np.arange(5), "t": t, "p": np.ones(5)}
        data = point_cloud(structured(fields, values), stamp=round(start * 1e9))
        np.testing.assert_array_equal(decoder.decode(data).events.t, np.rint(t * 1e9))


def test_meaning_of_time_is_kept_until_reset():
    decoder = make_decoder("sensor_msgs/msg/PointCloud2", "cdr")
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<u4"), ("p", "u1")]

    def first_time(t: list[int]) -> int:
        values = {"x": np.arange(2), "y": np.arange(2), "t": np.array(t), "p": np.ones(2)}
        data = point_cloud(structured(fields, values), stamp=STAMP)
        return int(decoder.decode(data).events.t[-1]) - STAMP

    assert first_time([0, 30_000_000]) == 30_000_000  # a span of 30e6 can only be ns
    assert first_time([0, 30_000]) == 30_000  # still ns
    decoder.reset()
    assert first_time([0, 30_000]) == 30_000_000  # judged anew: us


def test_padded_rows(rng, serialization):
    events = synthetic(rng, 40)
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")]
    points = structured(fields, absolute(events))
    data = point_cloud(points, serialization, rows=4, row_padding=5)
    decoder = make_decoder("sensor_msgs/msg/PointCloud2", serialization)
    assert_equal(decoder.decode(data).events, events)


def test_points_that_are_no_pixels_are_dropped_and_counted():
    x = np.array([1, -1, np.nan, 2, 70000, 3])
    t = np.array([0, 1, 2, np.inf, 4, 5]) * 1e-6
    values = {"x": x, "y": np.zeros(6), "t": t, "p": np.ones(6)}
    fields = [("x", "<f4"), ("y", "<f4"), ("t", "<f8"), ("p", "u1")]
    decoder = make_decoder("sensor_msgs/msg/PointCloud2", "cdr")
    message = decoder.decode(point_cloud(structured(fields, values), stamp=STAMP))
    assert message.events.x.tolist() == [1, 3]
    assert (message.events.t - STAMP).tolist() == [0, 5000]
    assert message.dropped_outside == decoder.statistics.dropped_outside == 4
    assert (message.width, message.height) == (0, 0)


def test_no_points():
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")]
    assert len(decode(np.zeros(0, np.dtype(fields)))) == 0


def test_missing_field_is_named():
    points = np.zeros(2, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    with pytest.raises(DecodeError, match=r"no field t or ts .*only x, y, z"):
        decode(points)


def test_times_beyond_64_bits_are_refused():
    values = {"x": np.arange(2), "y": np.arange(2), "t": np.full(2, 1e300), "p": np.ones(2)}
    fields = [("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")]
    with pytest.raises(DecodeError, match="beyond 64-bit"):
        decode(structured(fields, values))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"width": 1 << 31}, "do not fit"),
        ({"height": 1 << 31}, "do not fit"),
        ({"height": 2, "row_step": 0}, "do not fit"),
        ({"point_step": 0}, "outside the point"),
        ({"point_step": 12}, "outside the point"),
        ({"point_step": (1 << 32) - 1, "width": 0}, "points of 4294967295 bytes"),
    ],
)
def test_layouts_that_do_not_fit_the_data(change, reason):
    store = typestore("cdr")
    points = np.zeros(4, np.dtype([("x", "<u2"), ("y", "<u2"), ("t", "<f8"), ("p", "u1")]))
    message = store.deserialize_cdr(point_cloud(points), "sensor_msgs/msg/PointCloud2")
    for name, value in change.items():
        object.__setattr__(message, name, value)
    with pytest.raises(DecodeError, match=reason):
        make_decoder("sensor_msgs/PointCloud2", "cdr").decode(serialize(message, "cdr"))


def test_layout_of_fast_cdr(rng):
    serialization = pytest.importorskip("rclpy.serialization", reason="rclpy is not installed")
    messages = pytest.importorskip("sensor_msgs.msg", reason="sensor_msgs is not installed")
    events = synthetic(rng, 40)
    fields = [("t", "<f8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]
    points = structured(fields, absolute(events))
    cloud = messages.PointCloud2(height=1, width=40, point_step=13, row_step=520)
    for name, offset, datatype in (("t", 0, 8), ("x", 8, 4), ("y", 10, 4), ("p", 12, 2)):
        field = messages.PointField(name=name, offset=offset, datatype=datatype, count=1)
        cloud.fields.append(field)
    cloud.data = points.tobytes()
    data = serialization.serialize_message(cloud)
    message = make_decoder("sensor_msgs/msg/PointCloud2", "cdr").decode(data)
    assert_equal(message.events, events)
