"""Handling of Ctrl-C: the first one stops in order, the second one at once; compiled code has two seconds to return."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from types import FrameType
from typing import NoReturn

PATIENCE = 2.0  # s
EXIT_CODE = 130
"""That of a command that was interrupted: 128 and the number of the signal, as shells have it."""

_pressed = False


def listen() -> None:
    """Install the handler of Ctrl-C; call it in the main thread of a command."""
    global _pressed  # noqa: PLW0603
    _pressed = False
    if threading.current_thread() is not threading.main_thread():
        return
    signal.signal(signal.SIGINT, _press)
    if os.name == "posix":  # Python handles signals only between its own instructions; this pipe is written at once
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        threading.Thread(target=_watch, args=[reading], daemon=True).start()


def interrupted() -> bool:
    """Return whether Ctrl-C was pressed."""
    return _pressed


def check() -> None:
    """Raise the interrupt that compiled code did not pass on.

    Raises
    ------
    KeyboardInterrupt
        when Ctrl-C was pressed.
    """
    if _pressed:
        raise KeyboardInterrupt


def leave() -> NoReturn:
    """End an interrupted process at once after its messages are written: Python would wait for the threads of process pools."""
    if "multiprocessing" in sys.modules:
        for child in sys.modules["multiprocessing"].active_children():
            child.kill()
        with contextlib.suppress(Exception):  # semaphores of their queues, which would be reported as leaked
            sys.modules["multiprocessing.util"]._run_finalizers(0)
    os._exit(EXIT_CODE)


def _press(number: int, frame: FrameType | None) -> None:
    global _pressed  # noqa: PLW0603
    if _pressed:
        _kill("killed: what was not written yet is lost")
    _pressed = True
    raise KeyboardInterrupt


def _watch(signals: int) -> None:
    """End the process if its main thread does not: two seconds after the first Ctrl-C, or at the second one."""
    while os.read(signals, 1) != bytes([signal.SIGINT]):
        pass
    timer = threading.Timer(PATIENCE, _kill, ["interrupted while compiled code was running: no result was written"])
    timer.daemon = True
    timer.start()
    while os.read(signals, 1) != bytes([signal.SIGINT]):
        pass
    _kill("killed: what was not written yet is lost")


def _kill(message: str) -> None:
    """End the process without clean-up: files are written under temporary names, so none is incomplete."""
    with contextlib.suppress(OSError):
        os.write(2, f"\nError: {message}\n".encode())
    os._exit(EXIT_CODE)
