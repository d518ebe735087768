"""The commands `list` and `show`: shipped problems and their contents."""

from __future__ import annotations

from typing import Annotated

import typer

from optlink.cli import console
from optlink.cli.options import PROBLEM_HELP, Json, Set
from optlink.errors import Fault, InputError

Shown = Annotated[str, typer.Argument(metavar="PROBLEM", help=PROBLEM_HELP, show_default=False)]


def register(app: typer.Typer) -> None:
    """Register the commands."""
    app.command("list")(list_problems)
    app.command()(show)


def list_problems(as_json: Json = False) -> None:
    """List the shipped problems with their kind and a summary."""
    with console.reported(as_json):
        from optlink.problem.file import load, shipped

        files = [load(name) for name in shipped()]
        if as_json:
            rows = [{"name": f.name, "kind": f.kind, "title": f.model.title} for f in files]
            console.print_json({"schema": "optlink/list/1", "problems": rows})
            return
        from optlink.report import terminal
        from optlink.report.views import function_tables

        terminal.show(function_tables.listing(files))


def show(
    problem: Shown = "",
    changes: Set = None,
    schema: Annotated[
        str,
        typer.Option(
            "--schema", metavar="KIND", help="Print the JSON schema of a kind of result in place of a problem; of all: result."
        ),
    ] = "",
    as_toml: Annotated[bool, typer.Option("--toml", help="Print a problem file, as a template for your own.")] = False,
    as_json: Json = False,
) -> None:
    """Show a problem with units and default values."""
    with console.reported(as_json):
        from optlink.problem.file import complete

        if schema:
            from optlink.report.registry import json_schema

            console.refuse(
                {"PROBLEM": problem or None}, "a schema is the same for every problem", "Leave it out", "show --schema"
            )
            console.print_json(json_schema(schema))
            return
        if not problem:
            raise InputError(Fault("no problem is named", "Name one, see `optlink list`; or give --schema", key="PROBLEM"))
        file = console.load(problem, changes)
        if as_json:
            document = {"schema": "optlink/problem/1", "name": file.name, "problem_hash": file.hash}
            console.print_json(document | {"problem": complete(file)})
            return
        if as_toml:
            import tomli_w

            print(tomli_w.dumps(complete(file)), end="")
            return
        from optlink.report import terminal
        from optlink.report.views import function_tables

        terminal.show(function_tables.problem(file))
