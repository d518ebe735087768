"""Recipes, made of the templates: file, picture, command and its answer; a page adds how to read the answer and what to change.

What a page quotes of the answer in backticks must be in it, or the page is not written.
"""

from __future__ import annotations

import contextlib
import functools
import json
import re
import shlex
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

from typer.testing import CliRunner

from optlink.cli.app import app
from optlink.presentation import registry
from optlink.presentation.view import View
from optlink.problem.templates import Template, template, templates

PICTURES = ("mechanism.svg", "mechanisms.svg", "path.svg")
"""Pictures that show the machine; the first that the command has drawn is shown."""
WIDTH = "100"
READING = "## Reading the result"


@dataclass(frozen=True)
class Answer:
    """What the first command of a template prints in full, a picture that it draws, and its result.json."""

    made: Template
    command: str
    text: str
    picture: bytes
    result: dict[str, Any]


def machine_alone(view: View) -> View:
    """Return a view that draws nothing but the pictures of the machine: charts and animations take most of the time.

    Parameters
    ----------
    view : View
    """
    drawings = {name: draw for name, draw in view.drawings.items() if f"{name}.svg" in PICTURES}
    return replace(view, drawings=drawings, charts=lambda _: (), frames=lambda _: [])


@functools.cache
def answer(name: str) -> Answer:
    """Run the first command of a template, once.

    Parameters
    ----------
    name : str

    Raises
    ------
    RuntimeError
        If the command fails.
    """
    made, view_of = template(name), registry.view_of
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        mock.patch.object(registry, "view_of", lambda kind: machine_alone(view_of(kind))),
    ):
        Path(f"{name}.toml").write_text(made.text, encoding="utf-8")
        command = made.commands[0]
        command += " --details" if command.startswith("optlink solve") else ""
        words = [*shlex.split(command)[1:], "--out", "out", "--format", "svg"]
        done = CliRunner().invoke(app, words, env={"COLUMNS": WIDTH, "NO_COLOR": "1"})
        if done.exit_code:
            raise RuntimeError(f"{command}: {done.output}") from done.exception
        picture = next(path for path in (Path("out", picture) for picture in PICTURES) if path.is_file())
        text = "\n".join(line.rstrip() for line in done.stdout.splitlines())
        return Answer(
            made, command, text, picture.read_bytes(), json.loads(Path("out", "result.json").read_text(encoding="utf-8"))
        )


def recipe(name: str) -> str:
    """Return the generated part of a recipe as Markdown."""
    found = answer(name)
    made = found.made
    about = made.text.partition('about = """\n')[2].partition('"""')[0]
    commands = "\n".join([f"optlink new {name} --out {name}.toml", *made.commands])
    return f"""{about.strip()}

![{made.summary}]({name}.svg)

```sh
{commands}
```

## The file

```toml
{made.text}```

## The answer

`{found.command}` prints:

```text
{found.text}
```
"""


def listed() -> str:
    """Return the table of all recipes as Markdown."""
    rows = [f"| [{name}]({name}.md) | {template(name).summary} | `{template(name).commands[0]}` |" for name in templates()]
    return "\n".join(["| template | machine | command |", "|---|---|---|", *rows])


def picture(name: str) -> bytes:
    """Return the picture of a recipe as SVG."""
    return answer(name).picture


def missing(page: str) -> list[str]:
    """Return what a recipe quotes of its answer that is not in it.

    Parameters
    ----------
    page : str
    """
    answered, _, reading = page.partition(READING)
    reading, joined = reading.partition("\n## ")[0], " ".join(answered.partition("## The answer")[2].split())
    return [quoted for quoted in re.findall(r"`([^`]+)`", reading) if " ".join(quoted.split()) not in joined]
