"""Recipes, made of the templates: file, picture, command and its answer; a page adds how to read the answer and what to change.

What a page quotes of the answer in backticks must be in it, or the site is not built. MkDocs calls `on_files` and
`on_page_markdown`; the tests call `recipe` and `missing`.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.problem.templates import Template, template, templates

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

MARKER = "<!-- recipe -->"
LISTED = "<!-- recipes -->"
PICTURES = ("mechanism.png", "mechanisms.png", "path.png")
"""Pictures that show the machine; the first that the command has drawn is shown."""
WIDTH = "100"
READING = "## Reading the answer"


@dataclass(frozen=True)
class Answer:
    """What the first command of a template prints, and a picture that it draws."""

    made: Template
    text: str
    picture: bytes


_answers: dict[str, Answer] = {}


def answer(name: str) -> Answer:
    """Run the first command of a template, once per build."""
    if name not in _answers:
        made = template(name)
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, f"{name}.toml").write_text(made.text, encoding="utf-8")
            words = [sys.executable, "-m", "optlink", *shlex.split(made.commands[0])[1:], "--out", "out"]
            plain = {**os.environ, "COLUMNS": WIDTH, "NO_COLOR": "1"}
            done = subprocess.run(words, cwd=folder, env=plain, capture_output=True, text=True, check=True)
            picture = next(path for path in (Path(folder, "out", picture) for picture in PICTURES) if path.is_file())
            _answers[name] = Answer(made, "\n".join(line.rstrip() for line in done.stdout.splitlines()), picture.read_bytes())
    return _answers[name]


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

`{made.commands[0]}` prints:

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
    """MkDocs: run the commands, two at a time, and add their pictures."""
    from mkdocs.structure.files import File

    with ThreadPoolExecutor(2) as pool:
        for name, found in zip(templates(), pool.map(answer, templates()), strict=True):
            files.append(File.generated(config, f"recipes/{name}.png", content=found.picture))
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
