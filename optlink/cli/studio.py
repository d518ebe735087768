"""The command `studio`: a page in the browser on which a linkage is optimised again while one of its handles is dragged."""

import importlib.util
import sys
from typing import Annotated

import typer

from optlink.cli import console
from optlink.cli.completion import problem_names
from optlink.cli.options import Quiet, flag, option
from optlink.errors import InputError

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
        remedy = 'Install them: pip install "optlink[studio]"'
        raise InputError(f"the studio needs packages that are not installed: {', '.join(missing)}", remedy)
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
