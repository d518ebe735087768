"""Views by kind of result: the table of the terminal, the files of --out, the page of a stored result.

Each is imported when it is used: a table needs no plotting library.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.errors import InputError
from optlink.io import load_extensions
from optlink.presentation.format import single_units
from optlink.presentation.table_spec import Summary
from optlink.presentation.view import View
from optlink.problem.arguments import typed
from optlink.problem.document import VERSION_OF_SCHEMAS, Document, Result, read_document

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optlink.presentation.report_model import ReportModel
    from optlink.presentation.view import StoredStudy


REGISTERED: dict[str, View] = {}
"""Views of further kinds of results by the name of the kind."""
KINDS = {
    "design": "solve",
    "analysis": "analyze",
    **dict.fromkeys(("simulation", "clearance"), "simulate"),
    "control comparison": "simulate --control compare",
    "tuning": "simulate --tune",
    "balance": "balance",
    **{kind: f"study {kind}" for kind in ("sensitivity", "sweep", "tolerance", "pareto")},
    "output sensitivity": "study sensitivity --quantity",
}
"""Kinds of stored results, and the commands that write them."""
RESULTS = {
    "design": "optlink.tasks.results.design:SynthesisResult",
    "analysis": "optlink.tasks.analyze:Analysis",
    "simulation": "optlink.tasks.simulate:Simulation",
    "clearance": "optlink.tasks.results.clearance:ClearanceSimulation",
    "control comparison": "optlink.tasks.results.clearance:Comparison",
    "tuning": "optlink.tasks.results.clearance:Tuning",
    "balance": "optlink.tasks.results.balance:Balance",
    "sensitivity": "optlink.studies.sensitivity:Sensitivities",
    "sweep": "optlink.studies.sweeps:Sweep",
    "tolerance": "optlink.studies.tolerances.analysis:Tolerance",
    "pareto": "optlink.studies.fronts.epsilon_constraint:Pareto",
    "output sensitivity": "optlink.studies.motion_sensitivity:OutputStudy",
}
"""Classes of stored results by kind, read without the view of the kind, which draws."""
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
    if kind in REGISTERED:
        return REGISTERED[kind]
    match kind:
        case "design":
            from optlink.presentation.views import design

            return design.VIEW
        case "balance":
            from optlink.presentation.views import balance

            return balance.VIEW
        case "analysis":
            from optlink.presentation.views import analysis

            return analysis.VIEW
        case "simulation":
            from optlink.presentation.views import simulation

            return simulation.VIEW
        case "clearance":
            from optlink.presentation.views import clearance

            return clearance.VIEW
        case "control comparison":
            from optlink.presentation.views import control_comparison

            return control_comparison.VIEW
        case "sweep":
            from optlink.presentation.views import sweep

            return sweep.VIEW
        case "sensitivity":
            from optlink.presentation.views import sensitivity

            return sensitivity.VIEW
        case "output sensitivity":
            return View(no_page="Read the derivatives of an output in the sensitivity.csv beside it")
        case "tolerance":
            from optlink.presentation.views import tolerance

            return tolerance.VIEW
        case "pareto":
            from optlink.presentation.views import pareto

            return pareto.VIEW
        case "tuning":
            from optlink.presentation.views import control_comparison

            return control_comparison.TUNING
        case _:
            raise KeyError(kind)


def result_class(kind: str) -> type[Document] | None:
    """Import the class of the results of a kind; None if there are none."""
    if kind in REGISTERED:
        return REGISTERED[kind].result
    module, _, name = RESULTS.get(kind, "").partition(":")
    return getattr(import_module(module), name) if module else None


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
    schemas = [one.json_schema() for name in KINDS if kind in ("result", name) and (one := result_class(name)) is not None]
    parts = {name: part for schema in schemas for name, part in schema.pop("$defs", {}).items()}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"optlink {kind}",
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
    schema = document.get("schema")
    kind = str(schema).removeprefix("optlink/").rpartition("/")[0].replace("-", " ")
    known = result_class(kind)
    if known is None or known.schema() != schema:
        raise _unknown(schema, kind, place)
    return known.from_dict(document, place)


def _unknown(schema: object, kind: str, path: Path) -> InputError:
    """Return the error for a document of another schema."""
    number = str(schema).rpartition("/")[2]
    if number.isdecimal() and int(number) > VERSION_OF_SCHEMAS and str(schema).startswith("optlink/"):
        return InputError(
            "the result has a later format than this version of optlink reads", "Update optlink", str(path), "schema", schema
        )
    if (command := KINDS.get(kind, "solve" if kind in FORMER else "")) != "":
        remedy = f"Run `{command}` again, or use the version of optlink that wrote it"
        return InputError("the result has the format of another version", remedy, str(path), "schema", schema)
    commands = ", ".join(dict.fromkeys(KINDS.values()))
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
        return view.page(result)
