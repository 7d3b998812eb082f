"""Options of `label` that are refused before a recording is opened."""

import pytest

from emoflow_ros.commands import label as label_command


def call(monkeypatch, out, *arguments):
    monkeypatch.setattr("sys.argv", ["label", *map(str, arguments), "--out", str(out)])
    return label_command.main()


def assert_line(monkeypatch, capsys, arguments, words):
    assert call(monkeypatch, *arguments) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("error: ")]
    assert words in line


def test_without_ray_one_line_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    arguments = (tmp_path / "out", tmp_path / "a", "--ray", "local")
    assert_line(monkeypatch, capsys, arguments, "Ray is not installed; run 'pip install ray'")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--workers", "2"), "--workers: there are none without --ray"),
        (("--set", "window.count=1000"), "window.count: chunks of time need windows by time"),
        (("--profile", "fast"), "unknown profile 'fast'"),
    ],
)
def test_bad_options(monkeypatch, tmp_path, capsys, options, words):
    assert_line(monkeypatch, capsys, (tmp_path / "out", tmp_path / "a", *options), words)


def test_equal_names(monkeypatch, tmp_path, capsys):
    arguments = (tmp_path / "out", tmp_path / "a", tmp_path / "x" / "a")
    assert_line(monkeypatch, capsys, arguments, "labels of 2 recordings")


@pytest.mark.parametrize("value", ["-1", "nan", "long"])
def test_lengths_of_time_are_numbers(monkeypatch, tmp_path, capsys, value):
    with pytest.raises(SystemExit):
        call(monkeypatch, tmp_path / "out", tmp_path / "a", f"--margin-s={value}")
    assert "not a number of seconds" in capsys.readouterr().err
