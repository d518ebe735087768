"""The server's side of one page: the process that computes for it, and which of its requests are computed."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import optlink
from optlink.studio.worker import DONE, STOP, frame

Send = Callable[[str], Awaitable[None]]

PATIENCE = 2.0  # s within which a stopped computation must end
LIMIT = 600.0  # s for one computation
LONG = ("drag", "set", "lock", "search", "undo", "redo", "start", "open", "new", "draw", "choose")
"""Requests whose computation a later request may stop."""
FRAME = 64 * 2**20  # largest answer in bytes


class Worker:
    """A process that computes; started early, so that a page does not wait for its imports."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process

    @classmethod
    async def start(cls) -> Worker:
        """Start a process."""
        root = str(Path(optlink.__file__).parent.parent)
        paths = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")]))
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "optlink.studio.worker",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env={**os.environ, **threads, "PYTHONPATH": paths},
            start_new_session=os.name == "posix",
        )
        return cls(process)

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message to the process."""
        assert self.process.stdin is not None
        with contextlib.suppress(ConnectionError, RuntimeError):
            self.process.stdin.write(frame(message))

    async def receive(self) -> bytes:
        """Return the next message of the process as JSON.

        Raises
        ------
        EOFError
            If the process has ended.
        """
        assert self.process.stdout is not None
        head = await self.process.stdout.readexactly(4)
        return await self.process.stdout.readexactly(int.from_bytes(head, "big"))

    def kill(self) -> None:
        """End the process at once."""
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()


class Link:
    """Requests of one page in their order, one computed at a time; of moves only the newest.

    Parameters
    ----------
    worker : Worker
    send : function of a text
        Sends a message to the page.
    """

    def __init__(self, worker: Worker, send: Send) -> None:
        self.worker, self._send = worker, send
        self._waiting: deque[dict[str, Any]] = deque()
        self._running: dict[str, Any] | None = None
        self._document: dict[str, Any] | None = None  # request that opens the present problem again
        self._timer: asyncio.TimerHandle | None = None
        self._reader = asyncio.create_task(self._read())

    def request(self, request: dict[str, Any]) -> None:
        """Accept a request of the page."""
        if request["type"] == STOP:
            self._stop()
            return
        if self._waiting and _moving(self._waiting[-1]) and request["type"] == "drag":
            self._waiting.pop()
        self._waiting.append(request)
        if self._running is None:
            self._next()
        elif self._running["type"] in LONG and not _moving(self._running) and not self._quiet(request):
            self._stop()

    @staticmethod
    def _quiet(request: Mapping[str, Any]) -> bool:
        """Return whether a request waits for the present computation rather than stopping it."""
        return request["type"] in ("save", "link", "export")

    def _next(self) -> None:
        self._cancel()
        self._running = self._waiting.popleft() if self._waiting else None
        if self._running is not None:
            self.worker.send(self._running)
            self._timer = asyncio.get_running_loop().call_later(LIMIT, self.worker.kill)

    def _stop(self) -> None:
        if self._running is None:
            return
        self.worker.send({"type": STOP})
        self._cancel()
        self._timer = asyncio.get_running_loop().call_later(PATIENCE, self.worker.kill)

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    async def _read(self) -> None:
        """Pass the messages of the process on to the page; start another process where one was killed."""
        while True:
            try:
                data = await self.worker.receive()
            except (asyncio.IncompleteReadError, ConnectionError):
                await self._restart()
                continue
            if data.startswith(b'{"type":"done"'):
                self._next()
            elif data.startswith(b'{"type":"kept"'):
                self._document = json.loads(data)["request"]
            else:
                await self._send(data.decode())

    async def _restart(self) -> None:
        """Replace a process that was killed, and open the last problem again."""
        self.worker.kill()
        ident = self._running["id"] if self._running is not None else 0
        self.worker = await Worker.start()
        message = "The computation was ended because it took too long or failed. The problem is as before the last change"
        await self._send(json.dumps({"type": "fault", "id": ident, "message": message}))
        if self._document is not None:
            self._waiting.appendleft({**self._document, "id": ident})
        self._running = None
        self._next()

    async def close(self) -> None:
        """End the process of the page."""
        self._cancel()
        self._reader.cancel()
        self.worker.kill()
        with contextlib.suppress(asyncio.CancelledError):
            await self._reader
        await self.worker.process.wait()


def _moving(request: Mapping[str, Any]) -> bool:
    return request["type"] == "drag" and bool(request.get("moving"))


__all__ = ["DONE", "Link", "Worker"]
