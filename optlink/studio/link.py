"""Server side of one page: its computing process, and the queue of its requests."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from optlink.studio.document import History
from optlink.studio.worker import SAVE_NOW, STOP, frame

Send = Callable[[str], Awaitable[None]]

STOP_TIMEOUT = 4.0  # s within which a stopped computation must end
START_TIMEOUT = 60.0  # s, the same for a process that has not finished its imports
COMPUTATION_TIMEOUT = 600.0  # s for one computation
MAX_WAITING = 100  # requests
UNINTERRUPTED = ("save", "link", "export", "parts")
"""Requests that wait for the present computation rather than stopping it, and that no later one stops.

A problem whose document is settled, as while a search runs, is saved at once.
"""
RESTART_DELAY = 1.0  # s until a process that did not start is replaced
FAILED_TEXT = "The computation ended unexpectedly and was started again."
STOPPED_TEXT = "The computation did not stop when it should, and was started again."
SLOW_TEXT = f"The computation took longer than {COMPUTATION_TIMEOUT / 60.0:z.0f} minutes and was ended."
KEPT_TEXT = "Your problem and its history are kept."
UNDONE_TEXT = "The last change was undone; redo it to try again."
UNSTARTED_TEXT = "No process can be started for the computations"
NO_PROBLEM_TEXT = "Open a problem."


class Worker:
    """A process that computes; started early, so that a page does not wait for its imports."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process, self.ready = process, False

    @classmethod
    async def start(cls) -> Worker:
        """Start a process."""
        root = str(Path(__file__).parents[2])
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
        """Return the next message of the process as JSON; EOFError if the process has ended."""
        assert self.process.stdout is not None
        head = await self.process.stdout.readexactly(4)
        self.ready = True
        return await self.process.stdout.readexactly(int.from_bytes(head, "big"))

    async def ended(self) -> None:
        """Wait for the end of a process that closed its output; end it if it does not."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self.process.wait(), RESTART_DELAY)
            return
        self.kill()

    def kill(self) -> None:
        """End the process at once."""
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()


class Link:
    """Requests of one page in their order, one computed at a time; of moves only the newest.

    `send` sends a text to the page, and raises ConnectionError if it is gone; `another` returns a worker in place of one that
    ended.
    """

    def __init__(self, worker: Worker, send: Send, another: Callable[[], Awaitable[Worker]] | None = None) -> None:
        self.worker, self._send, self._another = worker, send, another or Worker.start
        self._waiting: deque[dict[str, Any]] = deque()
        self._running: dict[str, Any] | None = None
        self._latest = 0  # id of the request that was computed last
        self._history: History[dict[str, Any]] | None = None  # of the page, in the worker
        self._origin = ""
        self._settled = False  # whether the running request changes the document no more
        self._ended = FAILED_TEXT  # why the worker has ended
        self._failures = 0  # since the last request that was answered
        self._timer: asyncio.TimerHandle | None = None
        self._reader = asyncio.create_task(self._read())

    @property
    def document(self) -> dict[str, Any] | None:
        """The present document as a message; None before the first one."""
        return None if self._history is None else self._history.present

    def resumption(self, ident: int) -> dict[str, Any] | None:
        """Return the request, with this id, that opens the problem again with its history; None before the first problem."""
        if self._history is None:
            return None
        return {"type": "resume", "id": ident, "steps": self._history.steps, "at": self._history.at, "origin": self._origin}

    def request(self, request: dict[str, Any]) -> None:
        """Accept a request of the page."""
        if request["type"] == STOP:
            self._stop()
            return
        if self._waiting and _moving(self._waiting[-1]) and request["type"] == "drag":
            self._waiting.pop()
        if len(self._waiting) < MAX_WAITING:
            self._waiting.append(request)
        if self._running is None:
            self._next()
        else:
            self._save_now()
            self._give_way()

    def _save_now(self) -> None:
        """Save the problem at once, while a computation for it runs."""
        while self._settled and self._waiting and self._waiting[0]["type"] == "save":
            self.worker.send({**self._waiting.popleft(), "type": SAVE_NOW})

    def _next(self) -> None:
        self._cancel()
        self._running, self._settled = self._waiting.popleft() if self._waiting else None, False
        if self._running is not None:
            self._latest = self._running["id"]
            self.worker.send(self._running)
            self._kill_after(COMPUTATION_TIMEOUT, SLOW_TEXT)
            self._give_way()

    def _give_way(self) -> None:
        """Stop the present computation if another one waits; saving waits for its end."""
        assert self._running is not None
        long = self._running["type"] not in UNINTERRUPTED and not _moving(self._running)
        if long and any(request["type"] not in UNINTERRUPTED for request in self._waiting):
            self._stop()

    def _stop(self) -> None:
        if self._running is not None:
            self.worker.send({"type": STOP, "id": self._running["id"]})
            self._kill_after(STOP_TIMEOUT if self.worker.ready else START_TIMEOUT, STOPPED_TEXT)

    def _kill_after(self, seconds: float, why: str) -> None:
        self._cancel()

        def kill() -> None:
            self._ended = why
            self.worker.kill()

        self._timer = asyncio.get_running_loop().call_later(seconds, kill)

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    async def _read(self) -> None:
        """Pass the messages of the process on to the page; start another process where one has ended."""
        with contextlib.suppress(ConnectionError, RuntimeError):  # the page is closed
            while True:
                try:
                    data = await self.worker.receive()
                except (asyncio.IncompleteReadError, ConnectionError):
                    await self._restart()
                    continue
                if data.startswith(b'{"type":"done"'):
                    self._failures = 0
                    self._next()
                elif data.startswith(b'{"type":"kept"'):
                    self._keep(json.loads(data))
                elif not data.startswith(b'{"type":"ready"'):
                    await self._send(data.decode())

    def _keep(self, step: Mapping[str, Any]) -> None:
        """Note a step of the history."""
        if step["step"] == "open":
            self._history, self._origin = History(step["steps"], step["at"]), step["origin"]
        elif self._history is not None and step["step"] == "add":
            self._history.add(step["document"])
        elif step["step"] == "settled":
            self._settled = True
            self._save_now()
        elif self._history is not None and step["step"] == "save":
            self._origin = self._history.present["text"]
        elif self._history is not None:
            self._history.move(step["way"])

    async def _restart(self) -> None:
        """Replace a process that has ended and open the problem again, after a second failure without its last change."""
        self._cancel()
        await self.worker.ended()
        failed, resumed = self.worker.ready, self._running is not None and self._running["type"] == "resume"
        self._running, self._settled, why, self._ended = None, False, self._ended, FAILED_TEXT
        if failed:
            self._failures += why != STOPPED_TEXT or resumed
            words = KEPT_TEXT
            if self._history is not None and (why == SLOW_TEXT or self._failures > 1):
                words = UNDONE_TEXT
                if self._history.ends[0]:
                    self._history.move(-1)
                else:
                    self._history = None
            message = f"{why} {NO_PROBLEM_TEXT if self._history is None else words}"
            await self._send(json.dumps({"type": "fault", "id": self._latest, "message": message}))
        else:
            await asyncio.sleep(RESTART_DELAY)
        try:
            self.worker = await self._another()
        except OSError as error:
            words = f"{UNSTARTED_TEXT}: {error.strerror}. The studio tries again every second."
            await self._send(json.dumps({"type": "fault", "id": self._latest, "message": words}))
            self.worker.ready = False  # the ended one: its failure is not counted again
            return
        resumption = self.resumption(self._latest)
        if resumption is not None:
            self._waiting.appendleft(resumption)
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


# Messages of a page, of the server or of a notebook: form, size and rate are checked here before any is used.

MAX_MESSAGE = 1_000_000  # characters of a message
RATE, BURST = 200.0, 400.0  # messages per second, and at once
MAX_REFUSED = 2000  # refused messages after which no more are taken
MAX_REPORTED = 100  # refused messages that are answered one by one
REQUESTS = (
    *("open", "new", "drag", "set", "edit", "rename", "lock", "search", "stop", "undo", "redo"),
    *("draw", "choose", "dyads", "solutions", "region", "parts", "save", "export", "link"),
)
"""Types of the requests that a page may send."""
QUOTA = "Too many requests. Send fewer than 200 a second"
MALFORMED = "The message is not a request. Send a JSON object with a known type and an id (a whole number), of at most 1 MB"
TOO_MANY = "too many malformed messages"


class Requests:
    """The requests of one page, and the count of those that are refused."""

    def __init__(self) -> None:
        self._left, self._last, self._refused = BURST, time.monotonic(), 0

    @property
    def closed(self) -> bool:
        """Whether so many messages were refused that the page gets no more answers."""
        return self._refused > MAX_REFUSED

    def take(self, text: object) -> tuple[dict[str, Any] | None, str | None]:
        """Return the request of a message, or none and the answer to a message that is refused.

        Not every refusal has an answer: a page that does not read its answers must not block the count.
        """
        now = time.monotonic()
        self._left, self._last = max(min(BURST, self._left + RATE * (now - self._last)) - 1.0, -BURST), now
        request = parsed(text)
        if request is not None and (self._left >= 0.0 or (request["type"] == "drag" and request.get("moving"))):
            return request, None
        self._refused += 1
        if self._refused > MAX_REPORTED and self._refused % MAX_REPORTED:
            return None, None
        words, ident = (MALFORMED, None) if request is None else (QUOTA, request["id"])
        return None, json.dumps({"type": "fault", "id": ident, "message": words})


def parsed(text: object) -> dict[str, Any] | None:
    """Return the request of a message; None if it is none."""
    if not isinstance(text, str) or len(text) > MAX_MESSAGE:
        return None
    try:
        request = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None
    if not isinstance(request, dict) or not isinstance(request.get("type"), str) or request["type"] not in REQUESTS:
        return None
    ident = request.get("id")
    return request if isinstance(ident, int) and not isinstance(ident, bool) and 0 <= ident < 2**53 else None


def _refuse(text: str) -> None:
    raise ValueError(text)
