"""Where compiled code is kept: the first folder that can be written."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from emoflow_ros import compiled_code
from emoflow_ros.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
BESIDE_THE_SOURCES = compiled_code._BESIDE_THE_SOURCES


@pytest.fixture
def nowhere(tmp_path: Path) -> str:
    """A folder that cannot be made: the tests may run as root, who may write everywhere."""
    (tmp_path / "file").touch()
    return str(tmp_path / "file" / "folder")


@pytest.fixture(autouse=True)
def _folders(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """All of them within the test's folder; what a test sets in the environment is undone."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(compiled_code, "_BESIDE_THE_SOURCES", tmp_path / "sources" / "__pycache__")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")


def test_folder_of_the_sources_lies_beside_functions_that_are_compiled() -> None:
    beside = [source.read_text() for source in BESIDE_THE_SOURCES.parent.glob("*.py")]
    assert BESIDE_THE_SOURCES.name == "__pycache__"
    assert any("@njit" in text for text in beside)


def test_folder_of_the_sources_is_taken_without_a_word(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    compiled_code.choose_folder()
    assert os.environ["NUMBA_CACHE_DIR"] == ""
    assert compiled_code.folder() == tmp_path / "sources" / "__pycache__"
    assert capsys.readouterr().err == ""


def test_folder_of_the_user_s_cache_comes_next_in_one_line(
    tmp_path: Path,
    nowhere: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", nowhere)
    compiled_code.choose_folder()
    assert compiled_code.folder() == tmp_path / "cache" / "emoflow_ros"
    assert capsys.readouterr().err == (
        f"compiled code is kept in {tmp_path}/cache/emoflow_ros, "
        f"because of {nowhere}: not a directory\n"
    )


def test_folder_of_temporary_files_is_the_last_and_nobody_else_s(
    tmp_path: Path, nowhere: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, nowhere)
    compiled_code.choose_folder()
    found = compiled_code.folder()
    assert found == tmp_path / "temporary" / f"emoflow_ros_{os.getuid()}"
    assert stat.S_IMODE(found.stat().st_mode) == 0o700


@pytest.mark.parametrize("kind", ["writable by others", "link"])
def test_nothing_is_loaded_from_a_folder_that_others_can_fill(
    tmp_path: Path, nowhere: str, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    found = tmp_path / "temporary" / f"emoflow_ros_{os.getuid()}"
    if kind == "link":
        found.symlink_to(tmp_path)
    else:
        found.mkdir()
        found.chmod(0o777)
    for variable in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, nowhere)
    with pytest.raises(InputError) as caught:
        compiled_code.choose_folder()
    assert str(caught.value) == (
        f"compiled code: no folder to keep it in ({nowhere}: not a directory; "
        f"{nowhere}/emoflow_ros: not a directory; {found}: others can write it); "
        "set NUMBA_CACHE_DIR to a folder that can be written and has 32 MiB"
    )


def test_full_folder_is_left_unless_it_holds_compiled_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    sources = tmp_path / "sources" / "__pycache__"
    sources.mkdir(parents=True)
    (sources / "kernels.nbi").touch()
    monkeypatch.setattr("os.posix_fallocate", refuse)
    compiled_code.choose_folder()
    assert compiled_code.folder() == sources
    (sources / "kernels.nbi").unlink()
    with pytest.raises(InputError, match="__pycache__: no space left on device; "):
        compiled_code.choose_folder()


@pytest.mark.parametrize(
    ("call", "home"),
    [("cli import evaluate as main", "cache"), ("node.executable import main", "file/cache")],
)
def test_read_only_installation_starts_and_names_the_folder(
    tmp_path: Path, call: str, home: str
) -> None:
    """Files where folders of compiled code would be: not even root can write there."""
    if "node" in call:
        pytest.importorskip("rclpy", reason="no ROS: run `make test`")
    (tmp_path / "file").touch()
    for package in ("emoflow_ros", "msg_adapters"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
        for folder in [p for p in (tmp_path / package).rglob("*") if p.is_dir()]:
            (folder / "__pycache__").touch()
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(paths),
        "XDG_CACHE_HOME": str(tmp_path / home),
        "HOME": str(tmp_path / home),
        "TMPDIR": str(tmp_path / "temporary"),
    }
    del environment["NUMBA_CACHE_DIR"]
    code = f"import sys; from emoflow_ros.{call}; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, "--help"],
        env=environment, cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    temporary = tmp_path / "temporary" / f"emoflow_ros_{os.getuid()}"
    named = tmp_path / "cache" / "emoflow_ros" if home == "cache" else temporary
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith(f"compiled code is kept in {named}, because of ")
    assert [line for line in done.stderr.splitlines()[1:] if "matplotlib" not in line.lower()] == []
    assert done.stdout.startswith("usage: ")
