"""Worker process: receives tasks and numbers of their chunks, and returns the results of the chunks.

Messages have the form of those of `multiprocessing`, which is safe as only the parent process writes to the pipe of a worker.
"""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from typing import IO, Any, NamedTuple, Protocol, TypeVar

from optlink.errors import Fault, InputError, OptlinkError, SolverError

T = TypeVar("T")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of worker processes: single-threaded linear algebra."""


class ChunkTask(Protocol):
    """Maps the number of a chunk to its result; picklable, as is the result, and depends on its own state only."""

    def __call__(self, index: int) -> Any:
        """Return the result of a chunk."""
        ...


_CHUNK_LOCK = threading.RLock()
_BUILT: dict[tuple[Any, bytes], Any] = {}
MOST_BUILT = 4


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
            raise SolverError(f"chunk {index} of the study failed; please report it with the problem file:\n{self.broken}")
        return self


Runs = Callable[[ChunkTask, Iterable[int]], Iterator[tuple[int, ChunkResult]]]
"""Runs chunks of a task in the order of their numbers as listed, and yields each number and result on completion."""


def run_chunk(task: ChunkTask, index: int) -> ChunkResult:
    """Run a chunk and catch all errors; one at a time per process, as a task caches what it builds."""
    with _CHUNK_LOCK:
        begin = time.process_time()
        try:
            return ChunkResult(task(index), time.process_time() - begin)
        except InputError as error:
            return ChunkResult(faults=error.faults)
        except OptlinkError as error:
            return ChunkResult(broken=str(error))
        except Exception:  # noqa: BLE001 - reported by the process that runs the study
            return ChunkResult(broken=traceback.format_exc())


def built(build: Callable[..., T], packed_task: bytes) -> T:
    """Return the data shared by consecutive tasks of this process, built once by an importable function from packed arguments."""
    key = build, packed_task
    if key not in _BUILT:
        while len(_BUILT) >= MOST_BUILT:
            del _BUILT[next(iter(_BUILT))]
        _BUILT[key] = build(*_unpacked(packed_task))
    task: T = _BUILT[key]
    return task


def packed(item: Any) -> bytes:
    """Return a task, the number of a chunk, or a result as bytes."""
    from multiprocessing.reduction import ForkingPickler

    return bytes(ForkingPickler.dumps(item))


def send(stream: IO[bytes], item: bytes) -> None:
    """Write a packed item."""
    stream.write(len(item).to_bytes(8, "little") + item)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Read an item.

    Raises
    ------
    EOFError
        If the stream ends before.
    """
    return _unpacked(_item(stream))


def _item(stream: IO[bytes]) -> bytes:
    """Read a packed item."""
    size = int.from_bytes(stream.read(8), "little")
    item = stream.read(size)
    if not size or len(item) < size:
        raise EOFError
    return item


def _unpacked(item: bytes) -> Any:
    from multiprocessing.reduction import ForkingPickler

    return ForkingPickler.loads(item)


def main() -> None:
    """Serve standard input until it ends; output of libraries goes to standard error.

    It reads tasks and numbers of chunks of the latest task; each number is answered by the result of the chunk. A second thread
    reads, so that the process ends together with its parent process, however that ends, in the middle of a chunk too.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    items: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=[items], daemon=True).start()
    task: Any = None
    try:
        while True:
            message = _unpacked(items.get())
            if isinstance(message, int):
                send(answers, packed(run_chunk(task, message)))
            else:
                task = message
    except BrokenPipeError:  # the parent process has ended
        os._exit(0)


def _read(items: queue.SimpleQueue[bytes]) -> None:
    """Pass on what standard input contains, and end the process when it ends."""
    with contextlib.suppress(EOFError):
        while True:
            items.put(_item(sys.stdin.buffer))
    os._exit(0)
