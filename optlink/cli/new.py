"""The command `new`: a commented template as the start of a problem file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from optlink.cli import console
from optlink.cli.completion import template_names
from optlink.cli.options import Json, Quiet, flag, option

NAME_HELP = "Name of the template. Default: list the templates."
Name = Annotated[str, typer.Argument(metavar="TEMPLATE", autocompletion=template_names, help=NAME_HELP, show_default=False)]


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(new)


def new(
    name: Name = "",
    listed: Annotated[bool, flag("List the templates.", "--list")] = False,
    out: Annotated[Path | None, option("FILE", "File to write. Default: standard output.", "-o", "--out")] = None,
    force: Annotated[bool, flag("Overwrite an existing file.", "--force")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a new problem file from a template that is complete and commented: change its values and solve it."""
    from optlink.problem.templates import template, templates

    if listed or not name:
        console.refuse({"--out": out, "--force": force}, "a list is not written to a file", "Name a template: new law")
        found = [template(one) for one in templates()]
        if as_json:
            rows = [{"name": one.name, "summary": one.summary, "commands": one.commands} for one in found]
            console.print_json({"schema": "optlink/templates/1", "templates": rows})
            return
        if console.quiet:
            print("\n".join(templates()))
            return
        from optlink.report.table_spec import table

        note = "Write one: optlink new NAME --out NAME.toml"
        rows_shown = ((one.name, one.summary, one.commands[0]) for one in found)
        console.show(table("Templates", ["name", "what it is", "then type"], rows_shown, notes=[note]))
        return
    if out is not None:
        _check(out, force)
    made = template(name, out)
    if out is not None:
        from optlink.io import whole

        with whole(out) as temporary:
            temporary.write_text(made.text, encoding="utf-8")
    if as_json:
        document = {"schema": "optlink/template/1", "name": name, "summary": made.summary, "commands": made.commands}
        console.print_json(document | {"file": None if out is None else str(out), "text": made.text})
    elif out is None:
        print(made.text, end="")
        if not console.quiet:
            print(f"Next: optlink new {name} --out {name}.toml", file=sys.stderr)
    else:
        print(f"Written: {out}" if console.quiet else f"Written: {out}. Next: {made.commands[0]}")


def _check(out: Path, force: bool) -> None:
    """Refuse a file that cannot be written, and one that exists unless it may be overwritten."""
    from optlink.errors import Fault, InputError
    from optlink.report.export.export import target

    target(out, (".toml",), "mine.toml")
    if out.exists() and not force:
        raise InputError(Fault("the file exists", "Choose another name, or add --force", key="--out", value=str(out)))
