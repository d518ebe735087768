"""Run chunks on a Dask cluster, local or at a scheduler address (`pip install "optlink[dask]"`).

The local cluster opens no network port: scheduler and workers are threads of this process (`inproc://`), each worker
passes its chunks through a pipe to a process of its own, and there is neither a dashboard nor any other HTTP server.
"""

import contextlib
import itertools
import queue
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from typing import Any

from optlink.errors import InputError, SolverError
from optlink.execution.process import Process
from optlink.execution.worker import ChunkResult, ChunkTask, Runs, packed, run_chunk

PATIENCE = 10  # s, time limit for the scheduler and for a first worker
AHEAD = 3  # chunks queued per worker
LOCAL = "a cluster of this machine"
QUIET = {"distributed.admin.tick.interval": "1s", "distributed.worker.profile.enabled": False}
"""Settings of a cluster of this machine. By default Dask observes itself 20 to 100 times a second, which slows the chunks."""


def import_dask() -> tuple[Any, Any]:
    """Return the packages dask and distributed.

    Raises
    ------
    InputError
        If Dask is not installed.
    """
    try:
        import dask
        import distributed
    except ImportError:
        remedy = 'Install it: pip install "optlink[dask]", or use --engine local'
        raise InputError("Dask is not installed", remedy, key="--engine", value="dask") from None
    return dask, distributed


@contextlib.contextmanager
def cluster(workers: int, scheduler: str | None, patience: float = PATIENCE) -> Iterator[Runs]:
    """Provide a cluster as `optlink.execution.runner.pool`; it repeats a chunk on another worker if its worker dies.

    `patience` [s] is the time limit for the answer of the scheduler and for a first worker.

    Raises
    ------
    InputError
        If Dask is not installed, or no scheduler or worker answers.
    SolverError
        If the scheduler stops answering, or a chunk ends several workers.
    """
    dask, distributed = import_dask()
    with contextlib.ExitStack() as stack:
        stack.enter_context(distributed.utils.silence_logging_cmgr("CRITICAL"))
        where: Any = scheduler
        if scheduler is None:
            stack.enter_context(dask.config.set(QUIET))
            where = stack.enter_context(_local_cluster(distributed, workers))
        with _answering(scheduler):
            client = stack.enter_context(_client(distributed, where, scheduler, patience))
        processes = None if scheduler else stack.enter_context(_own_processes(workers))

        def answers(task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
            with _answering(scheduler):
                yield from _gathered(distributed, client, task, iter(todo), processes)

        yield answers


@contextlib.contextmanager
def _answering(scheduler: str | None) -> Iterator[None]:
    """Report a scheduler that stops answering."""
    try:
        yield
    except (OSError, TimeoutError, CancelledError):
        raise SolverError(
            f"the Dask scheduler {scheduler or LOCAL} did not answer before all chunks were complete. Restart it and "
            "repeat the command with --resume and the same --out DIR: completed chunks are kept there"
        ) from None


def _local_cluster(distributed: Any, workers: int) -> Any:
    """Return a scheduler and workers in this process without HTTP servers, which Dask starts even without a dashboard."""

    class Scheduler(distributed.Scheduler):  # type: ignore[misc]
        def start_http_server(self, *args: Any, **kwargs: Any) -> None:
            """Open no port."""

    class Worker(distributed.Worker):  # type: ignore[misc]
        def start_http_server(self, *args: Any, **kwargs: Any) -> None:
            """Open no port."""

    common = {"protocol": "inproc://", "dashboard": False}
    specs = {number: {"cls": Worker, "options": {**common, "nthreads": 1, "memory_limit": 0}} for number in range(workers)}
    return distributed.SpecCluster(specs, {"cls": Scheduler, "options": common})


class _Processes:
    """Processes to which the workers of a cluster of this machine pass their chunks."""

    def __init__(self, count: int) -> None:
        self.all = [Process() for _ in range(count)]
        self.idle: queue.SimpleQueue[Process] = queue.SimpleQueue()
        for process in self.all:
            self.idle.put(process)
        self.stopped = threading.Event()
        self.task = b""


_LOCAL_CLUSTERS: dict[int, _Processes] = {}
"""Processes by number; a message of Dask contains the number, because it cannot contain the processes."""


@contextlib.contextmanager
def _own_processes(count: int) -> Iterator[int]:
    """Provide processes, by their number in `_LOCAL_CLUSTERS`."""
    processes = _Processes(count)
    _LOCAL_CLUSTERS[id(processes)] = processes
    try:
        yield id(processes)
    finally:
        processes.stopped.set()
        for process in processes.all:
            process.kill()
        for process in processes.all:
            process.end()
        del _LOCAL_CLUSTERS[id(processes)]


def _pass_on(cluster_number: int, index: int) -> ChunkResult:
    """Run a chunk of the present task in a process of this machine."""
    processes = _LOCAL_CLUSTERS[cluster_number]
    process = processes.idle.get()
    try:
        return process.result(processes.task, index, processes.stopped)
    finally:
        processes.idle.put(process)


def _client(distributed: Any, where: Any, scheduler: str | None, patience: float) -> Any:
    place: Any = {"key": "--scheduler", "value": scheduler or LOCAL}
    try:
        client = distributed.Client(where, timeout=patience, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        start = "Start one (dask scheduler; dask worker ADDRESS), check address and port, or leave --scheduler out"
        why = "" if isinstance(error, OSError) else f": {error}"
        message = f"no scheduler answers there within {patience:g} s{why}"
        raise InputError(message, start, **place) from None
    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError:
        client.close()
        raise InputError("the scheduler has no workers", "Start one: dask worker ADDRESS", **place) from None
    return client


def _gathered(
    distributed: Any, client: Any, task: ChunkTask, todo: Iterator[int], cluster_number: int | None
) -> Iterator[tuple[int, ChunkResult]]:
    numbers: dict[Any, int] = {}
    if cluster_number is not None:
        _LOCAL_CLUSTERS[cluster_number].task = packed(task)

    def ask(index: int) -> Any:
        work = (run_chunk, task) if cluster_number is None else (_pass_on, cluster_number)
        future = client.submit(*work, index, pure=False, retries=2 if cluster_number is None else 0)
        numbers[future.key] = index
        return future

    places = max(1, sum(client.nthreads().values()))
    ready = distributed.as_completed([ask(i) for i in itertools.islice(todo, AHEAD * places)], loop=client.loop)
    for future in ready:
        index = numbers.pop(future.key)
        try:
            answer: ChunkResult = future.result()
        except distributed.scheduler.KilledWorker:
            raise SolverError(f"chunk {index} of the study terminated several workers; check their memory") from None
        for following in itertools.islice(todo, 1):
            ready.add(ask(following))
        yield index, ChunkResult(*answer).checked(index)
