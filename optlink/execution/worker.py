"""Worker processes of this machine behind the interface of `concurrent.futures`, and what they run: chunks of tasks.

The processes are not those of `concurrent.futures.ProcessPoolExecutor`. Those run the script of the user again when they start,
outlive a parent process that is killed, leave semaphores behind, answer Ctrl-C with a traceback while they start, and if one of
them dies, the work of all is lost.
"""

import contextlib
import functools
import os
import pickle
import queue
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from optlink.errors import InputError, OptlinkError, SolverError

T = TypeVar("T")
ATTEMPTS = 3  # attempts per call if its process dies
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of worker processes: single-threaded linear algebra."""


class ChunkTask(Protocol):
    """Maps the number of a chunk to its result; picklable, as is the result, and depends on its own state only."""

    def __call__(self, index: int, /) -> Any:
        """Return the result of a chunk."""


class ChunkResult(NamedTuple):
    """Result of a chunk, and its processor time [s]."""

    value: Any
    cpu: float


Runs = Callable[[ChunkTask, Iterable[int]], Iterator[tuple[int, ChunkResult]]]
"""Runs chunks of a task in the order of their numbers as listed, and yields each number and result on completion."""


def run_chunk(task: ChunkTask, index: int) -> ChunkResult:
    """Run a chunk.

    Raises
    ------
    InputError
        As raised by the task.
    SolverError
        For any other failure, with its text.
    """
    begin = time.process_time()
    try:
        return ChunkResult(task(index), time.process_time() - begin)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - with its text
        why = str(error) if isinstance(error, OptlinkError) else traceback.format_exc()
        message = f"chunk {index} of the study failed; please report it with the problem file:\n{why}"
        raise SolverError(message) from None


_CHUNK_LOCK = threading.Lock()
_latest = functools.lru_cache(1)(pickle.loads)


def run_packed(packed_task: bytes, index: int) -> ChunkResult:
    """Run a chunk of a packed task; one at a time per process, as a task caches what it builds."""
    with _CHUNK_LOCK:
        return run_chunk(_latest(packed_task), index)


_latest_built = functools.lru_cache(4)(lambda build, packed_task: build(*pickle.loads(packed_task)))


def built(build: Callable[..., T], packed_task: bytes) -> T:
    """Return the data shared by consecutive tasks of this process, built once by an importable function from packed arguments."""
    data: T = _latest_built(build, packed_task)
    return data


def packed(item: Any) -> bytes:
    """Return a task or arguments as bytes."""
    return pickle.dumps(item, pickle.HIGHEST_PROTOCOL)


class Processes(ThreadPoolExecutor):
    """Executor whose calls run in processes of this machine: each thread passes its calls to a process through pipes.

    Functions are importable, arguments and results picklable. A process starts with its first call; a call during which it dies
    is repeated in a new one.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._own = threading.local()
        self._started: list[subprocess.Popen[bytes]] = []
        self._stopped = False

    def submit(self, function: Callable[..., T], /, *arguments: Any, **named: Any) -> Future[T]:
        """Ask for a call.

        The future raises `concurrent.futures.BrokenExecutor` if every process that makes the call dies.
        """
        return super().submit(self._call, packed((function, arguments, named)))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End all processes, in the middle of a call too."""
        self._stopped = True
        for process in list(self._started):
            process.kill()
        super().shutdown(wait, cancel_futures=cancel_futures)
        for process in list(self._started) if wait else ():
            self._end(process)

    def _call(self, message: bytes) -> Any:
        for _ in range(ATTEMPTS):
            process = getattr(self._own, "process", None) or self._begin()
            try:
                pickle.dump(message, process.stdin)
                process.stdin.flush()
                value, error = pickle.load(process.stdout)
            except (OSError, EOFError, pickle.UnpicklingError):  # the process has died; its answer may be cut short
                self._end(process)
            else:
                if error is not None:
                    raise error
                return value
            if self._stopped:
                break
        raise BrokenExecutor

    def _begin(self) -> Any:
        """Start the process of this thread."""
        home = str(Path(__file__).resolve().parents[2])
        process = self._own.process = subprocess.Popen(
            [sys.executable, "-c", "from optlink.execution.worker import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))},
            start_new_session=True,  # Ctrl-C is handled by the parent process, on Windows too
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
        self._started.append(process)
        if self._stopped:  # meanwhile
            process.kill()
        return process

    def _end(self, process: Any) -> None:
        """Wait for the end of the process of this thread."""
        self._own.process = None
        self._started.remove(process)
        process.kill()
        with contextlib.suppress(OSError):
            process.stdin.close()
        process.stdout.close()
        process.wait()


def serve() -> None:
    """Answer the calls on standard input until it ends; output of libraries goes to standard error.

    A second thread reads, so that the process ends together with its parent process, however that ends, in the middle of a call
    and of compiled code too.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=[calls], daemon=True).start()
    with contextlib.suppress(BrokenPipeError):  # the parent process has ended
        while True:
            message = calls.get()
            try:
                function, arguments, named = pickle.loads(message)
                answer = packed((function(*arguments, **named), None))
            except Exception as error:  # noqa: BLE001 - raised in the parent process
                answer = packed((None, error))
            answers.write(answer)
            answers.flush()
    os._exit(0)


def _read(calls: queue.SimpleQueue[bytes]) -> None:
    """Pass on what standard input contains, and end the process when it ends."""
    with contextlib.suppress(EOFError, pickle.UnpicklingError):
        while True:
            calls.put(pickle.load(sys.stdin.buffer))
    os._exit(0)
