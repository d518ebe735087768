"""Outputs of commands."""

from __future__ import annotations

import functools
import json
import shlex
from collections.abc import Mapping

from typer.testing import CliRunner

from optlink.cli.app import app

COLUMNS = "100"


@functools.cache
def run(command: str) -> tuple[str, int]:
    """Return the output of a call of optlink and its exit code.

    Parameters
    ----------
    command : str
        Arguments of optlink, as in a shell.
    """
    done = CliRunner().invoke(app, shlex.split(command), env={"COLUMNS": COLUMNS})
    if done.exit_code not in (0, 1, 2, 3):
        raise RuntimeError(f"optlink {command}: {done.output}") from done.exception
    return done.output, done.exit_code


def excerpt(text: str, begin: str = "", end: str = "") -> str:
    """Return the lines of a text from one that starts with `begin` to the line before one that starts with `end`.

    Parameters
    ----------
    text : str
    begin, end : str, optional
        Empty: from the first line, to the last line.

    Raises
    ------
    ValueError
        If no line starts in this way.
    """
    lines = [line.rstrip() for line in text.split("\n")]
    first = 0 if not begin else next((k for k, line in enumerate(lines) if line.startswith(begin)), -1)
    last = len(lines) if not end else next((k for k, line in enumerate(lines) if k > first >= 0 and line.startswith(end)), -1)
    if first < 0 or last < 0:
        raise ValueError(f"no line starts with {begin if first < 0 else end!r}:\n{text}")
    return "\n".join(lines[first:last]).strip("\n")


def shown(command: str, options: Mapping[str, str]) -> str:
    """Return an excerpt of what a command prints, as a fence.

    Parameters
    ----------
    command : str
        "optlink solve crank-rocker"
    options : mapping
        `from` and `to`, the beginnings of the first line and of the line below the last one, or `keys` of a JSON document.
    """
    text, _ = run(command.removeprefix("optlink "))
    if "keys" in options:
        document = json.loads(text)
        chosen = {key: document[key] for key in options["keys"].split(", ")}
        return f"```json\n{json.dumps(chosen, indent=2, ensure_ascii=False)}\n```"
    return f"```text\n{excerpt(text, options.get('from', ''), options.get('to', ''))}\n```"


def exit_code(command: str) -> str:
    """Return the exit code of a command.

    Parameters
    ----------
    command : str
    """
    return str(run(command.removeprefix("optlink "))[1])
