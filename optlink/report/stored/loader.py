"""Loading of results: a result.json of any command, or its folder, and its problem."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field

from optlink.errors import InputError
from optlink.io import shown_name
from optlink.problem.assignment import parse_assignments
from optlink.problem.base_model import Contradiction, Record, ResultRecord, damaged, read_document, read_record
from optlink.problem.file import ProblemFile, load, shipped
from optlink.report.format import single_units
from optlink.report.html.shell import StoredStudy
from optlink.report.registry import REGISTERED, records, view_of
from optlink.report.report_model import ReportModel, report_model_of
from optlink.report.stored.stored_result import read_report_model
from optlink.report.view import View
from optlink.version import VERSION

RESULT = "result.json"


def _by_schema(commands: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return command and kind of results by their schema, from the commands by kind."""
    return {f"optlink/{kind.replace(' ', '-')}/2": (command, kind) for kind, command in commands.items()}


COMPARISON = "simulate --control compare"
SOLVED = _by_schema(dict.fromkeys(("function", "path", "cycle"), "solve") | {"analysis": "analyze"})
SOLVED |= _by_schema({"sensitivity": "study sensitivity"})
"""Schemas of results whose figures are recomputed: the command that writes them, and their kind."""
STUDIES = _by_schema({"simulation": "simulate", "clearance": "simulate", "control comparison": COMPARISON, "balance": "balance"})
STUDIES |= _by_schema({kind: f"study {kind}" for kind in ("sweep", "tolerance", "pareto")})
"""Schemas of results that are shown as stored: the command that writes them, and the kind of their page."""
WITH_PAGE = {**SOLVED, **STUDIES}
DERIVATIVES = "Read the derivatives of an output in the sensitivity.csv beside it"
WITHOUT_PAGE = {
    "optlink/output-sensitivity/2": ("study sensitivity --quantity", DERIVATIVES),
    "optlink/tuning/2": ("simulate --tune", "Read the best parameters in it, under best"),
}
"""Schemas of results that are not drawn: the command that writes them, and where to read them."""
COMMANDS = {name.rpartition("/")[0]: command for name, (command, _) in (WITH_PAGE | WITHOUT_PAGE).items()}
"""Commands by the names of schemas without their version."""


class _Head(Record):
    """Entries of a result document that identify its problem."""

    problem: str
    problem_hash: str
    overrides: dict[str, Any] = Field(default_factory=dict)


def load_stored(
    text: str, problem: str | None = None, changes: Sequence[str] = (), *, priced: bool = True
) -> ReportModel | StoredStudy:
    """Load a result file.

    Parameters
    ----------
    text : str
        Path of a result.json or of its folder.
    problem : str or None, optional
        Its problem; default: searched by name among the shipped problems, beside the file and in the working directory.
    changes : sequence of str, optional
        Assignments KEY=VALUE with which the problem was changed (`--set`).
    priced : bool, optional
        Solve for the shadow prices of an optimum, which a page shows; a drawing needs the design only.

    Raises
    ------
    InputError
        If the file cannot be shown or is damaged, or its problem is missing or a different one.
    """
    folder = os.path.isdir(text)
    path = Path(text) / RESULT if folder else Path(text)
    if folder and not os.path.exists(path):
        remedy = "Give a folder that --out wrote; resume an interrupted study with --resume"
        raise InputError(f"the folder contains no {RESULT}", remedy, text)
    document = read_document(path)
    schema = document.get("schema")
    further = next((view for view in REGISTERED.values() if view.schema and view.schema == schema), None)
    if further is not None:
        return _extension_model(further, document, path, problem, changes)
    if not isinstance(schema, str) or schema not in WITH_PAGE:
        raise _unknown(schema, path)
    _, kind = WITH_PAGE[schema]
    record = read_record(records()[kind], document, path)
    file = problem_of(record, path, problem, changes)
    try:
        if schema in SOLVED:
            report: ReportModel | StoredStudy = read_report_model(record, file, path, priced=priced)
        else:
            with single_units():
                report = replace(view_of(kind).page(record, file, path), notes=(f"shown as recorded in {shown_name(path.name)}",))
    except Contradiction as error:
        raise damaged(error, path) from None
    if record.optlink != VERSION:
        note = f"that file was written by optlink {record.optlink}, this page by {VERSION}"
        report = replace(report, notes=(*report.notes, note))
    return report


def _extension_model(
    view: View, document: dict[str, Any], path: Path, problem: str | None, changes: Sequence[str]
) -> ReportModel:
    """Return the report model of a result of a kind from outside the package."""
    about = read_record(_Head, {name: document[name] for name in _Head.model_fields if name in document}, path)
    file = problem_of(about, path, problem, changes)
    try:
        return report_model_of(file, view.stored(document, file), notes=(f"read from {shown_name(path.name)}",))
    except Contradiction as error:
        raise damaged(error, path) from None


def _unknown(schema: object, path: Path) -> InputError:
    """Return the error for a document of an unknown schema."""
    if not isinstance(schema, str) or not schema.startswith("optlink/"):
        return InputError("not a result of optlink", "Give a result.json that --out wrote", str(path), "schema", schema)
    if schema in WITHOUT_PAGE:
        return InputError("a result of this kind has no page", WITHOUT_PAGE[schema][1], str(path), "schema", schema)
    if command := COMMANDS.get(schema.rpartition("/")[0]):
        remedy = f"Run `{command}` again, or use the version that wrote it"
        return InputError("the result has another format version", remedy, str(path), "schema", schema)
    commands = ", ".join(dict.fromkeys(command for command, _ in WITH_PAGE.values()))
    remedy = f"Give what --out of one of these wrote: {commands}; or the problem itself"
    return InputError("not a result that can be shown here", remedy, str(path), "schema", schema)


def problem_of(about: _Head | ResultRecord, path: Path, problem: str | None = None, changes: Sequence[str] = ()) -> ProblemFile:
    """Return the problem of a result, identified by its hash.

    Parameters
    ----------
    about : record
        Name and hash of the problem, and the changes with which it was solved.
    path : Path
        File of the result.
    problem : str or None, optional
        Path or name of the problem; default: searched by name among the shipped problems, beside the file and in the
        working directory.
    changes : sequence of str, optional
        Assignments KEY=VALUE with which the problem was changed (`--set`); default: those of the record.

    Raises
    ------
    InputError
        If the problem is not found or has a different hash.
    """
    name, expected = about.problem, about.problem_hash
    places = [problem] if problem is not None else list(_places(name, path))
    overrides = parse_assignments(changes) or about.overrides
    hashes = []
    for place in places:
        try:
            file = load(place, overrides)
        except InputError:
            if place == places[-1]:
                raise
            continue  # another problem of this name, without the keys of the changes
        for variant in (file, *file.variants()):
            if variant.hash == expected:
                return variant
        hashes.append(file.hash)
    if not places:
        where = "no shipped problem, and not found beside the result, in the folder above it or in the working directory"
        raise InputError(where, f"Give the path of its file: --problem FOLDER/{name}.toml", str(path), "problem", name)
    difference = f"its problem has the hash {expected}, {places[0]} has {hashes[0]}"
    remedy = "Name the problem file: --problem FILE, and state its changes again by --set; or solve again"
    raise InputError(f"the result is that of another problem or version: {difference}", remedy, str(path), "problem_hash")


def _places(name: str, path: Path) -> Iterator[str]:
    """Yield the possible locations of the problem of a result."""
    if name in shipped():
        yield name
    for folder in (path.parent, path.parent.parent, Path()):
        sibling = folder / f"{name}.toml"
        if "/" not in name and "\\" not in name and os.path.isfile(sibling):
            yield str(sibling)
