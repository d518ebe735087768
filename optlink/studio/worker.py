"""The process that computes for one page: requests come in as frames on its standard input, messages go out as frames.

A frame is its length in four bytes, and JSON. The computing runs in the main thread; a second thread reads, so that a long search
can be stopped and its problem saved meanwhile, and ends the process when the server is gone.
"""

import contextlib
import json
import os
import queue
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from types import FrameType
from typing import Any, BinaryIO

MEMORY_LIMIT = 8 * 2**30  # bytes of address space
IDLE_TIME = 0.3  # s without a request, after which the imports of rarer requests begin
STOP_INTERVAL = 0.2  # s after which a stop is tried once more
STOP = "stop"
SAVE_NOW = "save now"
DONE = "done"
READY = "ready"


def frame(message: Mapping[str, Any]) -> bytes:
    """Return a message as a frame."""
    data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
    return len(data).to_bytes(4, "big") + data


def frames(stream: BinaryIO) -> Iterator[dict[str, Any]]:
    """Yield the messages of a stream until it ends."""
    while len(head := stream.read(4)) == 4:
        data = stream.read(int.from_bytes(head, "big"))
        yield json.loads(data)


class Interrupts:
    """Stops the computation of one request in the main thread, only while the computation allows it.

    A stop that comes before the computation allows it is kept; one that comes after the request is over stops no other.
    """

    def __init__(self) -> None:
        self._open = False
        self._current = self._stopped = -1  # ids of requests
        signal.signal(signal.SIGINT, self._press)

    def begin(self, ident: int) -> None:
        """Begin a request."""
        self._current = ident

    def stop(self, ident: int) -> None:
        """Stop a request; called by the thread that reads."""
        self._stopped = ident
        retry_at = 0.0
        while self._open and self._current == ident:
            if time.monotonic() >= retry_at:  # an interrupt that is raised in a callback can be lost
                signal.raise_signal(signal.SIGINT)
                retry_at = time.monotonic() + STOP_INTERVAL
            time.sleep(0.01)

    def _press(self, number: int, at: FrameType | None) -> None:
        if self._open:
            self._check()

    def _check(self) -> None:
        if self._stopped == self._current:
            raise KeyboardInterrupt

    def within(self, work: Callable[[], Any]) -> Any:
        """Run a function that a stop interrupts."""
        self._open = True
        try:
            self._check()
            return work()
        except Exception:
            self._check()  # a library can turn an interrupt into an error of its own
            raise
        finally:
            self._open = False

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Delay a stop until the message is sent completely; it concerns the main thread alone."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before, self._open = self._open, False
        yield
        self._open = before
        if before:
            self._check()


def main() -> None:
    """Answer requests until the input ends."""
    interrupts = Interrupts()
    reading, writing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of libraries must not mix with the frames
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

    def read() -> None:
        for request in frames(reading):
            if request["type"] == STOP:
                interrupts.stop(request["id"])
            elif request["type"] == SAVE_NOW:
                answer(session.save, request)
            else:
                requests.put(request)
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()

    writer = threading.Lock()

    def send(message: Mapping[str, Any]) -> None:
        data = frame(message)
        with interrupts.held(), writer:
            writing.write(data)
            writing.flush()

    def answer(act: Callable[[Mapping[str, Any]], None], request: Mapping[str, Any]) -> None:
        """Let the session answer a request; what it did not foresee is a message on the page."""
        try:
            act(request)
        except MemoryError:
            words = "The problem needs more memory than the studio allows. Make it smaller"
            send({"type": "fault", "id": request["id"], "message": words})
        except Exception as error:  # noqa: BLE001
            import traceback

            traceback.print_exc(file=sys.stderr)
            words = f"This request failed ({type(error).__name__}). Undo the last change, or open the problem again"
            send({"type": "fault", "id": request["id"], "message": words})

    warnings.simplefilter("ignore")  # of numpy, about positions that an absurd machine cannot take
    from optlink.studio.session import Session, warm, warm_drawing

    warm()
    send({"type": READY})
    session = Session(send, interrupts.within)
    idle: float | None = IDLE_TIME
    while True:
        try:
            request = requests.get(timeout=idle)
        except queue.Empty:
            warm_drawing()
            idle = None
            continue
        interrupts.begin(request["id"])
        answer(session.handle, request)
        send({"type": DONE, "id": request["id"]})


if __name__ == "__main__":
    main()
