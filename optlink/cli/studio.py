"""The command `studio`: a page in the browser on which a linkage is optimised again while one of its handles is dragged."""

from __future__ import annotations

import importlib.util
import sys
from typing import Annotated

import typer

from optlink.cli import console
from optlink.cli.completion import problem_names
from optlink.cli.options import Quiet
from optlink.errors import Fault, InputError

NEEDED = ("starlette", "uvicorn", "websockets")


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(studio)


def studio(
    problem: Annotated[
        str,
        typer.Argument(
            metavar="PROBLEM",
            autocompletion=problem_names,
            help="Name of a shipped problem, or path of a .toml file. Default: choose on the page.",
            show_default=False,
        ),
    ] = "",
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="Port. Default: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    quiet: Quiet = False,
) -> None:
    """Open a page on which the linkage is optimised again while you drag its points, sizes and limits."""
    with console.reported(False):
        missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
        if missing:
            remedy = "Install them: pip install 'optlink[studio]'"
            raise InputError(Fault(f"the studio needs packages that are not installed: {', '.join(missing)}", remedy))
        if problem:
            console.load(problem, None)
        from optlink.studio.server import serve

        def ready(url: str) -> None:
            print(f"The studio is open at {url}", flush=True)
            if not quiet:
                print("Stop it with Ctrl-C.", file=sys.stderr)
            if browser:
                import threading
                import webbrowser

                threading.Thread(target=webbrowser.open, args=[url], daemon=True).start()

        serve(problem or None, port, ready)
