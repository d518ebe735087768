"""Where the chunks of a study are done: on processes of this machine, or on a Dask cluster. Results do not depend on it.

A chunk is done by a task (`optlink.studies.worker.Task`), from its number to its result, which depends on nothing else. They come
back in any order.
"""

from __future__ import annotations

import contextlib
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
from optlink.studies.worker import ONE_THREAD, Answer, Task, answered, packed, perform

ENGINES = ("local", "dask")
ATTEMPTS = 3  # processes that a chunk may outlive
WAIT = 0.2  # s, how often who waits looks whether it is to stop
MAX_WORKERS = 1024


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check(engine: str, workers: int | None, scheduler: str | None) -> None:
    """Make sure that chunks can be done so; see `run`.

    Raises
    ------
    InputError
        unknown engine, Dask not installed, a number of workers that is none.
    """
    if engine not in ENGINES:
        raise InputError(Fault("unknown engine", nearest(engine, ENGINES), key="--engine", value=engine))
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise InputError(Fault("out of range", f"Give 1 to {MAX_WORKERS} processes", key="--workers", value=workers))
    if scheduler is not None and engine != "dask":
        raise InputError(Fault("only the engine dask has a scheduler", "Add --engine dask", key="--scheduler", value=scheduler))
    if engine == "dask":
        from optlink.studies.cluster import installed

        installed()


def run(
    task: Task, todo: Iterable[int], engine: str = "local", workers: int | None = None, scheduler: str | None = None
) -> Iterator[tuple[int, Answer]]:
    """Do chunks; give each with its number as it is done.

    Parameters
    ----------
    task : callable
    todo : numbers of chunks
    engine : "local" or "dask"
    workers : int, optional
        Processes; as many as there are cores if left out. One: this process itself.
    scheduler : str, optional
        Address of a Dask scheduler; a cluster of this machine if left out.

    Raises
    ------
    InputError
        unknown engine, a number of workers that is none, a scheduler that does not answer; and what the task raises.
    SolverError
        where a chunk breaks down.
    """
    check(engine, workers, scheduler)
    if engine == "dask":
        from optlink.studies.cluster import on_cluster

        return on_cluster(task, todo, workers or cores(), scheduler)
    return _local(task, list(todo), workers or cores())


def _local(task: Task, todo: list[int], workers: int) -> Iterator[tuple[int, Answer]]:
    count = min(workers, len(todo))
    if count <= 1:
        for index in todo:
            yield index, perform(task, index).checked(index)
        return
    jobs: queue.SimpleQueue[int] = queue.SimpleQueue()
    for index in todo:
        jobs.put(index)
    answers: queue.Queue[tuple[int, Answer | BaseException]] = queue.Queue(2 * count)
    hands = [_Hand(packed(task), jobs, answers) for _ in range(count)]
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
    """Hands chunks to one process, and to another one if that dies."""

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
                answer: Answer | BaseException = self._asked(index)
            except Exception as error:  # noqa: BLE001 - raised where the study is run
                answer = error
            while not self.stopped.is_set():
                with contextlib.suppress(queue.Full):
                    self.answers.put((index, answer), timeout=WAIT)
                    break
        self._end()

    def _asked(self, index: int) -> Answer:
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
                    return answered(line)
            except BrokenPipeError:
                pass
            self._end()  # it died: only this chunk is lost, and done again
        raise SolverError(f"chunk {index} of the study ended {ATTEMPTS} processes; is there enough memory?")

    def _begin(self) -> subprocess.Popen[str]:
        home = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from optlink.studies.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            encoding="utf-8",
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C is for who asked
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
        """Do no further chunk, and give up the one in hand."""
        self.stopped.set()
        process = self.process
        if process is not None:
            process.kill()
