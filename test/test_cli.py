"""Executables whose output nobody reads to its end, as in `info BAG | head -1`."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from emoflow_ros.cli import EXIT_NO_READER, run
from emoflow_ros.errors import InputError

RUN = "import argparse, os, sys; from emoflow_ros.cli import run; sys.exit(run(lambda: {}))"


def start(*arguments, **options):
    """Start Python with its usual buffers, whatever the tests run with."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    environment = {**options.pop("env", os.environ), "PYTHONUNBUFFERED": ""}
    return subprocess.Popen([sys.executable, *map(str, arguments)], env=environment, **options)


def unread(*arguments, stream="stdout"):
    """Run with one stream a pipe without a reader; return the exit code and the other stream."""
    reader, writer = os.pipe()
    os.close(reader)
    with start(*arguments, **{stream: writer}) as process:
        os.close(writer)
        output = b"".join(filter(None, process.communicate()))
    return process.returncode, output


@pytest.mark.parametrize(
    "command",
    [
        "print('x' * 1_000_000)",  # fails in print
        "print('x')",  # fails when the buffer is written
        "print('x', flush=True)",
        "argparse.ArgumentParser(prog='x').parse_args(['--help'])",
    ],
)
def test_output_that_nobody_reads_ends_a_command_without_a_word(command):
    assert unread("-c", RUN.format(command)) == (EXIT_NO_READER, b"")


def test_progress_that_nobody_reads_ends_a_command_too():
    command = RUN.format("[print('before'), print('x', file=sys.stderr), print('after')]")
    assert unread("-c", command, stream="stderr") == (EXIT_NO_READER, b"before\n")


@pytest.mark.parametrize("limit_mib", [250, 400])
def test_limit_of_memory_that_is_too_low_is_one_line(limit_mib, tmp_path):
    """Libraries cannot be loaded, or modules not be imported."""
    code = (
        "import resource, sys; from emoflow_ros.cli import evaluate; "
        f"resource.setrlimit(resource.RLIMIT_AS, ({limit_mib << 20},) * 2); sys.exit(evaluate())"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    with start("-c", code, "--help", env=environment) as process:
        output, error = process.communicate()
    assert (process.returncode, output) == (2, b"")
    assert error.decode().splitlines()[0] == (
        f"error: memory: {limit_mib} MiB of address space (ulimit -v) are not enough; "
        "remove the limit, or raise it to 2048 MiB"
    )
    assert b"Traceback" not in error


def test_want_of_memory_is_one_line_and_any_other_error_keeps_its_traceback(capfd):
    def fail(error):
        raise error

    assert run(lambda: fail(MemoryError())) == 2
    assert capfd.readouterr().err == "error: memory: there is not enough; free some\n"
    with pytest.raises(OSError, match="no such device"):
        run(lambda: fail(OSError("no such device")))


def test_a_broken_pipe_of_the_commands_own_keeps_its_traceback():
    """Also where its output is buffered: only a stream without a reader is silent."""
    command = "[print('before'), (ends := os.pipe()), os.close(ends[0]), os.write(ends[1], b'x')]"
    with start("-c", RUN.format(command)) as process:
        output, error = process.communicate()
    assert process.returncode == 1
    assert output == b"before\n"
    assert error.startswith(b"Traceback") and b"BrokenPipeError" in error


def test_a_closed_standard_output_is_no_error():
    process = start("-c", RUN.format("print('x')"), preexec_fn=lambda: os.close(1), stdout=None)
    with process:
        assert process.communicate()[1] == b""
    assert process.returncode == 0


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_info_without_a_reader(tmp_path, options):
    path = tmp_path / "a.npz"
    np.savez(path, x=[1, 2], y=[1, 2], p=[0, 1], t=[0.0, 0.5])
    assert unread("-m", "emoflow_ros.commands.info", *options, path) == (EXIT_NO_READER, b"")


def test_bad_input_is_told_from_process_to_process():
    error = pickle.loads(pickle.dumps(InputError(Path("a/b.bag"), "is cut off", "record it again")))
    assert type(error) is InputError
    assert str(error) == "a/b.bag: is cut off; record it again"
