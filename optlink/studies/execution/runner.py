"""Run the chunks of a study in local processes or on a Dask cluster, with identical results.

A task (`optlink.studies.execution.worker.ChunkTask`) maps the number of a chunk to its result, which depends on nothing else.
Results arrive in any order.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from optlink.errors import Fault, InputError, SolverError
from optlink.problem.quantity import nearest
from optlink.studies.execution.worker import ONE_THREAD, ChunkResult, ChunkTask, chunk_from_line, run_chunk, task_to_line

ENGINES = ("local", "dask")
ATTEMPTS = 3  # attempts per chunk if its process dies
WAIT = 0.2  # s, polling interval of waiting threads
MAX_WORKERS = 1024


def cores() -> int:
    """Return the number of processor cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check(engine: str, workers: int | None, scheduler: str | None) -> None:
    """Check the execution options; see `run`.

    Parameters
    ----------
    engine : str
    workers : int or None
    scheduler : str or None

    Raises
    ------
    InputError
        For an unknown engine, a missing Dask installation, or an invalid number of workers.
    """
    if engine not in ENGINES:
        raise InputError(Fault("unknown engine", nearest(engine, ENGINES), key="--engine", value=engine))
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise InputError(Fault("out of range", f"Give 1 to {MAX_WORKERS} processes", key="--workers", value=workers))
    if scheduler is not None and engine != "dask":
        raise InputError(Fault("only the engine dask has a scheduler", "Add --engine dask", key="--scheduler", value=scheduler))
    if engine == "dask":
        from optlink.studies.execution.cluster import import_dask

        import_dask()


def run(
    task: ChunkTask, todo: Iterable[int], engine: str = "local", workers: int | None = None, scheduler: str | None = None
) -> Iterator[tuple[int, ChunkResult]]:
    """Run chunks, and yield each result with its number on completion.

    Parameters
    ----------
    task : ChunkTask
    todo : iterable of int
        Numbers of chunks.
    engine : "local" or "dask"
    workers : int, optional
        Number of processes. Default: the number of cores. With one worker, the present process.
    scheduler : str, optional
        Address of a Dask scheduler. Default: a local cluster.

    Raises
    ------
    InputError
        For an unknown engine, an invalid number of workers, a scheduler that does not answer; and as raised by the task.
    SolverError
        If a chunk breaks down.
    """
    check(engine, workers, scheduler)
    if engine == "dask":
        from optlink.studies.execution.cluster import on_cluster

        return on_cluster(task, apart(list(todo), workers or cores()), workers or cores(), scheduler)
    return _local(task, apart(list(todo), workers or cores()), workers or cores())


def apart(todo: list[int], workers: int) -> list[int]:
    """Return the chunks in an order in which each worker gets neighbouring ones: what it has computed serves for the next.

    Parameters
    ----------
    todo : list of int
    workers : int
        They take one chunk after the other in turn.
    """
    length = max(1, -(-len(todo) // workers))
    return [todo[at] for first in range(length) for at in range(first, len(todo), length)]


def _local(task: ChunkTask, todo: list[int], workers: int) -> Iterator[tuple[int, ChunkResult]]:
    count = min(workers, len(todo))
    if count <= 1:
        for index in todo:
            yield index, run_chunk(task, index).checked(index)
        return
    jobs: queue.SimpleQueue[int] = queue.SimpleQueue()
    for index in todo:
        jobs.put(index)
    answers: queue.Queue[tuple[int, ChunkResult | BaseException]] = queue.Queue(2 * count)
    hands = [_Hand(task_to_line(task), jobs, answers) for _ in range(count)]
    try:
        for hand in hands:
            hand.start()
        for _ in todo:
            index, answer = answers.get()
            if isinstance(answer, BaseException):
                raise answer
            yield index, answer.checked(index)
    finally:
        for hand in hands:
            hand.stop()
        for hand in hands:
            hand.join()


class _Hand(threading.Thread):
    """Thread that passes chunks to one process, and to a new one if that dies."""

    def __init__(self, task: str, jobs: queue.SimpleQueue[int], answers: queue.Queue[tuple[int, Any]]) -> None:
        super().__init__(daemon=True)
        self.task, self.jobs, self.answers = task, jobs, answers
        self.process: subprocess.Popen[str] | None = None
        self.stopped = threading.Event()

    def run(self) -> None:
        """Work until no chunk is left."""
        while not self.stopped.is_set():
            try:
                index = self.jobs.get_nowait()
            except queue.Empty:
                break
            try:
                answer: ChunkResult | BaseException = self._asked(index)
            except Exception as error:  # noqa: BLE001 - raised where the study is run
                answer = error
            while not self.stopped.is_set():
                with contextlib.suppress(queue.Full):
                    self.answers.put((index, answer), timeout=WAIT)
                    break
        self._end()

    def _asked(self, index: int) -> ChunkResult:
        for _ in range(ATTEMPTS):
            if self.stopped.is_set():
                break
            try:
                process = self.process or self._begin()
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(f"{index}\n")
                process.stdin.flush()
                line = process.stdout.readline()
                if line.endswith("\n"):
                    return chunk_from_line(line)
            except OSError as error:
                if error.errno not in (errno.EPIPE, errno.EINVAL):  # a closed pipe, in the words of POSIX and of Windows
                    raise
            self._end()  # the process died: only this chunk is repeated
        raise SolverError(f"chunk {index} of the study ended {ATTEMPTS} processes; is there enough memory?")

    def _begin(self) -> subprocess.Popen[str]:
        home = str(Path(__file__).resolve().parents[3])
        path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from optlink.studies.execution.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            encoding="utf-8",
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C is handled by the parent process, on Windows too
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
        assert self.process.stdin is not None
        self.process.stdin.write(self.task)
        return self.process

    def _end(self) -> None:
        process, self.process = self.process, None
        if process is None:
            return
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        if self.stopped.is_set():
            process.kill()
        process.wait()

    def stop(self) -> None:
        """Start no further chunk, and abandon the current one."""
        self.stopped.set()
        process = self.process
        if process is not None:
            process.kill()
