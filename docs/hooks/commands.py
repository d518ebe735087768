"""The reference of the command line, made from the commands themselves: every command, argument, option, default and help.

MkDocs calls `on_page_markdown`; the tests call `reference` and `commands`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import typer.main

from optlink.cli.app import app

MARKER = "<!-- commands -->"
NAME = "optlink"


def commands() -> Iterator[tuple[str, Any]]:
    """Every command with its full name ("optlink study sweep"), groups before what is in them."""
    yield from _below(NAME, typer.main.get_command(app))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    yield name, command
    for key, inner in getattr(command, "commands", {}).items():
        yield from _below(f"{name} {key}", inner)


def options(command: Any) -> list[Any]:
    """Its options, without the one for help that all have."""
    return [param for param in command.params if param.param_type_name == "option"]


def spelled(command: Any, name: str, option: Any) -> str:
    """An option as people write it, with what it takes."""
    record = option.get_help_record(command.context_class(command, info_name=name))
    return f"`{record[0]}`"


def default(option: Any) -> str:
    """What counts where it is left out; empty for nothing and for flags."""
    if option.required:
        return "required"
    known = option.default
    if option.is_flag or option.multiple or known is None or callable(known):
        return ""
    return f"`{getattr(known, 'value', known)}`"


def reference() -> str:
    """The whole reference as Markdown."""
    return "\n\n".join(_section(name, command) for name, command in commands())


def _section(name: str, command: Any) -> str:
    lines = [f"## {name} {{ #{name.replace(' ', '-')} }}", "", " ".join((command.help or "").split()), ""]
    inner = getattr(command, "commands", {})
    arguments = [param for param in command.params if param.param_type_name == "argument"]
    usage = " ".join([name, *(["[OPTIONS]"] if command.params else []), *(str(a.metavar) for a in arguments)])
    lines += ["```text", usage + (" COMMAND" if inner else ""), "```", ""]
    if inner:
        lines += ["| command | what it does |", "|---|---|"]
        for key, one in inner.items():
            lines.append(f"| [`{key}`](#{name.replace(' ', '-')}-{key}) | {_cell(one.help)} |")
        lines.append("")
    rows = [(f"`{a.metavar}`", "required" if a.required else "", a.help) for a in arguments]
    rows += [(spelled(command, name, option), default(option), option.help) for option in options(command)]
    if rows:
        lines += ["| argument or option | left out | what it is |", "|---|---|---|"]
        lines += [f"| {_cell(spelling)} | {_cell(left)} | {_cell(told)} |" for spelling, left, told in rows]
    return "\n".join(lines)


def _cell(text: str | None) -> str:
    return " ".join((text or "").split()).replace("|", "\\|")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """MkDocs: put the reference where a page asks for it."""
    return markdown.replace(MARKER, reference()) if MARKER in markdown else markdown


if __name__ == "__main__":
    sys.stdout.write(reference() + "\n")
