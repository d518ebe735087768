"""Entry point of the `optlink` command, also `python -m optlink`: set up the interpreter, then run the command."""

from __future__ import annotations

import gc
import os
import signal
import threading

FIRST_COLLECTION = 150_000
"""Objects at a garbage collection while a command begins; a short one creates fewer."""
BEGINNING = 3.0  # s
INTERRUPTED = 130
"""Exit code of a command that was interrupted: 128 and the number of the signal, as shells have it."""


def main() -> None:
    """Run the `optlink` command.

    A short command spends a fifth of its time on searching the modules that it has just loaded for garbage: in its first seconds
    collections are rare, then at the usual intervals, and none searches what is left at exit. One BLAS thread suffices: the
    arrays are small, and what runs in parallel runs in processes. No plugin of pydantic is searched for in the metadata of all
    installed packages.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, leave)  # until the command has its own handler
    _collect_late(BEGINNING)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from optlink.cli.app import main as run

    try:
        run()
    finally:
        gc.freeze()


def leave(*_: object) -> None:
    """End the process at once and without a word: modules are being loaded, so there is nothing to lose."""
    os._exit(INTERRUPTED)


def _collect_late(seconds: float) -> None:
    """Make garbage collections rare for some seconds, in processes forked meanwhile as well.

    A thread restores the usual intervals: in a callback of the collector a Ctrl-C of that moment would be lost.
    """
    usual = gc.get_threshold()
    gc.set_threshold(FIRST_COLLECTION, *usual[1:])
    restore = threading.Timer(seconds, gc.set_threshold, usual)
    restore.daemon = True
    restore.start()
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=lambda: gc.set_threshold(*usual))


if __name__ == "__main__":
    main()
