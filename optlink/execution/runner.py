"""Run independent chunks of work in local processes or on a Dask cluster, with identical results.

A task (`optlink.execution.worker.ChunkTask`) maps the number of a chunk to its result, which depends on nothing else.
Results arrive in any order.
"""

import contextlib
import os
import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from optlink.errors import InputError
from optlink.execution import interrupts
from optlink.execution.process import Process
from optlink.execution.worker import ChunkResult, ChunkTask, Runs, packed, run_chunk
from optlink.problem.quantity import check_choice

ENGINES = ("local", "dask")
WAIT = 0.2  # s, polling interval of waiting threads
MAX_WORKERS = 1024

Answer = tuple[int, ChunkResult | BaseException]


def cores() -> int:
    """Return the number of processor cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check(engine: str, workers: int | None, scheduler: str | None) -> None:
    """Check the execution options; see `run`.

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
        from optlink.execution.cluster import import_dask

        import_dask()


def run(
    task: ChunkTask, todo: Iterable[int], engine: str = "local", workers: int | None = None, scheduler: str | None = None
) -> Iterator[tuple[int, ChunkResult]]:
    """Run chunks of one task, neighbouring ones in one process, and yield each result with its number on completion.

    Raises
    ------
    InputError
        For an unknown engine, an invalid number of workers, a scheduler that does not answer; and as raised by the task.
    SolverError
        If a chunk breaks down.
    """
    check(engine, workers, scheduler)

    def answers() -> Iterator[tuple[int, ChunkResult]]:
        with pool(engine, workers, scheduler) as runs:
            yield from runs(task, apart(list(todo), workers or cores()))

    return answers()


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
        If a scheduler stops answering.
    """
    check(engine, workers, scheduler)
    if engine == "dask":
        from optlink.execution.cluster import cluster

        with cluster(workers or cores(), scheduler) as runs:
            yield runs
        return
    with contextlib.ExitStack() as ends:
        yield _Processes(workers or cores(), ends)


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


class _Processes:
    """Processes of this machine, started as they are needed and kept for the next task."""

    def __init__(self, workers: int, ends: contextlib.ExitStack) -> None:
        self.workers = workers
        self.idle: list[Process] = []
        self.feeders: list[_Feeder] = []  # of the latest task
        ends.callback(self.end)

    def __call__(self, task: ChunkTask, todo: Iterable[int]) -> Iterator[tuple[int, ChunkResult]]:
        """Run chunks; see `Runs`."""
        self._join()
        waiting = list(todo)
        count = min(self.workers, len(waiting))
        if self.workers <= 1 or (count <= 1 and not self.idle):
            before = interrupts.interrupted()  # and handled by the caller, who goes on
            for index in waiting:
                result = run_chunk(task, index).checked(index)
                if not before:
                    interrupts.check()
                yield index, result
            return
        jobs: queue.SimpleQueue[int] = queue.SimpleQueue()
        for index in waiting:
            jobs.put(index)
        answers: queue.Queue[Answer] = queue.Queue(2 * count)
        packed_task = packed(task)
        feeders = [_Feeder(packed_task, jobs, answers, self.idle.pop() if self.idle else Process()) for _ in range(count)]
        self.feeders = feeders
        try:
            for feeder in feeders:
                feeder.start()
            for _ in waiting:
                index, answer = _first(answers)
                if isinstance(answer, BaseException):
                    raise answer
                yield index, answer.checked(index)
        except GeneratorExit:  # the caller needs no further result: the processes end their present chunks meanwhile
            for feeder in feeders:
                feeder.stopped.set()
            raise
        except BaseException:
            interrupts.handled()
            for feeder in feeders:
                feeder.stop()
            raise

    def _join(self) -> None:
        """Wait for the threads of the latest task."""
        for feeder in self.feeders:
            feeder.join()
        self.idle += [feeder.process for feeder in self.feeders]
        self.feeders = []

    def end(self) -> None:
        """End all processes."""
        for feeder in self.feeders:
            if feeder.is_alive():
                feeder.stop()
        self._join()
        while self.idle:
            self.idle.pop().end()


def _first(answers: queue.Queue[Answer]) -> Answer:
    """Wait for an answer, in short turns: Windows passes no Ctrl-C to a thread that waits without end."""
    while True:
        with contextlib.suppress(queue.Empty):
            return answers.get(timeout=WAIT)


class _Feeder(threading.Thread):
    """Thread that passes chunks to one process."""

    def __init__(self, task: bytes, jobs: queue.SimpleQueue[int], answers: queue.Queue[Answer], process: Process) -> None:
        super().__init__(daemon=True)
        self.task, self.jobs, self.answers, self.process = task, jobs, answers, process
        self.stopped = threading.Event()

    def run(self) -> None:
        """Work until no chunk is left."""
        while not self.stopped.is_set():
            try:
                index = self.jobs.get_nowait()
            except queue.Empty:
                return
            try:
                answer: ChunkResult | BaseException = self.process.result(self.task, index, self.stopped)
            except Exception as error:  # noqa: BLE001 - raised where the chunks are run
                answer = error
            while not self.stopped.is_set():
                with contextlib.suppress(queue.Full):
                    self.answers.put((index, answer), timeout=WAIT)
                    break

    def stop(self) -> None:
        """Start no further chunk, and abandon the current one."""
        self.stopped.set()
        self.process.kill()
