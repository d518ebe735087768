"""Views by kind of result: the table of the terminal, the files of --out, the page of a stored result.

Each is imported when it is used: a table needs no plotting library.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.report.view import write_files

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.record import ResultRecord
    from optlink.report.stored.stored_study import Studied
    from optlink.report.table_spec import Summary


@dataclass(frozen=True)
class View:
    """What is shown of a kind of result.

    Parameters
    ----------
    table : function of a result
        Returns what the terminal shows.
    files : function of a result and a folder
        Writes result.json, tables and pictures.
    """

    table: Callable[[Any], Summary]
    files: Callable[[Any, Path], object]


REGISTERED: dict[str, View] = {}
"""Views of further kinds of results by the name of the kind."""


def table_of(kind: str) -> Callable[[Any], Summary]:
    """Import the function that shows results of a kind in the terminal.

    Raises
    ------
    KeyError
        if no view of that kind exists.
    """
    match kind:
        case "function":
            from optlink.report.views.function_tables import result as function_table

            return function_table
        case "path":
            from optlink.report.views.path_tables import generation as path_table

            return path_table
        case "cycle":
            from optlink.report.views.cycle_tables import machine_design as cycle_table

            return cycle_table
        case "balance":
            from optlink.report.views.balance_tables import balance as balance_table

            return balance_table
        case "analysis":
            from optlink.report.views.analysis_tables import analysis as analysis_table

            return analysis_table
        case "simulation":
            from optlink.report.views.analysis_tables import simulation as simulation_table

            return simulation_table
        case "clearance":
            from optlink.report.views.clearance_tables import simulation as clearance_table

            return clearance_table
        case "sensitivity":
            from optlink.report.views.study_tables import sensitivities as sensitivity_table

            return sensitivity_table
        case "sweep":
            from optlink.report.views.study_tables import sweep as sweep_table

            return sweep_table
        case "tolerance":
            from optlink.report.views.tolerance_tables import tolerances as tolerance_table

            return tolerance_table
        case "pareto":
            from optlink.report.views.pareto_tables import front as pareto_table

            return pareto_table
    return REGISTERED[kind].table


def files_of(kind: str) -> Callable[[Any, Path], object]:
    """Import the function that writes the files of results of a kind.

    Raises
    ------
    KeyError
        if no view of that kind exists.
    """
    match kind:
        case "function":
            from optlink.report.views.function import VIEW as FUNCTION

            return partial(write_files, FUNCTION)
        case "path":
            from optlink.report.views.path import VIEW as PATH

            return partial(write_files, PATH)
        case "cycle":
            from optlink.report.views.cycle import VIEW as CYCLE

            return partial(write_files, CYCLE)
        case "balance":
            from optlink.report.views.balance import VIEW as BALANCE

            return partial(write_files, BALANCE)
        case "analysis":
            from optlink.report.views.analysis import VIEW as ANALYSIS

            return partial(write_files, ANALYSIS)
        case "simulation":
            from optlink.report.views.simulation import VIEW as SIMULATION

            return partial(write_files, SIMULATION)
        case "clearance":
            from optlink.report.views.clearance import VIEW as CLEARANCE

            return partial(write_files, CLEARANCE)
        case "control comparison":
            from optlink.report.views.control_comparison import VIEW as CONTROL_COMPARISON

            return partial(write_files, CONTROL_COMPARISON)
        case "sweep":
            from optlink.report.views.sweep import VIEW as SWEEP

            return partial(write_files, SWEEP)
        case "sensitivity":
            from optlink.report.views.sensitivity import VIEW as SENSITIVITY

            return partial(write_files, SENSITIVITY)
        case "tolerance":
            from optlink.report.views.tolerance_pictures import write_all as tolerance_files

            return tolerance_files
        case "pareto":
            from optlink.report.views.pareto import VIEW as PARETO

            return partial(write_files, PARETO)
    return REGISTERED[kind].files


def page_of(kind: str) -> Callable[[Any, ProblemFile, Path], Studied]:
    """Import the function that makes a page of a stored result of a kind.

    Raises
    ------
    KeyError
        if results of that kind are not shown as stored.
    """
    match kind:
        case "simulation":
            from optlink.report.views.simulation_page import studied as simulation_page

            return simulation_page
        case "clearance":
            from optlink.report.views.clearance_page import studied as clearance_page

            return clearance_page
        case "control comparison":
            from optlink.report.views.clearance_page import compared as control_comparison_page

            return control_comparison_page
        case "balance":
            from optlink.report.views.balance_page import studied as balance_page

            return balance_page
        case "sweep":
            from optlink.report.views.sweep import studied as sweep_page

            return sweep_page
        case "tolerance":
            from optlink.report.views.tolerance_page import studied as tolerance_page

            return tolerance_page
        case "pareto":
            from optlink.report.views.pareto import studied as pareto_page

            return pareto_page
    raise KeyError(kind)


def record_of(kind: str) -> type[ResultRecord]:
    """Import the record of results of a kind.

    Raises
    ------
    KeyError
        if there are no results of that kind.
    """
    match kind:
        case "simulation":
            from optlink.tasks.simulate import SimulationRecord

            return SimulationRecord
        case "clearance":
            from optlink.tasks.results.clearance import ClearanceRecord

            return ClearanceRecord
        case "control comparison":
            from optlink.tasks.control_comparison import ComparisonRecord

            return ComparisonRecord
        case "balance":
            from optlink.tasks.results.balance import BalanceRecord

            return BalanceRecord
        case "sweep":
            from optlink.studies.sweep import SweepRecord

            return SweepRecord
        case "tolerance":
            from optlink.studies.tolerance.analysis import ToleranceRecord

            return ToleranceRecord
        case "pareto":
            from optlink.studies.pareto.epsilon_constraint import ParetoRecord

            return ParetoRecord
    raise KeyError(kind)
