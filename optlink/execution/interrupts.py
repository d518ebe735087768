"""Handling of Ctrl-C: the first one stops in order, the second one at once; compiled code has two seconds to return.

An interrupt can be lost: casadi and Python drop an exception that is raised in a callback or a destructor. Therefore it is raised
again until the code that handles it confirms it.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

PATIENCE = 2.0  # s
AGAIN = 0.25  # s, after which an interrupt that nothing has handled is raised again
EXIT_CODE = 130
"""That of a command that was interrupted: 128 and the number of the signal, as shells have it."""

_pressed = False
_repeated = False
_handled = False


def listen() -> None:
    """Install the handler of Ctrl-C; call it in the main thread of a command."""
    global _pressed, _repeated, _handled  # noqa: PLW0603
    _pressed = _repeated = _handled = False
    if threading.current_thread() is not threading.main_thread():
        return
    signal.signal(signal.SIGINT, _press)
    sys.unraisablehook = _unraisable
    sys.excepthook = _uncaught  # where compiled modules write what they cannot raise
    if os.name == "posix":  # Python handles signals only between its own instructions; this pipe is written at once
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        threading.Thread(target=_watch, args=[reading], daemon=True).start()


def interrupted() -> bool:
    """Return whether Ctrl-C was pressed."""
    return _pressed


@contextlib.contextmanager
def watched() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C was pressed, which long work asks again and again; a second one raises."""
    plain = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if threading.current_thread() is not threading.main_thread() or not plain:
        yield interrupted
        return
    requested = False

    def ask(*_: object) -> None:
        nonlocal requested
        if requested:
            raise KeyboardInterrupt
        requested = True

    signal.signal(signal.SIGINT, ask)
    try:
        yield lambda: requested
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def check() -> None:
    """Raise the interrupt that other code did not pass on.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C was pressed.
    """
    if _pressed:
        raise KeyboardInterrupt


def handled() -> None:
    """Report the interrupt: complete results are being saved; only a second Ctrl-C stops that."""
    global _handled  # noqa: PLW0603
    _handled = _pressed


def leave() -> NoReturn:
    """End an interrupted process at once after its messages are written: Python would wait for the threads of executors."""
    os._exit(EXIT_CODE)


def _press(number: int, frame: FrameType | None) -> None:
    global _pressed, _repeated  # noqa: PLW0603
    again, _repeated = _repeated, False
    if _pressed and not again:
        _kill("killed: what was not written yet is lost")
    _pressed = True
    if not (again and _handled):
        raise KeyboardInterrupt


def _watch(signals: int) -> None:
    """Raise an interrupt in the main thread again until it is handled; end the process if it is not, or at a second Ctrl-C."""
    global _repeated
    end, count = math.inf, 0
    while True:
        ready, _, _ = select.select([signals], [], [], AGAIN if end < math.inf and not _handled else None)
        if not ready and not _handled:
            if time.monotonic() > end:
                _kill("interrupted while compiled code was running: no result was written")
            _repeated, count = True, count + 1
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        elif ready and os.read(signals, 1) == bytes([signal.SIGINT]):
            if count:
                count -= 1
            elif end < math.inf:
                _kill("killed: what was not written yet is lost")
            else:
                end = time.monotonic() + PATIENCE


def _unraisable(args: UnraisableHookArgs) -> None:
    """Report an exception that cannot be raised, but not an interrupt, which is raised again."""
    if args.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(args)


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an exception that nothing handles, but not an interrupt, which is raised again."""
    if kind is not KeyboardInterrupt:
        sys.__excepthook__(kind, error, trace)


def _kill(message: str) -> None:
    """End the process without clean-up: files are written under temporary names, so none is incomplete."""
    with contextlib.suppress(OSError):
        os.write(2, f"\nError: {message}\n".encode())
    os._exit(EXIT_CODE)
