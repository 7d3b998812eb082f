"""Text files of events: comments, blank lines, any order of columns and any unit of time."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from column_files import steady_events, write_text
from event_bags import assert_equal

from emoflow_ros.cli import EXIT_BAD_INPUT
from emoflow_ros.cli import evaluate as evaluate_command
from emoflow_ros.cli import info as info_command
from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.column_layout import ColumnOptions

N = 3000


@pytest.fixture
def events() -> Events:
    """3000 events at 330 000 per second from 2 s on, times in whole microseconds."""
    return steady_events(N)


def read_all(path, since=None, **options):
    with open_recording(path, columns=ColumnOptions(**options)) as recording:
        return Events.concatenate(list(recording.event_chunks(since)))


@pytest.mark.parametrize("unit", ["s", "us", "ns"])
@pytest.mark.parametrize("layout", ["txyp", "xytp", "xypt", "tpxy", "pxyt"])
@pytest.mark.parametrize("off", [0, -1])
def test_order_and_unit_are_told_and_said(tmp_path, events, layout, unit, off, capsys):
    path = write_text(tmp_path / "events.txt", events, layout, unit, off)
    assert_equal(read_all(path), events)
    words = {"s": "seconds", "us": "microseconds", "ns": "nanoseconds"}[unit]
    told = [f"columns are taken as {' '.join(layout)}"] if layout != "txyp" else []
    options = "--layout and --time-unit say" if told else "--time-unit says"
    told += [f"t is taken as {words}, 330000 events per second"] if told or unit != "s" else []
    line = f"{path}: {', '.join(told)}; {options} otherwise\n" if told else ""
    assert capsys.readouterr().err == line


def test_milliseconds(tmp_path, events, capsys):
    assert_equal(read_all(write_text(tmp_path / "a.txt", events, unit="ms")), events)
    assert "t is taken as milliseconds, 330000 events per second" in capsys.readouterr().err


def test_microseconds_from_zero_on(tmp_path, events):
    from_zero = Events(events.x, events.y, events.t - events.t[0], events.p)
    assert_equal(read_all(write_text(tmp_path / "events.txt", from_zero, unit="us")), from_zero)


@pytest.mark.parametrize(
    "changes",
    [
        {"first": "# made by a simulator (µs)\n"},
        {"first": "% a comment\n\n// and another\n"},
        {"first": "\ufeff"},
        {"last": "\n"},
        {"last": "   \n\n# end\n"},
        {"between": "# in the middle"},
        {"between": "\n"},
        {"first": "346 260\n"},
        {"first": "t x y p\n"},
        {"first": "timestamp_us,x,y,polarity\n"},
    ],
)
@pytest.mark.parametrize("chunk", [4 << 20, 1000])
def test_lines_that_are_no_rows_are_skipped(tmp_path, events, changes, chunk, monkeypatch):
    monkeypatch.setattr("emoflow_ros.readers.ecd._CHUNK_BYTES", chunk)
    path = write_text(tmp_path / "events.txt", events, **changes)
    assert_equal(read_all(path), events)
    assert_equal(read_all(path, int(events.t[1501])), events[1501:])
    with open_recording(path) as recording:
        assert recording.duration == pytest.approx((N - 1) * 3e-6)
        assert recording.size == ((346, 260) if changes.get("first") == "346 260\n" else (0, 0))


def test_a_line_of_names_orders_the_columns(tmp_path, events):
    path = write_text(tmp_path / "a.csv", events, "pytx", "us", first="polarity,y,ts,x\n")
    path.write_text(path.read_text().replace(" ", ","))
    assert_equal(read_all(path), events)


def test_the_index_that_pandas_writes_is_skipped(tmp_path, events):
    path = write_text(tmp_path / "a.csv", events, "txyp", "us", first="")
    rows = path.read_text().replace(" ", ",").splitlines()
    path.write_text(",t,x,y,p\n" + "".join(f"{k},{row}\n" for k, row in enumerate(rows)))
    assert_equal(read_all(path), events)


def test_what_the_user_says_counts(tmp_path, events):
    path = write_text(tmp_path / "events.txt", events, "xytp", "us")
    swapped = read_all(path, layout="yxtp", time_unit="ns")
    assert_equal(swapped, Events(events.y, events.x, events.t // 1000, events.p))
    text = path.read_text().replace("\n", " 7\n")
    path.write_text(text)
    assert_equal(read_all(path, layout="xytp-"), events)
    with pytest.raises(InputError) as error:
        read_all(path)
    assert str(error.value) == (
        f"{path}: lines of 5 numbers; a line is 't x y p'; name other columns with --layout"
    )
    with pytest.raises(InputError, match="lines of 5 numbers with the layout 'xytp'"):
        read_all(path, layout="xytp")


def test_implausible_columns_are_refused_with_what_was_found(tmp_path):
    path = tmp_path / "events.txt"
    path.write_text("".join(f"{k} {k % 7} {k % 5} 3\n" for k in range(2000)))
    with pytest.raises(InputError) as error:
        read_all(path)
    assert str(error.value) == (
        f"{path}: its columns (0 to 1999, 0 to 6, 0 to 4, 3 to 3) are not events: time that grows, "
        "pixels and polarity; say which column is which with --layout, for example xytp"
    )


def test_implausible_rates_are_refused_with_what_was_found(tmp_path):
    path = tmp_path / "events.txt"
    path.write_text("".join(f"{k * 7 + 0.25} {k % 7} {k % 5} {k % 2}\n" for k in range(2000)))
    assert read_all(path).t[1] == 7_250  # microseconds: 0.14 a second are no seconds ...
    path.write_text("".join(f"{k * 7e6 + 0.25} {k % 7} {k % 5} {k % 2}\n" for k in range(2000)))
    with pytest.raises(InputError) as error:  # ... and 2000 events over 14e9 fit nothing
        read_all(path)
    assert "the unit of t cannot be told: 2040 events are" in str(error.value)
    assert str(error.value).endswith("say which unit t has with --time-unit s, ms, us or ns")


@pytest.mark.parametrize(
    ("name", "first", "last", "count"),
    [
        ("comment", 0, 1_000_000, 2),
        ("blank_end", 0, 1_000_000, 2),
        ("us", 57_922_807_588_000, 57_922_807_600_000, 2),
        ("us0", 0, 1_000_000_000, 2),
        ("xypt", 57_922_807_588_000, 57_922_807_589_000, 2),
    ],
)
def test_small_files_of_the_field(shared_data, name, first, last, count):
    folder = shared_data / "field" / "text" / name
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    read = read_all(folder)
    assert (len(read), read.t[0], read.t[-1]) == (count, first, last)
    assert read.p.tolist() == [True, False]


def run(monkeypatch, command, *arguments):
    monkeypatch.setattr("sys.argv", ["command", *map(str, arguments)])
    return command()


def test_commands_take_the_options(tmp_path, events, monkeypatch, capsys):
    path = write_text(tmp_path / "events.txt", events, "xytp", "us")
    options = ("--layout", "y,x,t,p", "--time-unit", "ns")
    assert run(monkeypatch, info_command, path, "--json", *options) == 0
    said = capsys.readouterr()
    [topic] = json.loads(said.out)["topics"]
    assert topic["encoding"] == "y x t p, t in ns"
    assert topic["t_last"] - topic["t_first"] == pytest.approx(8.997e-6)
    assert said.err == ""
    with pytest.raises(SystemExit):
        run(monkeypatch, info_command, path, "--layout", "xyt")
    assert "does not name x, y, t and p once each" in capsys.readouterr().err


def test_options_that_a_format_has_no_use_for_are_refused(
    tmp_path, events, monkeypatch, capsys, write_event_bag
):
    bag = write_event_bag(tmp_path / "a.bag", [events[:10]], size=(346, 260))
    for command in (info_command, evaluate_command):
        assert run(monkeypatch, command, bag, "--time-unit", "us") == EXIT_BAD_INPUT
        line = f"error: --time-unit: the format of {bag} says it; leave the option out\n"
        assert capsys.readouterr().err == line


def test_short_run_of_make_fuzz():
    script = Path(__file__).parent / "fuzz_columns.py"
    command = [sys.executable, script, "--runs", "40", "--seed", "3"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-3000:]
    assert ran.stdout == "== columns: 40 files, all read\n"


@pytest.mark.parametrize("shift_ns", [100_000, 23 * 10**9 + 7000, 10**18])
def test_a_shift_of_the_clock_changes_nothing_else(tmp_path, events, shift_ns):
    """Also of seconds as numbers with decimals, which resolve 0.1 us after 10^9 s."""
    moved = Events(events.x, events.y, events.t + shift_ns, events.p)
    digits = write_text(tmp_path / "events.txt", moved)
    rows = [f"{t // 10**9}.{t % 10**9:09d} {x} {y} {int(p)}\n" for x, y, t, p in columns_of(moved)]
    digits.write_text("".join(rows))
    assert_equal(read_all(digits), moved)


def columns_of(events):
    return zip(*(c.tolist() for c in (events.x, events.y, events.t, events.p)), strict=True)


def test_whole_numbers_with_a_point_are_seconds(tmp_path):
    (tmp_path / "events.txt").write_text("1.0 1 1 1\n2.0 2 2 0\n")
    assert read_all(tmp_path).t.tolist() == [10**9, 2 * 10**9]
    (tmp_path / "events.txt").write_text("1 1 1 1\n2 2 2 0\n")
    assert read_all(tmp_path).t.tolist() == [1000, 2000]
