"""The command `studio`: a page in the browser on which a linkage is optimised again while one of its handles is dragged."""

import contextlib
import importlib.util
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from optlink.cli.options import Quiet, flag, option, problem_names
from optlink.errors import InputError, extra_remedy

PROBLEM_HELP = "Name of a shipped problem, or path of a .toml file. Default: choose on the page."
ProblemName = Annotated[
    str, typer.Argument(metavar="PROBLEM", autocompletion=problem_names, help=PROBLEM_HELP, show_default=False)
]
NEEDED = ("starlette", "uvicorn", "websockets")


def studio(
    problem: ProblemName = "",
    port: Annotated[int, option("N", "Port. Default: any free one.", "--port", min=0, max=65535, show_default=False)] = 0,
    browser: Annotated[bool, flag("Open the page in the browser.", "--browser/--no-browser")] = True,
    quiet: Quiet = False,
) -> None:
    """Open an interactive page: drag points, dimensions and limits, and the optimum follows."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(f"the studio needs packages that are not installed: {', '.join(missing)}", extra_remedy("studio"))
    from optlink.studio.document import named
    from optlink.studio.server import serve

    if problem:
        named(problem)
    with contextlib.ExitStack() as until_end:

        def ready(url: str) -> None:
            print(f"The studio is open at {url}", flush=True)
            if not quiet:
                print("Stop it with Ctrl-C.", file=sys.stderr)
            if browser:
                import threading
                import webbrowser

                page = until_end.enter_context(_link_file(url))
                threading.Thread(target=webbrowser.open, args=[page], daemon=True).start()

        serve(problem or None, port, ready)


@contextlib.contextmanager
def _link_file(url: str) -> Iterator[str]:
    """Yield the address of a page that leads to the studio and that this user alone can read.

    The address itself must not be an argument of the browser: the list of processes shows it to every user.
    """
    folder = Path.home() if sys.platform == "linux" else None  # browsers in a sandbox see no folder of temporary files
    try:
        handle, name = tempfile.mkstemp(".html", "optlink-studio-", folder)
    except OSError:
        handle, name = tempfile.mkstemp(".html", "optlink-studio-")
    try:
        with open(handle, "w", encoding="utf-8") as file:
            file.write(f'<!doctype html><title>optlink studio</title><meta http-equiv="refresh" content="0; url={url}">\n')
        yield Path(name).as_uri()
    finally:
        Path(name).unlink(missing_ok=True)
