"""Chunks of a study on a Dask cluster: one of this machine, or one whose scheduler is named (`pip install "optlink[dask]"`)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

from optlink.errors import Fault, InputError, SolverError
from optlink.studies.worker import Answer, Task, perform

PATIENCE = 10  # s, for a scheduler to answer and for a first worker
AHEAD = 3  # chunks that wait at every worker
LOCAL = "a cluster of this machine"
QUIET = {
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.worker.profile.enabled": False,
}
"""Settings of a cluster of this machine. By default a worker looks after itself 20 to 100 times a second, each time taking the
interpreter from the chunk that it computes: 8 % of its time."""


def installed() -> tuple[Any, Any]:
    """The packages dask and distributed.

    Raises
    ------
    InputError
    """
    try:
        import dask
        import distributed
    except ImportError:
        remedy = 'Install it: pip install "optlink[dask]", or use --engine local'
        raise InputError(Fault("Dask is not installed", remedy, key="--engine", value="dask")) from None
    return dask, distributed


def on_cluster(
    task: Task, todo: Iterable[int], workers: int, scheduler: str | None, patience: float = PATIENCE
) -> Iterator[tuple[int, Answer]]:
    """As `optlink.studies.engine.run`; a chunk whose worker dies is done again on another one."""
    dask, distributed = installed()
    cluster = None
    if scheduler is None:
        with dask.config.set(QUIET):
            cluster = distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs="CRITICAL"
            )
    try:
        client = _client(distributed, cluster or scheduler, scheduler, patience)
        try:
            yield from _gathered(distributed, client, task, iter(todo))
        finally:
            client.close()
    finally:
        if cluster is not None:
            cluster.close()


def _client(distributed: Any, where: Any, scheduler: str | None, patience: float) -> Any:
    try:
        client = distributed.Client(where, timeout=patience, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        start = "Start one (dask scheduler; dask worker ADDRESS), check address and port, or leave --scheduler out"
        why = "" if isinstance(error, OSError) else f": {error}"
        message = f"no scheduler answers there within {patience:g} s{why}"
        raise InputError(Fault(message, start, key="--scheduler", value=scheduler or LOCAL)) from None
    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError:
        client.close()
        remedy = "Start one: dask worker ADDRESS"
        raise InputError(Fault("the scheduler has no workers", remedy, key="--scheduler", value=scheduler or LOCAL)) from None
    return client


def _gathered(distributed: Any, client: Any, task: Task, todo: Iterator[int]) -> Iterator[tuple[int, Answer]]:
    numbers: dict[Any, int] = {}

    def ask(index: int) -> Any:
        future = client.submit(perform, task, index, pure=False, retries=2)
        numbers[future.key] = index
        return future

    places = max(1, sum(client.nthreads().values()))
    ready = distributed.as_completed([ask(i) for i in itertools.islice(todo, AHEAD * places)], loop=client.loop)
    for future in ready:
        index = numbers.pop(future.key)
        try:
            answer: Answer = future.result()
        except distributed.scheduler.KilledWorker:
            raise SolverError(f"chunk {index} of the study ended several workers; have they enough memory?") from None
        for following in itertools.islice(todo, 1):
            ready.add(ask(following))
        yield index, Answer(*answer).checked(index)
