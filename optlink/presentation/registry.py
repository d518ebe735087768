"""Kinds of results, and what is shown of each: the table of the terminal, the files of --out, the page of a stored result.

Each is imported when it is used: a table needs no plotting library.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.errors import InputError
from optlink.io import Entry, load_extensions, register
from optlink.presentation.format import single_units
from optlink.presentation.table_spec import Summary
from optlink.presentation.view import PageSection, StoredStudy, View, registered_charts
from optlink.problem.arguments import typed
from optlink.problem.document import Document, Result, read_document
from optlink.problem.upgrades import OLDEST, VERSION_OF_SCHEMAS, kind_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optlink.presentation.report_model import ReportModel


@dataclass(frozen=True)
class ResultKind(Entry):
    """A kind of results: how a stored one is read, and how it is shown.

    Parameters
    ----------
    name : str
        `kind` of their class.
    command : str
        Command that writes them.
    result : function
        Imports and returns their class, a `Document`.
    view : function
        Imports and returns their `View`, which may need a plotting library.
    """

    name: str
    command: str
    result: Callable[[], type[Document]]
    view: Callable[[], View]


def _part(path: str) -> Callable[[], Any]:
    """Return a function that imports a part of optlink, "module:name"."""
    module, _, name = path.partition(":")
    return lambda: getattr(import_module(f"optlink.{module}"), name)


_BUILT_IN = (
    ("design", "solve", "tasks.results.design:SynthesisResult", "design:VIEW"),
    ("analysis", "analyze", "tasks.analyze:Analysis", "analysis:VIEW"),
    ("simulation", "simulate", "tasks.simulate:Simulation", "simulation:VIEW"),
    ("clearance", "simulate", "tasks.results.clearance:ClearanceSimulation", "clearance:VIEW"),
    ("control comparison", "simulate --control compare", "tasks.results.clearance:Comparison", "control_comparison:VIEW"),
    ("tuning", "simulate --tune", "tasks.results.clearance:Tuning", "control_comparison:TUNING"),
    ("balance", "balance", "tasks.results.balance:Balance", "balance:VIEW"),
    ("sensitivity", "study sensitivity", "studies.sensitivity:Sensitivities", "sensitivity:VIEW"),
    ("sweep", "study sweep", "studies.sweeps:Sweep", "sweep:VIEW"),
    ("tolerance", "study tolerance", "studies.tolerances.analysis:Tolerance", "tolerance:VIEW"),
    ("pareto", "study pareto", "studies.fronts.epsilon_constraint:Pareto", "pareto:VIEW"),
    ("output sensitivity", "study sensitivity --quantity", "studies.motion_sensitivity:OutputStudy", "sensitivity:OUTPUTS"),
)
for _name, _command, _result, _view in _BUILT_IN:
    register(ResultKind(_name, _command, _part(_result), _part(f"presentation.views.{_view}")))
KINDS: dict[str, ResultKind] = ResultKind.registry
"""Kinds of stored results."""
RULE = (
    f"Results of number {VERSION_OF_SCHEMAS}, which ends the value of `schema`. Within a number keys may be added, except in "
    "tables by name: pass over those that you do not know. Another number has another schema: there a key may be missing or mean "
    "something else."
)
"""What the schema of results says to programs that read them."""
ONE_MACHINE = ("design", "analysis")
"""Kinds whose page is that of a machine."""


def table_of(kind: str) -> Callable[[Any], Summary]:
    """Import the function that shows results of a kind in the terminal, without a plotting library.

    Raises
    ------
    KeyError
        if no view of that kind exists.
    """
    if kind == "design":
        from optlink.presentation.views.design_tables import design_result

        return design_result
    if kind == "analysis":
        from optlink.presentation.views.analysis_tables import analysis

        return analysis
    return view_of(kind).table


def view_of(kind: str) -> View:
    """Import the view of results of a kind.

    Raises
    ------
    KeyError
        if no view of that kind exists.
    """
    return KINDS[kind].view()


def json_schema(kind: str) -> dict[str, Any]:
    """Return the JSON schema of the document of a kind of result, or of any result; or that of problem files.

    Parameters
    ----------
    kind : str
        "result" for any; "problem".

    Raises
    ------
    InputError
        If the kind is unknown.
    """
    from optlink.problem.quantity import check_choice

    check_choice("--schema", kind, ["problem", "result", *KINDS], "no such kind of document")
    if kind == "problem":
        from optlink.problem.schema import problem_schema

        return problem_schema()
    schemas = [one.result().json_schema() for name, one in KINDS.items() if kind in ("result", name)]
    parts = {name: part for schema in schemas for name, part in schema.pop("$defs", {}).items()}
    about = "" if kind == "result" else f":{kind.replace(' ', '-')}"
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:optlink:result{about}:{VERSION_OF_SCHEMAS}",
        "title": f"optlink {kind}",
        "description": RULE,
        "$defs": dict(sorted(parts.items())),
        "anyOf": schemas,
    }


# Stored results: a result.json of any command, or its folder, read as the result that the command returned.

RESULT = "result.json"
FORMER = ("function", "path", "cycle")
"""Kinds of results of earlier versions, which are now those of a design."""


@typed
def read_result(path: str | Path) -> Result:
    """Read a stored result: the one that the command or the function returned which made it.

    The file alone suffices: it contains its problem.

    Parameters
    ----------
    path : str or Path
        A result.json, or the folder that `--out` wrote.

    Returns
    -------
    Result
        `SynthesisResult`, `Analysis`, `Simulation`, ..., by the kind of result.

    Raises
    ------
    InputError
        If the file is no result of this version of optlink, or was changed since it was written.

    Examples
    --------
    >>> import json, tempfile
    >>> result = optlink.validate(optlink.load("crank-rocker"), {"coupler": 0.412, "rocker": 0.232})
    >>> with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
    ...     _ = file.write(json.dumps(result.to_dict()))
    ...     file.flush()
    ...     optlink.read_result(file.name).valid == result.valid
    True
    """
    text = str(path)
    folder = os.path.isdir(text)
    place = Path(text) / RESULT if folder else Path(text)
    if folder and not place.exists():
        remedy = "Give the folder of a finished command; continue an interrupted study first"
        raise InputError(f"the folder contains no {RESULT}", remedy, text)
    if not place.is_file():
        message = "this is not a regular file" if place.exists() else "no such file"
        raise InputError(message, "Give a stored result.json, the folder it is in, or a problem", key="path", value=text)
    document = read_document(place)
    load_extensions()
    kind, number = kind_of(document.get("schema"))
    known = KINDS[kind].result() if kind in KINDS else None
    if known is None or not OLDEST <= number <= VERSION_OF_SCHEMAS:
        raise _unknown(document.get("schema"), place)
    return known.from_dict(document, place)


def _unknown(schema: object, path: Path) -> InputError:
    """Return the error for a document of a schema that is not read."""
    kind, number = kind_of(schema)
    if number > VERSION_OF_SCHEMAS:
        return InputError(
            "the result has a later format than this version of optlink reads", "Update optlink", str(path), "schema", schema
        )
    if command := KINDS[kind].command if kind in KINDS else "solve" if kind in FORMER else "":
        remedy = f"Run `{command}` again, or use the version of optlink that wrote it"
        return InputError("the result has the format of another version", remedy, str(path), "schema", schema)
    commands = ", ".join(dict.fromkeys(one.command for one in KINDS.values()))
    remedy = f"Give what --out of one of these wrote: {commands}; or the problem itself"
    return InputError("not a result of optlink", remedy, str(path), "schema", schema)


def stored_page(result: Result, facts: Mapping[str, Any], path: str) -> ReportModel | StoredStudy:
    """Return the content of the page of a stored result, with further facts at its head.

    Raises
    ------
    InputError
        If results of this kind have no page.
    """
    from optlink.presentation.report_model import report_model_of

    if facts:
        result = replace(result, problem=result.problem.override(facts))  # type: ignore[type-var]
    if result.kind in ONE_MACHINE:
        return report_model_of(result)  # type: ignore[arg-type]
    view = view_of(result.kind)
    if view.no_page:
        raise InputError("a result of this kind has no page", view.no_page, path, "kind", result.kind)
    if view.page is None:
        return report_model_of(result)  # type: ignore[arg-type]
    with single_units():
        page, further = view.page(result), registered_charts(result)
    if not further or not isinstance(page, StoredStudy):  # the page of a machine has them among its curves
        return page
    return replace(page, sections=(*page.sections, PageSection("Further charts", further)))
