"""Views by kind of result: the table of the terminal, the files of --out, the page of a stored result.

Each is imported when it is used: a table needs no plotting library.
"""

from collections.abc import Callable
from typing import Any

from optlink.problem.document import Document
from optlink.report.table_spec import Summary
from optlink.report.view import View

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


def table_of(kind: str) -> Callable[[Any], Summary]:
    """Import the function that shows results of a kind in the terminal, without a plotting library.

    Raises
    ------
    KeyError
        if no view of that kind exists.
    """
    if kind == "design":
        from optlink.report.views.design_tables import design_result

        return design_result
    if kind == "analysis":
        from optlink.report.views.analysis_tables import analysis

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
            from optlink.report.views import design

            return design.VIEW
        case "balance":
            from optlink.report.views import balance

            return balance.VIEW
        case "analysis":
            from optlink.report.views import analysis

            return analysis.VIEW
        case "simulation":
            from optlink.report.views import simulation

            return simulation.VIEW
        case "clearance":
            from optlink.report.views import clearance

            return clearance.VIEW
        case "control comparison":
            from optlink.report.views import control_comparison

            return control_comparison.VIEW
        case "sweep":
            from optlink.report.views import sweep

            return sweep.VIEW
        case "sensitivity":
            from optlink.report.views import sensitivity

            return sensitivity.VIEW
        case "output sensitivity":
            from optlink.studies.motion_sensitivity import OutputStudy

            return View(result=OutputStudy, no_page="Read the derivatives of an output in the sensitivity.csv beside it")
        case "tolerance":
            from optlink.report.views import tolerance

            return tolerance.VIEW
        case "pareto":
            from optlink.report.views import pareto

            return pareto.VIEW
        case "tuning":
            from optlink.report.views import control_comparison

            return control_comparison.TUNING
        case _:
            raise KeyError(kind)


def result_class(kind: str) -> type[Document] | None:
    """Import the class of the results of a kind; None if there are none."""
    return view_of(kind).result if kind in KINDS or kind in REGISTERED else None


def json_schema(kind: str) -> dict[str, Any]:
    """Return the JSON schema of the document of a kind of result, or of any result.

    Parameters
    ----------
    kind : str
        "result" for any.

    Raises
    ------
    InputError
        If the kind is unknown.
    """
    from optlink.problem.quantity import check_choice

    check_choice("--schema", kind, ["result", *KINDS], "no such kind of result")
    schemas = [one.json_schema() for name in KINDS if kind in ("result", name) and (one := result_class(name)) is not None]
    parts = {name: part for schema in schemas for name, part in schema.pop("$defs", {}).items()}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"optlink {kind}",
        "$defs": dict(sorted(parts.items())),
        "anyOf": schemas,
    }
