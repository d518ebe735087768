"""Templates of problem files: complete TOML files with comments, in a folder beside the shipped problems.

A template is registered by being in that folder. Its first comment line describes it, each line `# Next: COMMAND` is a command to
type after it has been written; FILE in such a command stands for the name of the file, STEM for this name without its suffix.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path

from optlink.io import data_files
from optlink.problem.arguments import typed

NEXT = "# Next: "


@dataclass(frozen=True)
class Template:
    """A template: its name, one sentence, the commands to type next, the text of the problem file, and a note on it."""

    name: str
    summary: str
    commands: tuple[str, ...]
    text: str
    note: str = ""


def templates() -> dict[str, Path]:
    """Return names and files of the templates."""
    return data_files("templates")


def template(name: str, file: str | Path | None = None) -> Template:
    """Read a template; `file` is the name of the file in its commands, by default that of the template with the suffix .toml."""
    from optlink.problem.quantity import check_choice

    available = templates()
    check_choice("TEMPLATE", name, available, "no such template")
    return with_commands(name, available[name].read_text(encoding="utf-8"), file or f"{name}.toml")


def with_commands(name: str, text: str, file: str | Path, note: str = "") -> Template:
    """Return a text as a template whose commands name the file."""
    path = Path(file)
    replacements = {"FILE": shlex.quote(str(path)), "STEM": shlex.quote(str(path.with_suffix("")))}
    lines = text.splitlines()
    for word, value in replacements.items():
        lines = [line.replace(word, value) if line.startswith(NEXT) else line for line in lines]
    commands = tuple(line.removeprefix(NEXT) for line in lines if line.startswith(NEXT))
    return Template(name, lines[0].removeprefix("# "), commands, "\n".join(lines) + "\n", note)


@typed
def new(name: str, file: str | Path | None = None) -> str:
    """Return the text of a new problem file: a template that is complete and explains each of its lines in a comment.

    Parameters
    ----------
    name : str
        Name of the template, for example "wiper"; `optlink new --list` shows all.
    file : str or Path, optional
        Name of the file in the commands of its header; default: the name of the template with the suffix .toml.

    Returns
    -------
    str
        A problem file in TOML, for a file that `load` reads.

    Raises
    ------
    InputError
        If there is no such template.
    """
    return template(name, file).text
