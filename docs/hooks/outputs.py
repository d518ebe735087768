"""Output of commands, generated when the site is built.

A page names the command, and optionally the first line to show and the line before which the excerpt ends:

    <!-- output: optlink solve crank-rocker | from: Design | to: Objective -->
    <!-- output: optlink solve crank-rocker --json | keys: status, valid, design -->
    <!-- exit code: optlink solve crank-rocker -->

MkDocs calls `on_page_markdown`; the tests call `generated`.
"""

from __future__ import annotations

import functools
import json
import re
import shlex
from typing import Any

from typer.testing import CliRunner

from optlink.cli.app import app

OUTPUT = re.compile(r"^<!-- output: optlink (?P<command>[^|\n]+?)(?P<parts>(?: \| [^|\n]+?)*) -->$", re.MULTILINE)
EXIT = re.compile(r"<!-- exit code: optlink (?P<command>[^|\n]+?) -->")
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


def generated(markdown: str) -> str:
    """Return a page with the output of its commands.

    Parameters
    ----------
    markdown : str
    """

    def one(match: re.Match[str]) -> str:
        parts = dict(part.split(": ", 1) for part in match["parts"].split(" | ")[1:])
        text, _ = run(match["command"])
        if "keys" in parts:
            document = json.loads(text)
            chosen = {key: document[key] for key in parts["keys"].split(", ")}
            return f"```json\n{json.dumps(chosen, indent=2, ensure_ascii=False)}\n```"
        return f"```text\n{excerpt(text, parts.get('from', ''), parts.get('to', ''))}\n```"

    return EXIT.sub(lambda match: str(run(match["command"])[1]), OUTPUT.sub(one, markdown))


def on_page_markdown(markdown: str, **_: Any) -> str:
    """MkDocs: put the output of the commands into a page."""
    return generated(markdown)
