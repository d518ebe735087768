"""Views by kind of result: the table of the terminal, the files of --out, the page of a stored result.

Each is imported when it is used: a table needs no plotting library.
"""

from collections.abc import Callable
from typing import Any, get_args

from optlink.problem.base_model import ResultRecord
from optlink.report.table_spec import Summary
from optlink.report.view import View

REGISTERED: dict[str, View] = {}
"""Views of further kinds of results by the name of the kind."""


def table_of(kind: str) -> Callable[[Any], Summary]:
    """Import the function that shows results of a kind in the terminal.

    Raises
    ------
    KeyError
        if no view of that kind exists.
    """
    tables: dict[str, Callable[[Any], Summary]] = {name: view.table for name, view in REGISTERED.items()}
    match kind:
        case "function":
            from optlink.report.views.function_tables import result as function_table

            return function_table
        case "path":
            from optlink.report.views.path_tables import path_result as path_table

            return path_table
        case "cycle":
            from optlink.report.views.cycle_tables import cycle_result as cycle_table

            return cycle_table
        case "balance":
            from optlink.report.views.balance_tables import balance as balance_table

            return balance_table
        case "analysis" | "simulation":
            from optlink.report.views import analysis_tables as analysed

            tables = {"analysis": analysed.analysis, "simulation": analysed.simulation}
        case "clearance" | "control comparison" | "tuning":
            from optlink.report.views import clearance_tables as simulated

            tables = {"clearance": simulated.simulation, "control comparison": simulated.comparison, "tuning": simulated.tuning}
        case "sensitivity" | "sweep" | "pareto":
            from optlink.report.views import study_tables as studied

            tables = {"sensitivity": studied.sensitivities, "sweep": studied.sweep, "pareto": studied.pareto_front}
        case "tolerance":
            from optlink.report.views.tolerance_tables import tolerances as tolerance_table

            return tolerance_table
    return tables[kind]


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
        case "function":
            from optlink.report.views import function

            return function.VIEW
        case "path":
            from optlink.report.views import path

            return path.VIEW
        case "cycle":
            from optlink.report.views import cycle

            return cycle.VIEW
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
        case "tolerance":
            from optlink.report.views import tolerance

            return tolerance.VIEW
        case "pareto":
            from optlink.report.views import pareto

            return pareto.VIEW
        case "tuning":
            return View()
        case _:
            raise KeyError(kind)


def records() -> dict[str, type[ResultRecord]]:
    """Import the records of all kinds of results."""
    from optlink.studies.motion_sensitivity import OutputSensitivityRecord
    from optlink.studies.pareto.epsilon_constraint import ParetoRecord
    from optlink.studies.sensitivity import SensitivitiesRecord
    from optlink.studies.sweep import SweepRecord
    from optlink.studies.tolerance.analysis import ToleranceRecord
    from optlink.tasks.function import FunctionRecord
    from optlink.tasks.results.analysis import AnalysisRecord
    from optlink.tasks.results.balance import BalanceRecord
    from optlink.tasks.results.clearance import ClearanceRecord
    from optlink.tasks.results.control_comparison import ComparisonRecord
    from optlink.tasks.results.cycle import CycleRecord
    from optlink.tasks.results.path import PathRecord
    from optlink.tasks.simulate import SimulationRecord

    designs = (FunctionRecord, PathRecord, CycleRecord, AnalysisRecord, SensitivitiesRecord, OutputSensitivityRecord)
    machines = (SimulationRecord, ClearanceRecord, ComparisonRecord, BalanceRecord)
    classes = (*designs, *machines, SweepRecord, ToleranceRecord, ParetoRecord)
    return {schema_of(record).split("/")[1].replace("-", " "): record for record in classes}


def schema_of(record: type[ResultRecord]) -> str:
    """Return the only schema that a record takes, "optlink/KIND/VERSION"."""
    [schema] = get_args(record.model_fields["format"].annotation)
    return str(schema)


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
    from pydantic.json_schema import models_json_schema

    from optlink.problem.quantity import check_choice

    classes = records()
    check_choice("--schema", kind, ["result", *classes], "no such kind of result")
    chosen = list(classes.values()) if kind == "result" else [classes[kind]]
    places, schema = models_json_schema([(record, "validation") for record in chosen], title=f"optlink {kind}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "anyOf": [places[record, "validation"] for record in chosen],
    }
