"""The command `label`: flow labels of whole data sets, for training.

This process does the work, or the workers of a Ray cluster do it.
"""

import argparse
import math
import os
import sys
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from emoflow_ros import cli
from emoflow_ros.config import Config, load_config
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.benchmark_sequences import find_sequence
from emoflow_ros.evaluation.recording_options import (
    Source,
    add_configuration_options,
    add_recording_options,
    make_folder,
    overrides,
    positive,
    positive_number,
)
from emoflow_ros.labels.label_chunks import Job, label_chunk
from emoflow_ros.labels.label_run import JobRunner, Settings, label_all
from emoflow_ros.readers.column_arguments import column_options

LOCAL = "local"
_RETRIES = 3  # of a job whose worker died
_OBJECT_STORE = 80 << 20  # bytes, the least that Ray takes: jobs read and write files

_EXIT_SOME_FAILED = 1
_EPILOG = """\
examples:
  label recording.bag --calib camera.yaml --out labels
  label mvsec/*_data.bag --sequence indoor_flying1 --out labels --ray local
  label dsec/train/* --out labels --ray 10.0.0.1:6379 --workers 64 --resume

writes DIR/<name of INPUT>.h5 per recording (docs/labels.md).
exit codes: 0 done, 1 some recordings could not be labelled or have no window with an estimate (they
are listed), 2 bad input, 130 interrupted (finished chunks are kept: the same command with --resume
continues), 141 nobody reads the output.
"""


def main() -> int:
    """Entry point."""
    return cli.run(lambda: _run(parse(sys.argv[1:])))


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line of `label`, without its name."""
    parser = argparse.ArgumentParser(
        prog="label",
        description="Estimate dense optical flow and egomotion of many recordings, chunk by chunk "
        "of time, as labels for training; on one machine or on a Ray cluster.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "inputs",
        type=Path,
        nargs="+",
        metavar="INPUT",
        help="recordings of any format that `evaluate` reads",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the label files")
    add_recording_options(parser)
    add_configuration_options(parser)
    add(
        "--chunk-s",
        type=positive_number,
        default=30.0,
        metavar="S",
        help="length of a chunk of time, which one worker labels (default: 30)",
    )
    add(
        "--margin-s",
        type=_seconds,
        default=1.0,
        metavar="S",
        help="what is estimated before each chunk to warm up, and not written (default: 1)",
    )
    add(
        "--ray",
        metavar="ADDRESS",
        help=f"label on the Ray cluster at host:port; '{LOCAL}' starts one on this machine "
        "(default: in this process)",
    )
    add(
        "--workers",
        type=positive,
        metavar="N",
        help="with --ray: chunks at once, one thread each (default: the cluster's cores)",
    )
    add("--resume", action="store_true", help="leave out the chunks that an earlier run finished")
    return parser.parse_args(arguments)


def _run(options: argparse.Namespace) -> int:
    config = load_config(options.profile, overrides(options))
    _check(options, config)
    sequence = find_sequence(options.sequence) if options.sequence else None
    columns = column_options(options)
    sources = [
        Source(path, options.topic, options.calib, sequence, columns) for path in options.inputs
    ]
    settings = Settings(config, options.chunk_s, options.margin_s, options.out, options.resume)
    _refuse_equal_names([settings.target(source) for source in sources])
    make_folder(options.out)
    workers = ray_workers(options.ray, options.workers) if options.ray else nullcontext(run_here)
    try:
        with workers as run:
            plans = label_all(sources, settings, run)
    except KeyboardInterrupt:
        print("interrupted; the same command with --resume continues", file=sys.stderr)
        return cli.EXIT_INTERRUPTED
    failed = [plan for plan in plans if plan.error]
    if failed:
        print(f"{len(failed)} of {len(plans)} recordings could not be labelled:", file=sys.stderr)
        for plan in failed:
            name = f"{plan.source.path}: "
            print(f"  {name}{plan.error.removeprefix(name)}", file=sys.stderr)
    return _EXIT_SOME_FAILED if failed else 0


def _check(options: argparse.Namespace, config: Config) -> None:
    if config.window.count:
        raise InputError(
            "window.count", "chunks of time need windows by time", "leave window.count at 0"
        )
    if config.imu.use != "off":
        raise InputError("imu.use", "labels are made without a gyro", "leave it off")
    if options.workers and not options.ray:
        raise InputError("--workers", "there are none without --ray", "give --ray local")


def _refuse_equal_names(targets: Sequence[Path]) -> None:
    target, times = Counter(targets).most_common(1)[0]
    if times > 1:
        raise InputError(
            target, f"would be the labels of {times} recordings", "label them into several --out"
        )


def _seconds(text: str) -> float:
    """Parse a length of time of at least 0, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds")
    return value


def run_here(jobs: Iterable[Job]) -> Iterator[tuple[Job, str]]:
    """Do one job after the other in this process."""
    return ((job, label_chunk(job)) for job in jobs)


@contextmanager
def ray_workers(address: str, count: int | None) -> Generator[JobRunner]:
    """Connect to a Ray cluster.

    A job whose worker dies is done again by another one, up to 3 times.

    Args:
        address: of a running cluster, or `local` to start one on this machine for this run.
        count: jobs at once; None for as many as there are cores.

    Raises:
        InputError: Ray is not installed, or there is no cluster at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray = import_module("ray")
    except ImportError:
        raise InputError("--ray", "Ray is not installed", "run 'pip install ray'") from None
    start: dict[str, Any] = {}
    if address == LOCAL:
        start = {
            "num_cpus": count,
            "include_dashboard": False,
            "object_store_memory": _OBJECT_STORE,
        }
    try:
        ray.init(address, logging_level="ERROR", **start)
    except (ConnectionError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(
            f"--ray {address}", f"no cluster ({reason})", "give host:port of one, or local"
        ) from None
    try:
        yield _RayRun(ray, count or int(ray.cluster_resources()["CPU"]))
    finally:
        ray.shutdown()


class _RayRun:
    """Keeps as many jobs in flight as wanted."""

    def __init__(self, ray: Any, count: int) -> None:
        self._ray = ray
        self._count = count
        self._label = ray.remote(max_retries=_RETRIES)(label_chunk)

    def __call__(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, str]]:
        waiting = iter(jobs)
        flying = {self._label.remote(job): job for job in islice(waiting, self._count)}
        while flying:
            (done,), _ = self._ray.wait(list(flying))
            yield flying.pop(done), self._result(done)
            flying |= {self._label.remote(job): job for job in islice(waiting, 1)}

    def _result(self, done: Any) -> str:
        try:
            return str(self._ray.get(done))
        except self._ray.exceptions.RayError as error:
            return f"the worker was lost ({' '.join(str(error).split())})"


if __name__ == "__main__":
    sys.exit(main())
