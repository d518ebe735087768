"""Entry point of the `optlink` command, also `python -m optlink`: set up the interpreter, then run the command."""

from __future__ import annotations

import gc
import os

FIRST_COLLECTION = 150_000
"""Objects at the first garbage collection; a short command creates fewer."""


def main() -> None:
    """Run the `optlink` command.

    A short command spends a fifth of its time on searching the modules that it has just loaded for garbage: the first collection
    comes late, later ones at the usual intervals, and none searches what is left at exit. One BLAS thread suffices: the arrays
    are small, and what runs in parallel runs in processes.
    """
    _collect_late()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from optlink.cli.app import main as run

    try:
        run()
    finally:
        gc.freeze()


def _collect_late() -> None:
    """Put the first garbage collection off; it exempts what has been loaded by then and restores the usual intervals."""
    usual = gc.get_threshold()

    def restore(phase: str, _: dict[str, int]) -> None:
        if phase == "stop":
            gc.callbacks.remove(restore)
            gc.freeze()
            gc.set_threshold(*usual)

    gc.callbacks.append(restore)
    gc.set_threshold(FIRST_COLLECTION, *usual[1:])


if __name__ == "__main__":
    main()
