"""The commands `list`, `show` and `new`: shipped problems and their contents, templates of problem files."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optlink.cli import console
from optlink.cli.options import PROBLEM_HELP, Json, Quiet, Set, flag, option, problem_names, template_names
from optlink.errors import InputError

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.problem.templates import Template

Shown = Annotated[str, typer.Argument(metavar="PROBLEM", help=PROBLEM_HELP, autocompletion=problem_names, show_default=False)]


def list_problems(as_json: Json = False, quiet: Quiet = False) -> None:
    """List the shipped problems by kind, a line each."""
    from optlink.problem.overview import overview

    entries = overview()
    if as_json:
        rows = [{"name": entry.name, "kind": entry.kind, "title": entry.title} for entry in entries]
        console.print_json({"schema": "optlink/list/1", "problems": rows})
        return
    if console.quiet:
        print("\n".join(entry.name for entry in entries))
        return
    columns = max(len(entry.name) for entry in entries)
    for purpose in sorted({entry.purpose for entry in entries}):
        group = [entry for entry in entries if entry.purpose == purpose]
        print(f"{purpose.capitalize()}: {group[0].command}")
        print(*(f"  {entry.name:{columns}}  {entry.title}" for entry in group), "", sep="\n")
    print("optlink show NAME prints a problem.")


def show(
    problem: Shown = "",
    changes: Set = None,
    schema: Annotated[
        str,
        option(
            "KIND",
            "Print the JSON schema of problem files (KIND problem), of all results (result), or of a kind of result.",
            "--schema",
        ),
    ] = "",
    as_toml: Annotated[bool, flag("Print a problem file, as a template for your own.", "--toml")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show a problem with units and default values."""
    from optlink.problem.file import complete

    if schema:
        from optlink.presentation.registry import json_schema

        console.refuse({"PROBLEM": problem or None}, "a schema does not depend on the problem", "Leave it out", "show --schema")
        console.print_json(json_schema(schema))
        return
    if not problem:
        raise InputError("no problem is named", "Name one, see `optlink list`; or give --schema", key="PROBLEM")
    file = console.load(problem, changes)
    if as_json:
        document = {"schema": "optlink/problem/1", "name": file.name, "problem_hash": file.hash}
        console.print_json(document | {"problem": complete(file)})
        return
    if console.quiet and not as_toml:
        print(f"{file.name}: {file.kind}")
        return
    if as_toml:
        print(_template(file, problem), end="")
        return
    from optlink.presentation.views import problem_tables

    console.show(problem_tables.problem(file))


def _template(problem: ProblemFile, name: str = "") -> str:
    """Return a problem with default limits as TOML text, with the comments and the spellings of its file."""
    from optlink.presentation.files import is_result
    from optlink.problem.document import stored_problem
    from optlink.problem.file import complete
    from optlink.problem.toml_text import rewritten, tables

    if is_result(name):
        text = stored_problem(problem)["toml"]
    else:
        path = Path(name) if name.endswith(".toml") else problem.folder / os.path.basename(problem.file_name)
        text = path.read_text(encoding="utf-8-sig")
    return rewritten(text, tables(text), complete(problem))


NAME_HELP = "Name of the template. Default: list the templates."
FROM_HELP = (
    "Instead of a template: a drawing of a path (foot.svg, or foot.svg#NAME if it has several), "
    "a file of Linkage (.linkage2) or pylinkage (JSON), or a share link of PMKS+."
)
Name = Annotated[str, typer.Argument(metavar="TEMPLATE", autocompletion=template_names, help=NAME_HELP, show_default=False)]


def new(
    name: Name = "",
    listed: Annotated[bool, flag("List the templates.", "--list")] = False,
    source: Annotated[str | None, option("SOURCE", FROM_HELP, "--from")] = None,
    out: Annotated[Path | None, option("FILE", "File to write. Default: standard output.", "-o", "--out")] = None,
    force: Annotated[bool, flag("Overwrite an existing file.", "--force")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a new problem file from a template that is complete and commented: change its values and solve it."""
    from optlink.problem.templates import template, templates

    if source is not None:
        console.refuse(
            {"TEMPLATE": name or None, "--list": listed or None}, "the file comes from another program", "Leave it out", "--from"
        )
    elif listed or not name:
        console.refuse({"--out": out, "--force": force}, "--list writes no file", "Name a template: new law")
        choices = [template(item) for item in templates()]
        if as_json:
            rows = [{"name": item.name, "summary": item.summary, "commands": item.commands} for item in choices]
            console.print_json({"schema": "optlink/templates/1", "templates": rows})
            return
        if console.quiet:
            print("\n".join(templates()))
            return
        from optlink.presentation.table_spec import table

        note = "Write one: optlink new NAME --out NAME.toml"
        rows_shown = ((item.name, item.summary, item.commands[0]) for item in choices)
        console.show(table("Templates", ["name", "description", "next command"], rows_shown, notes=[note]))
        return
    if out is not None:
        _check(out, force)
    text = template(name, out) if source is None else _foreign(source, out)
    if out is not None:
        from optlink.io import whole

        with whole(out) as temporary:
            temporary.write_text(text.text, encoding="utf-8", errors="backslashreplace")
    if as_json:
        document = {"schema": "optlink/template/1", "name": name, "summary": text.summary, "commands": text.commands}
        console.print_json(document | {"file": None if out is None else str(out), "text": text.text})
    elif out is None:
        print(text.text, end="")
        if not console.quiet and source is None:
            print(f"Next: optlink new {name} --out {name}.toml", file=sys.stderr)
    else:
        print(f"Written: {out}" if console.quiet else f"Written: {out}. Next: {text.commands[0]}")
    if text.note and not console.quiet:
        print(f"Note: {text.note}", file=sys.stderr)


def _foreign(source: str, out: Path | None) -> Template:
    """Return the problem file of a path in a drawing, or of a linkage of another program."""
    from optlink.problem import drawn_path
    from optlink.problem.foreign import problem_text
    from optlink.problem.templates import Template, with_commands

    if drawn_path.names_drawing(source):
        text, note = drawn_path.problem_text(source, out)
        return with_commands("", text, out or "mine.toml", note)
    commands = (f"optlink analyze {shlex.quote(str(out or 'mine.toml'))}",)
    return Template("", "Linkage of another program", commands, problem_text(source))


def _check(out: Path, force: bool) -> None:
    """Refuse a file that cannot be written, and one that exists unless it may be overwritten."""
    from optlink.presentation.files import check_target

    check_target(out, (".toml",), "mine.toml")
    if out.exists() and not force:
        raise InputError("the file exists", "Choose another name, or add --force", key="--out", value=str(out))
