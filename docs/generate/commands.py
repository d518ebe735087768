"""Reference of the command line: every command, argument, option, default and help text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer.main

from optlink.cli.app import app

NAME = "optlink"


def commands() -> Iterator[tuple[str, Any]]:
    """Yield every command with its full name ("optlink study sweep"), groups before their commands."""
    yield from _below(NAME, typer.main.get_command(app))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    yield name, command
    for key, inner in getattr(command, "commands", {}).items():
        yield from _below(f"{name} {key}", inner)


def options(command: Any) -> list[Any]:
    """Return the options of a command, without --help."""
    return [param for param in command.params if param.param_type_name == "option"]


def spelled(command: Any, name: str, option: Any) -> str:
    """Return an option with its metavariable, as in the help."""
    record = option.get_help_record(command.context_class(command, info_name=name))
    return f"`{record[0]}`"


def default(option: Any) -> str:
    """Return the default of an option; empty without a default and for flags."""
    if option.required:
        return "required"
    known = option.default
    if option.is_flag or option.multiple or known in (None, "") or callable(known):
        return ""
    return f"`{getattr(known, 'value', known)}`"


def reference() -> str:
    """Return the complete reference as Markdown."""
    return "\n\n".join(_section(name, command) for name, command in commands())


def _section(name: str, command: Any) -> str:
    lines = [f"## {name}", "", " ".join((command.help or "").split()), ""]
    inner = getattr(command, "commands", {})
    arguments = [param for param in command.params if param.param_type_name == "argument"]
    usage = " ".join([name, *(["[OPTIONS]"] if command.params else []), *(str(a.metavar) for a in arguments)])
    lines += ["```text", usage + (" COMMAND" if inner else ""), "```", ""]
    if inner:
        lines += ["| command | purpose |", "|---|---|"]
        for key, one in inner.items():
            lines.append(f"| [`{key}`](#{name.replace(' ', '-')}-{key}) | {_cell(one.help)} |")
        lines.append("")
    rows = [(f"`{a.metavar}`", "required" if a.required else "", a.help) for a in arguments]
    rows += [(spelled(command, name, option), default(option), option.help) for option in options(command)]
    if rows:
        lines += ["| argument or option | default | description |", "|---|---|---|"]
        lines += [f"| {_cell(spelling)} | {_cell(left)} | {_cell(told)} |" for spelling, left, told in rows]
    return "\n".join(lines)


def _cell(text: str | None) -> str:
    return " ".join((text or "").split()).replace("|", "\\|")
