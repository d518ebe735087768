"""Run independent chunks of work in local processes or on a Dask cluster, with identical results.

A task (`optlink.execution.worker.ChunkTask`) maps the number of a chunk to its result, which depends on nothing else. Results
arrive in any order. Every engine is an executor as of `concurrent.futures`: `optlink.execution.worker.Processes`, or that of a
Dask client (the extra `dask`). A Dask cluster of this machine opens no network port: scheduler and workers are
threads of this process (`inproc://`), each worker has a process of its own, and there is neither a dashboard nor another server.
"""

import contextlib
import itertools
import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from typing import Any

from optlink.errors import InputError, SolverError, extra_remedy
from optlink.execution import interrupts
from optlink.execution.options import Execution
from optlink.execution.worker import ATTEMPTS, ChunkResult, ChunkTask, Processes, Runs, packed, run_chunk, run_packed
from optlink.problem.file import ProblemFile
from optlink.problem.own_terms import OWN
from optlink.problem.quantity import check_choice

ENGINES = ("local", "dask")
WAIT = 0.2  # s, turns of waiting: Windows passes no Ctrl-C to a thread that waits without end
MAX_WORKERS = 1024
PATIENCE = 10  # s, time limit for a scheduler and for its first worker
AHEAD = 3  # chunks queued per worker
LOCAL = "a cluster of this machine"
QUIET = {"distributed.admin.tick.interval": "1s", "distributed.worker.profile.enabled": False}
"""Settings of a cluster of this machine. By default Dask observes itself 20 to 100 times a second, which slows the chunks."""


def cores() -> int:
    """Return the number of processor cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def alone(engine: str = "local", workers: int | None = None, scheduler: str | None = None) -> bool:
    """Return whether the present process does all the work; the options are those of `pool`."""
    return engine == "local" and (workers or cores()) == 1


def check(engine: str = "local", workers: int | None = None, scheduler: str | None = None) -> None:
    """Check the execution options; see `pool`.

    Raises
    ------
    InputError
        For an unknown engine, a missing Dask installation, or an invalid number of workers.
    """
    check_choice("--engine", engine, ENGINES, "unknown engine")
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise InputError("out of range", f"Give 1 to {MAX_WORKERS} processes", key="--workers", value=workers)
    if scheduler is not None and engine != "dask":
        raise InputError("only the engine dask has a scheduler", "Add --engine dask", key="--scheduler", value=scheduler)
    if engine == "dask":
        try:
            import distributed  # noqa: F401
        except ImportError:
            remedy = f"{extra_remedy('dask')}; or use --engine local"
            raise InputError("Dask is not installed", remedy, key="--engine", value="dask") from None


def known_here(problem: ProblemFile, execution: Execution) -> Execution:
    """Return where a problem is computed: with an own function in the present process, since others do not know it.

    Raises
    ------
    InputError
        If other processes are asked for.
    """
    text = json.dumps(problem.raw, default=str)
    if not (own := [name for name in OWN if json.dumps(name) in text]):
        return execution
    if execution.get("engine", "local") != "local" or execution.get("workers") not in (None, 1):
        remedy = "Leave the option out, or put the function into a package: docs/api/extending.md"
        raise InputError(
            f"other processes do not know your function {own[0]}", remedy, problem.file, "--workers", execution.get("workers")
        )
    return {**execution, "workers": 1}


@contextlib.contextmanager
def pool(engine: str = "local", workers: int | None = None, scheduler: str | None = None) -> Iterator[Runs]:
    """Provide processes for the chunks of several tasks, one task after the other; they end with the context.

    The engine is "local" or "dask". There are as many workers as cores by default; a single one is the present process. The
    address is that of a Dask scheduler, by default a local cluster.

    Raises
    ------
    InputError
        As `check`; if a scheduler does not answer.
    SolverError
        If a scheduler stops answering, or a chunk ends several workers.
    """
    check(engine, workers, scheduler)
    with contextlib.ExitStack() as ends:
        if engine == "dask":
            yield _cluster(workers or cores(), scheduler, ends)
        else:
            yield _Local(workers or cores(), ends)


def ordered(task: ChunkTask, count: int, runs: Runs | None = None, done: Callable[[int], None] | None = None) -> Iterator[Any]:
    """Yield the results of all chunks of a task in the order of their numbers, each as soon as those before it are complete.

    A caller that needs no further results may leave the iterator. Without `runs` from `pool` the present process works. `done`
    receives the number of each completed chunk.
    """
    results: dict[int, Any] = {}
    following, numbers = 0, range(count)
    answers: Iterator[tuple[int, Any]] = zip(numbers, map(task, numbers), strict=True)
    if runs:
        answers = ((index, answer.value) for index, answer in runs(task, numbers))
    for index, value in answers:
        results[index] = value
        if done is not None:
            done(index)
        while following in results:
            yield results.pop(following)
            following += 1


def apart(todo: list[int], workers: int) -> list[int]:
    """Return the chunks in an order in which each worker gets neighbouring ones, for which it can reuse its results.

    The workers take one chunk after the other in turn.
    """
    length = max(1, -(-len(todo) // workers))
    return [todo[at] for first in range(length) for at in range(first, len(todo), length)]


def _completed(
    executor: Executor, ahead: int, task: ChunkTask, todo: Iterable[int], killed: tuple[type[Exception], ...] = ()
) -> Iterator[tuple[int, ChunkResult]]:
    """Run chunks by an executor, `ahead` of them at a time; `killed`: what it raises for a chunk that ends several workers."""
    packed_task, waiting, asked = packed(task), iter(todo), dict[Future[ChunkResult], int]()
    try:
        while True:
            for index in itertools.islice(waiting, ahead - len(asked)):
                asked[executor.submit(run_packed, packed_task, index)] = index
            if not asked:
                return
            for future in wait(asked, WAIT, FIRST_COMPLETED).done:
                index = asked.pop(future)
                try:
                    answer = future.result()
                except BrokenExecutor:
                    how = f"{ATTEMPTS} processes; check the available memory"
                    raise SolverError(f"chunk {index} of the study terminated {how}") from None
                except killed:
                    raise SolverError(f"chunk {index} of the study terminated several workers; check their memory") from None
                yield index, answer
    finally:
        for future in asked:
            future.cancel()


class _Local:
    """Runs chunks in processes of this machine, which are kept for the next task, or in the present one."""

    def __init__(self, workers: int, ends: contextlib.ExitStack) -> None:
        self.workers = workers
        self.executor: Processes | None = None
        ends.callback(self.end)

    def __call__(self, task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
        """Run chunks; see `Runs`."""
        waiting = list(todo)
        if self.workers <= 1 or (len(waiting) <= 1 and self.executor is None):
            before = interrupts.interrupted()  # and handled by the caller, who goes on
            for index in waiting:
                result = run_chunk(task, index)
                if not before:
                    interrupts.check()
                yield index, result
            return
        self.executor = self.executor or Processes(self.workers)
        try:
            yield from _completed(self.executor, 2 * self.workers, task, waiting)
        except GeneratorExit:  # the caller needs no further result: the processes end their present chunks meanwhile
            raise
        except BaseException:
            interrupts.handled()
            self.end()
            raise

    def end(self) -> None:
        """End all processes."""
        if self.executor is not None:
            self.executor.shutdown()
        self.executor = None


# --- Dask ----------------------------------------------------------------------------------------------------------------


def _cluster(workers: int, scheduler: str | None, ends: contextlib.ExitStack) -> Runs:
    """Return what runs chunks on a cluster, which repeats a chunk on another worker if its worker dies."""
    import dask
    import distributed

    ends.enter_context(distributed.utils.silence_logging_cmgr("CRITICAL"))
    where: Any = scheduler
    processes = [Processes(1) for _ in range(0 if scheduler else workers)]
    if processes:
        ends.enter_context(dask.config.set(QUIET))
        where = ends.enter_context(_local_cluster(distributed, processes))
    with _answering(scheduler):
        client = ends.enter_context(_client(distributed, where, scheduler))
    for process in processes:
        ends.callback(process.shutdown)  # before the cluster waits for them
    executor = client.get_executor(pure=False)

    def answers(task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
        with _answering(scheduler):
            places = max(1, sum(client.nthreads().values()))
            yield from _completed(executor, AHEAD * places, task, todo, (distributed.scheduler.KilledWorker,))

    return answers


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


def _local_cluster(distributed: Any, processes: list[Processes]) -> Any:
    """Return a scheduler and workers in this process without HTTP servers, which Dask starts even without a dashboard."""

    class Scheduler(distributed.Scheduler):  # type: ignore[misc]
        def start_http_server(self, *args: Any, **kwargs: Any) -> None:
            """Open no port."""

    class Worker(distributed.Worker):  # type: ignore[misc]
        def start_http_server(self, *args: Any, **kwargs: Any) -> None:
            """Open no port."""

    common = {"protocol": "inproc://", "dashboard": False}
    options = [{**common, "nthreads": 1, "memory_limit": 0, "executor": process} for process in processes]
    specs = {number: {"cls": Worker, "options": option} for number, option in enumerate(options)}
    return distributed.SpecCluster(specs, {"cls": Scheduler, "options": common})


def _client(distributed: Any, where: Any, scheduler: str | None) -> Any:
    place: Any = {"key": "--scheduler", "value": scheduler or LOCAL}
    try:
        client = distributed.Client(where, timeout=PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        start = "Start one (dask scheduler; dask worker ADDRESS), check address and port, or leave --scheduler out"
        why = "" if isinstance(error, OSError) else f": {error}"
        message = f"no scheduler answers there within {PATIENCE:g} s{why}"
        raise InputError(message, start, **place) from None
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        client.close()
        raise InputError("the scheduler has no workers", "Start one: dask worker ADDRESS", **place) from None
    return client
