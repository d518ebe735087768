"""Worker process of a study: receives a task once, then numbers of chunks, and returns their results as lines of JSON."""

from __future__ import annotations

import importlib
import json
import os
import sys
import threading
import time
import traceback
from typing import Any, NamedTuple, Protocol, Self

from optlink.errors import Fault, InputError, OptlinkError, SolverError

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a process beside others: linear algebra without threads of its own."""


class ChunkTask(Protocol):
    """Maps the number of a chunk to its result, JSON compatible; depends on its own state only."""

    def __call__(self, index: int) -> Any:
        """Return the result of a chunk."""
        ...

    def state(self) -> dict[str, Any]:
        """Return the state that defines this task, JSON compatible."""
        ...

    @classmethod
    def revived(cls, state: dict[str, Any]) -> Self:
        """Return the task of a state."""
        ...


_ALONE = threading.Lock()


class ChunkResult(NamedTuple):
    """Outcome of a chunk: its value and processor time [s], or input errors, or the text of a breakdown."""

    value: Any = None
    cpu: float = 0.0
    faults: tuple[Fault, ...] = ()
    broken: str = ""

    def checked(self, index: int) -> ChunkResult:
        """Return this answer if it is a result.

        Raises
        ------
        InputError, SolverError
            Otherwise.
        """
        if self.faults:
            raise InputError(self.faults)
        if self.broken:
            raise SolverError(f"chunk {index} of the study broke down; please report it with the problem file:\n{self.broken}")
        return self


def run_chunk(task: ChunkTask, index: int) -> ChunkResult:
    """Run a chunk and catch all errors; one at a time per process, as a task caches what it builds.

    Parameters
    ----------
    task : ChunkTask
    index : int
        Number of the chunk.
    """
    with _ALONE:
        begin = time.process_time()
        try:
            return ChunkResult(task(index), time.process_time() - begin)
        except InputError as error:
            return ChunkResult(faults=error.faults)
        except OptlinkError as error:
            return ChunkResult(broken=str(error))
        except Exception:  # noqa: BLE001 - reported by the process that runs the study
            return ChunkResult(broken=traceback.format_exc())


def task_to_line(task: ChunkTask) -> str:
    """Return a task as a line of JSON."""
    kind = type(task)
    return json.dumps({"room": kind.__module__, "name": kind.__qualname__, "state": task.state()}) + "\n"


def task_from_line(line: str) -> ChunkTask:
    """Return the task of such a line."""
    document = json.loads(line)
    kind = getattr(importlib.import_module(document["room"]), document["name"])
    return kind.revived(document["state"])  # type: ignore[no-any-return]


def chunk_from_line(line: str) -> ChunkResult:
    """Return the answer of a line written by a process."""
    document = json.loads(line)
    return ChunkResult(**{**document, "faults": tuple(Fault(**fault) for fault in document["faults"])})


def main() -> None:
    """Serve standard input until it ends; output of libraries goes to standard error."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        task = task_from_line(sys.stdin.readline())
        for line in sys.stdin:
            answer = run_chunk(task, int(line))
            faults = [vars(fault) for fault in answer.faults]
            answers.write(json.dumps({**answer._asdict(), "faults": faults}, default=str) + "\n")
            answers.flush()
    except BrokenPipeError:
        pass  # the parent process has ended
