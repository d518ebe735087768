"""Recipes, made of the templates: file, picture, command and its answer; a page adds how to read the answer and what to change.

What a page quotes of the answer in backticks must be in it, or the site is not built. MkDocs calls `on_files` and
`on_page_markdown`; the tests call `recipe` and `missing`.
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
from typing import TYPE_CHECKING, Any
from unittest import mock

from typer.testing import CliRunner

from optlink.cli.app import app
from optlink.problem.templates import Template, template, templates
from optlink.report import registry
from optlink.report.view import View

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

MARKER = "<!-- recipe -->"
LISTED = "<!-- recipes -->"
PICTURES = ("mechanism.png", "mechanisms.png", "path.png")
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
    drawings = {name: draw for name, draw in view.drawings.items() if f"{name}.png" in PICTURES}
    return replace(view, drawings=drawings, charts=lambda _: (), frames=lambda _: [])


@functools.cache
def answer(name: str) -> Answer:
    """Run the first command of a template, once per build.

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
        words = [*shlex.split(command)[1:], "--out", "out"]
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

![{made.summary}]({name}.png)

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


def missing(page: str, text: str) -> list[str]:
    """Return what a page quotes of an answer that is not in it.

    Parameters
    ----------
    page : str
        The page as written.
    text : str
        The answer.
    """
    reading = page.partition(READING)[2].partition("\n## ")[0]
    joined = " ".join(text.split())
    return [quoted for quoted in re.findall(r"`([^`]+)`", reading) if " ".join(quoted.split()) not in joined]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs: run the commands, and add their pictures."""
    from mkdocs.structure.files import File

    for name in templates():
        files.append(File.generated(config, f"recipes/{name}.png", content=answer(name).picture))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """MkDocs: replace the markers of a page by what is generated."""
    if LISTED in markdown:
        return markdown.replace(LISTED, listed())
    if MARKER not in markdown:
        return markdown
    name = Path(page.file.src_uri).stem
    if gone := missing(markdown, answer(name).text):
        from mkdocs.exceptions import PluginError

        raise PluginError(f"{page.file.src_uri} quotes what the answer does not say: {', '.join(gone)}")
    return markdown.replace(MARKER, recipe(name))
