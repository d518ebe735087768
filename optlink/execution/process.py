"""A worker process of this machine, connected by pipes."""

import contextlib
import errno
import os
import subprocess
import sys
import threading
from pathlib import Path

from optlink.errors import SolverError
from optlink.execution.worker import ONE_THREAD, ChunkResult, packed, receive, send

ATTEMPTS = 3  # attempts per chunk if its process dies


class Process:
    """A worker process, started by its first chunk and again after its death."""

    def __init__(self) -> None:
        self._running: subprocess.Popen[bytes] | None = None
        self._task = b""

    def result(self, task: bytes, index: int, stopped: threading.Event) -> ChunkResult:
        """Return the result of a chunk of a packed task; a chunk during which the process dies is repeated in a new one.

        `stopped` is set before the process is killed on purpose.

        Raises
        ------
        SolverError
            If the process died every time, or `stopped` is set.
        """
        for _ in range(ATTEMPTS):
            if stopped.is_set():
                break
            answer = self._ask(task, index, stopped)
            if answer is not None:
                return answer
            self.kill()
            self.end()
        raise SolverError(f"chunk {index} of the study terminated {ATTEMPTS} processes; check the available memory")

    def _ask(self, task: bytes, index: int, stopped: threading.Event) -> ChunkResult | None:
        """Return the result of a chunk; None if the process died."""
        try:
            process = self._running or self.begin()
            if stopped.is_set():  # while the process started
                return None
            assert process.stdin is not None
            assert process.stdout is not None
            if task is not self._task:
                send(process.stdin, task)
                self._task = task
            send(process.stdin, packed(index))
            answer: ChunkResult = receive(process.stdout)
            return answer
        except (EOFError, ValueError):  # cut short, or closed meanwhile
            return None
        except OSError as error:
            if error.errno in (errno.EPIPE, errno.EINVAL):  # a closed pipe, in the words of POSIX and of Windows
                return None
            raise

    def begin(self) -> subprocess.Popen[bytes]:
        """Start the process."""
        home = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
        self._task = b""
        self._running = subprocess.Popen(
            [sys.executable, "-c", "from optlink.execution.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C is handled by the parent process, on Windows too
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
        return self._running

    def kill(self) -> None:
        """Kill the process, in the middle of a chunk too."""
        if (process := self._running) is not None:  # another thread may end it meanwhile
            process.kill()

    def end(self) -> None:
        """Let the process end, and wait for it."""
        process, self._running = self._running, None
        if process is None:
            return
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        process.wait()
