"""Run chunks of a study on a Dask cluster, local or at a scheduler address (`pip install "optlink[dask]"`).

The local cluster opens no network port: scheduler and workers are threads of this process (`inproc://`), each worker
passes its chunks through a pipe to a process of its own, and there is neither a dashboard nor any other HTTP server.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from optlink.errors import Fault, InputError, SolverError
from optlink.studies.execution.worker import ONE_THREAD, ChunkResult, ChunkTask, run_chunk

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
        raise InputError(Fault("Dask is not installed", remedy, key="--engine", value="dask")) from None
    return dask, distributed


def on_cluster(
    task: ChunkTask, todo: Iterable[int], workers: int, scheduler: str | None, patience: float = PATIENCE
) -> Iterator[tuple[int, ChunkResult]]:
    """Run chunks as `optlink.studies.execution.runner.run`; repeat a chunk on another worker if its worker dies.

    Parameters
    ----------
    task : ChunkTask
    todo : iterable of int
        Numbers of chunks.
    workers : int
        Number of workers of a local cluster.
    scheduler : str, optional
        Address of a Dask scheduler. Default: a local cluster.
    patience : float [s]
        Time limit for the answer of the scheduler and for a first worker.

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
            stack.enter_context(_environment(ONE_THREAD))
            where = stack.enter_context(_local_cluster(distributed, workers))
        try:
            client = stack.enter_context(_client(distributed, where, scheduler, patience))
            yield from _gathered(distributed, client, task, iter(todo))
        except (OSError, TimeoutError, CancelledError):
            raise SolverError(
                f"the Dask scheduler {scheduler or LOCAL} stopped answering before all chunks were done. Start it again and "
                "repeat the command with --resume and the same --out DIR: the chunks done so far are kept there"
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
    specs = {
        number: {"cls": Worker, "options": {**common, "nthreads": 1, "memory_limit": 0, "executor": ProcessExecutor()}}
        for number in range(workers)
    }
    return distributed.SpecCluster(specs, {"cls": Scheduler, "options": common})


class ProcessExecutor(ThreadPoolExecutor):
    """Executor that runs functions one at a time in a separate process, and in a new one if that dies, without a network port.

    Raises
    ------
    BrokenProcessPool
        By the future of the function during which the process died.
    """

    def __init__(self) -> None:
        super().__init__(1)
        self._process: SpawnProcess | None = None

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a function in the process.

        Parameters
        ----------
        function : callable
            Must be picklable, as must its arguments and its result.
        *args, **kwargs
            Arguments of the function.
        """
        return super().submit(self._run, function, args, kwargs)

    def _run(self, *job: Any) -> Any:
        if self._process is None:
            spawn = multiprocessing.get_context("spawn")
            self._pipe, end = spawn.Pipe()
            self._process = spawn.Process(target=_serve, args=(end,), daemon=True)
            self._process.start()
            end.close()
        try:
            self._pipe.send(job)
            return self._pipe.recv()
        except (EOFError, OSError):
            self._end()
            self._process = None
            self._pipe.close()
            raise BrokenProcessPool("the process of a worker ended unexpectedly") from None

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """Kill the process at once.

        Parameters
        ----------
        wait : bool
            Whether to wait for the thread of the executor.
        cancel_futures : bool
            Whether to cancel pending functions.
        """
        self._end()
        super().shutdown(wait, cancel_futures=cancel_futures)

    def _end(self) -> None:
        process = self._process
        if process is not None:
            process.kill()
            process.join()


def _serve(pipe: Connection) -> None:
    """Run the functions received through a pipe until it closes; Ctrl-C is handled by the parent process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(EOFError, OSError):
        while True:
            function, args, kwargs = pipe.recv()
            pipe.send(function(*args, **kwargs))


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set environment variables for processes that start meanwhile."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


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


def _gathered(distributed: Any, client: Any, task: ChunkTask, todo: Iterator[int]) -> Iterator[tuple[int, ChunkResult]]:
    numbers: dict[Any, int] = {}

    def ask(index: int) -> Any:
        future = client.submit(run_chunk, task, index, pure=False, retries=2)
        numbers[future.key] = index
        return future

    places = max(1, sum(client.nthreads().values()))
    ready = distributed.as_completed([ask(i) for i in itertools.islice(todo, AHEAD * places)], loop=client.loop)
    for future in ready:
        index = numbers.pop(future.key)
        try:
            answer: ChunkResult = future.result()
        except (distributed.scheduler.KilledWorker, BrokenProcessPool):
            raise SolverError(f"chunk {index} of the study ended several workers; have they enough memory?") from None
        for following in itertools.islice(todo, 1):
            ready.add(ask(following))
        yield index, ChunkResult(*answer).checked(index)
