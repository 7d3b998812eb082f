import numpy as np
import pytest

from emoflow_ros.core.stream.clock import ClockMap, Timestamps

MS = 1_000_000
S = 1000 * MS
OFFSET = 1_700_000_000 * S


def messages(rng, seconds: float, drift_ppm: float, mean_delay_ms: float = 3.0):
    """(sensor time, true ROS time, stamp) of messages every 10 ms."""
    sensor = 5 * S + np.arange(0, round(seconds * 1e9), 10 * MS)
    true = sensor + OFFSET + np.rint((sensor - sensor[0]) * drift_ppm * 1e-6).astype(np.int64)
    delay = np.rint(rng.exponential(mean_delay_ms * MS, len(sensor))).astype(np.int64)
    return zip(sensor.tolist(), true.tolist(), (true + delay).tolist(), strict=True)


@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 25.0, 200.0])
def test_fused_finds_offset_and_drift(drift_ppm):
    clock = ClockMap(Timestamps.FUSED)
    errors = []
    for sensor, true, stamp in messages(np.random.default_rng(1), 120, drift_ppm):
        clock.observe(sensor, stamp)
        errors.append(clock.to_ros(sensor) - true)
    assert clock.drift_ppm == pytest.approx(drift_ppm, abs=1.0)
    assert np.abs(errors[2000:]).max() < 0.3 * MS  # against delays of 3 ms on average
    assert np.abs(errors[100:]).max() < 2 * MS


@pytest.mark.parametrize("timestamps", Timestamps)
def test_time_never_goes_back(timestamps):
    clock = ClockMap(timestamps)
    mapped = []
    for sensor, _, stamp in messages(np.random.default_rng(2), 20, 50.0, mean_delay_ms=20):
        clock.observe(sensor, stamp)
        mapped += [clock.to_ros(sensor + dt) for dt in range(0, 10 * MS, MS)]
    assert np.all(np.diff(mapped) > 0)


@pytest.mark.parametrize(("at_s", "step_s"), [(3, 0.3), (8, 0.3), (30, 2.0), (70, 8.0)])
def test_host_clock_that_was_set_forward_is_followed_within_25_s(at_s, step_s):
    clock = ClockMap(Timestamps.FUSED)
    errors, mapped = {}, []
    for sensor, true, stamp in messages(np.random.default_rng(3), at_s + 40, 50.0):
        step = round(step_s * S) if sensor >= (5 + at_s) * S else 0
        clock.observe(sensor, stamp + step)
        mapped.append(clock.to_ros(sensor))
        errors[sensor // S - 5] = mapped[-1] - true - step
    assert np.all(np.diff(mapped) > 0)
    assert abs(errors[at_s + 2]) == pytest.approx(step_s * S, rel=0.01)  # it may be a delay
    assert max(abs(errors[k]) for k in range(at_s + 25, at_s + 40)) < MS
    assert clock.drift_ppm == pytest.approx(50.0, abs=20.0)


def test_messages_that_are_late_for_seconds_move_nothing():
    clock = ClockMap(Timestamps.FUSED)
    errors = []
    for sensor, true, stamp in messages(np.random.default_rng(4), 60, 50.0):
        late = 500 * MS if 30 <= sensor // S - 5 < 34 else 0
        clock.observe(sensor, stamp + late)
        errors.append(clock.to_ros(sensor) - true)
    assert np.abs(errors[2000:]).max() < MS


def test_host_clock_set_forward_is_followed_where_events_were_on_ros_time():
    clock = ClockMap(Timestamps.FUSED)
    for sensor, true, stamp in messages(np.random.default_rng(5), 60, 0.0):
        step = 2 * S if sensor >= 35 * S else 0
        clock.observe(true, stamp + step)
        if sensor < 35 * S:
            assert clock.to_ros(true) == true
    assert clock.to_ros(true) - true - step == pytest.approx(0, abs=5 * MS)


def test_events_on_ros_time_stay_while_their_messages_are_late():
    clock = ClockMap(Timestamps.FUSED)
    for sensor, true, stamp in messages(np.random.default_rng(6), 60, 0.0):
        late = 500 * MS if 35 <= sensor // S < 45 else 0
        clock.observe(true, stamp + late)
        assert clock.to_ros(true) == true


def test_sensor_times_are_left_alone():
    clock = ClockMap(Timestamps.SENSOR)
    clock.observe(5 * S, OFFSET)
    assert clock.to_ros(7 * S) == 7 * S


def test_header_follows_the_stamps():
    clock = ClockMap(Timestamps.HEADER)
    clock.observe(5 * S, OFFSET)
    assert clock.to_ros(5 * S) == OFFSET
    assert clock.to_ros(5 * S + MS) == OFFSET + MS
    clock.observe(5 * S + 10 * MS, OFFSET + 12 * MS)  # 2 ms late
    assert clock.to_ros(5 * S + 20 * MS) == OFFSET + 22 * MS


def test_header_stamp_that_jumps_back_slows_time_down():
    clock = ClockMap(Timestamps.HEADER)
    clock.observe(0, OFFSET)
    clock.observe(10 * MS, OFFSET - 90 * MS)
    assert clock.to_ros(10 * MS) == OFFSET + 10 * MS
    assert clock.to_ros(20 * MS) == OFFSET + 15 * MS
    assert clock.to_ros(S) == OFFSET + S - 100 * MS


def test_event_times_on_ros_time_stay_as_they_are():
    clock = ClockMap(Timestamps.FUSED)
    clock.observe(OFFSET - 20 * MS, OFFSET)
    assert clock.to_ros(OFFSET) == OFFSET


@pytest.mark.parametrize("drift_ppm", [-100.0, 100.0])
def test_sensor_clock_that_was_set_from_the_host_is_followed_when_it_drifts(drift_ppm):
    clock = ClockMap(Timestamps.FUSED)
    for sensor, true, stamp in messages(np.random.default_rng(5), 300, drift_ppm):
        clock.observe(sensor, stamp - OFFSET)
        error = clock.to_ros(sensor) - (true - OFFSET)
        assert abs(error) < 3 * MS  # unfollowed it would grow to 30 ms
    assert clock.drift_ppm == pytest.approx(drift_ppm, abs=1.0)


def test_delay_of_events_on_ros_time_stays_out_of_their_stamps():
    clock = ClockMap(Timestamps.FUSED)
    for sensor, true, stamp in messages(np.random.default_rng(6), 120, 0.0):
        clock.observe(sensor, stamp - OFFSET + 20 * MS)
        assert clock.to_ros(sensor) == true - OFFSET


@pytest.mark.parametrize("few_first", [True, False])
def test_stamps_that_scatter_move_no_event_on_ros_time(few_first):
    """As of a stream whose stamps are the starts of periods, with few events and with many."""
    clock = ClockMap(Timestamps.FUSED)
    rng = np.random.default_rng(8)
    for k in range(12_000):
        start = 5 * S + k * 10 * MS
        first = start + int(rng.exponential(3 * MS if (k < 6000) is few_first else 0.001 * MS))
        clock.observe(first, start)
        assert clock.offset(first) == 0


def test_first_message_that_comes_late_does_not_decide_on_the_clock():
    clock = ClockMap(Timestamps.FUSED)
    clock.observe(4990 * MS, 4990 * MS + 1200 * MS)
    for sensor, _, stamp in messages(np.random.default_rng(7), 10, 0.0):
        clock.observe(sensor, stamp - OFFSET + 20 * MS)
    assert abs(clock.offset(sensor)) < 0.3 * MS  # the 20 ms are delay, as of any other message


def test_smallest_delay_counts_from_the_start():
    clock = ClockMap(Timestamps.FUSED)
    for k, delay in enumerate([8, 3, 5, 1, 9, 4]):
        clock.observe(k * 100 * MS, OFFSET + (k * 100 + delay) * MS)
    assert clock.offset(S) == OFFSET + MS


def test_before_any_message_time_is_unchanged():
    assert ClockMap(Timestamps.FUSED).to_ros(3) == 3


def test_reset_starts_anew():
    clock = ClockMap(Timestamps.FUSED)
    for sensor, _, stamp in messages(np.random.default_rng(3), 20, 100.0):
        clock.observe(sensor, stamp)
    assert clock.drift_ppm > 50
    clock.reset()
    assert clock.drift_ppm == 0
    clock.observe(S, 100 * S)
    assert clock.to_ros(2 * S) == 101 * S
