"""Entry point of the `optlink` command, also `python -m optlink`: set up the interpreter, then run the command."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading

from optlink.cli import FAULT, traced

COLLECTION = 150_000
"""New objects at which garbage is collected: a short command creates fewer, a long one is no slower and no larger."""
INTERRUPTED = 130
"""Exit code of a command that was interrupted: 128 and the number of the signal, as shells have it."""


def main() -> None:
    """Run the `optlink` command.

    Garbage collections are rare, and none searches what is left at exit: with both at their usual values `optlink list` takes
    0.22 s, not 0.19 s, and `optlink solve crank-rocker` 1.03 s, not 0.90 s (processor time, the least of 15 runs each). One BLAS
    thread suffices: the arrays are small, and what runs in parallel runs in processes. No plugin of pydantic is searched for in
    the metadata of all installed packages.

    Raises
    ------
    SystemExit
        With the exit code of the command, or that of a fault before it begins.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, leave)  # until the command has its own handler
    gc.set_threshold(COLLECTION)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        from optlink.cli.app import main as run

        run()
    except Exception as error:  # noqa: BLE001 - before a command begins, which states its own faults
        raise SystemExit(_told(error)) from None
    finally:
        gc.freeze()


def _told(error: Exception) -> int:
    """Print a fault of optlink or of its installation in one sentence, with modules of Python alone; return the exit code."""
    from contextlib import suppress

    report = traced(error)
    what = " ".join(f"{type(error).__name__}: {error}".split())
    cause = "a fault of optlink"
    if isinstance(error, ImportError):
        cause = "a damaged or incomplete installation"
    with suppress(OSError, AttributeError):  # standard error is closed
        print(f"Error: optlink cannot start: {what}. This is {cause}; {report}", file=sys.__stderr__, flush=True)
    return FAULT


def leave(*_: object) -> None:
    """End the process at once and without a word: modules are being loaded, so there is nothing to lose."""
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
