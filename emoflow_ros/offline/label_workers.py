"""Who does the jobs of `label`: this process, or the workers of a Ray cluster."""

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import islice
from typing import Any

from emoflow_ros.errors import InputError
from emoflow_ros.offline.label_chunks import Job, label_chunk

# Does the jobs and yields each with what `label_chunk` returned, in the order of completion.
Run = Callable[[Iterable[Job]], Iterator[tuple[Job, str]]]

LOCAL = "local"
_RETRIES = 3  # of a job whose worker died
_OBJECT_STORE = 80 << 20  # bytes, the least that Ray takes: jobs read and write files


def run_here(jobs: Iterable[Job]) -> Iterator[tuple[Job, str]]:
    """Do one job after the other in this process."""
    return ((job, label_chunk(job)) for job in jobs)


@contextmanager
def ray_workers(address: str, count: int | None) -> Generator[Run]:
    """Connect to a Ray cluster.

    A job whose worker dies is done again by another one, up to 3 times.

    Args:
        address: of a running cluster, or `local` to start one on this machine for the time being.
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
