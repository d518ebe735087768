"""Tables of a cycle optimisation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from optlink.errors import Status
from optlink.problem.cycle.model import CycleProblem, StrokeProblem
from optlink.report.format import change, dimension, fixed, number, times
from optlink.report.table_spec import Line, Paragraph, Part, Row, Summary, TableSpec, noted, quiet, strong, summary, table
from optlink.report.views.analysis_tables import machine_strokes
from optlink.report.views.function_tables import active, checks, ending, graded, search_verdict
from optlink.report.views.relaxations import conflict
from optlink.solvers.solution import LimitState
from optlink.tasks.results.cycle import CycleResult
from optlink.units import factor


def cycle_result(outcome: CycleResult) -> Summary:
    """Summarise a cycle optimisation: design, cycle quantities, active constraints, validation, optima."""
    limits: Part | None = None
    if outcome.conflict:
        limits = conflict(outcome.conflict, outcome.together)
    elif outcome.solution is not None:
        limits = priced(outcome, outcome.solution.limits)
    return summary(
        outcome.task.title,
        _status(outcome),
        _sizes(outcome),
        _figures(outcome),
        machine_strokes(outcome.built, outcome.task.drive.speed.value) if outcome.built is not None else None,
        limits,
        checks(outcome.validation.checks),
        _optima(outcome) if len(outcome.optima) > 1 else None,
        _backends(outcome) if len(outcome.backends) > 1 else None,
        Paragraph(quiet(f"{outcome.backend}, {outcome.starts} starts; {times(outcome.seconds)}"), appendix=True),
    )


def priced(outcome: CycleResult, limits: Iterable[LimitState]) -> Part:
    """Tabulate the active constraints with their shadow prices in the display unit of the objective.

    Parameters
    ----------
    outcome : CycleResult
    limits : iterable of LimitState
        Multipliers of the minimised objective [SI], which is the negative of a maximised quantity.
    """
    size = 1.0 / factor(outcome.unit, outcome.task.unit_kind) if outcome.unit else 1.0
    if outcome.task.single and outcome.task.goals[0].sense == "maximise":
        size = -size
    scaled = [replace(limit, multiplier=limit.multiplier * size) for limit in limits]
    return active(scaled, outcome.objective * size, outcome.unit)


def cycle_problem(task: CycleProblem) -> TableSpec:
    """List the objective and the limits of a problem."""
    rows = []
    for goal in task.goals:
        share = "" if task.single else f"weight {goal.weight:g}" + (f" per {goal.scale}" if goal.scale is not None else "")
        rows.append((f"{goal.sense}", goal.words, share))
    rows += [(bound.name, bound.term.words, str(bound.interval)) for bound in task.bounds]
    default = "" if "alignment" in task.limits.model_fields_set else ", default"
    rows.append(("alignment", "every joint off alignment", f"at least {task.limits.alignment}{default}"))
    required = "[requirement], " if isinstance(task, StrokeProblem) else ""
    return table(f"{required}[objective] and [limits]", "<<<", rows)


def _status(outcome: CycleResult) -> Iterator[Line]:
    line = search_verdict(outcome.status, "valid" if outcome.valid else "not valid", outcome.valid)
    yield from graded(line, outcome.fit if outcome.valid else None, f"; {outcome.comparison}" if outcome.comparison else "")
    yield from noted(outcome.notes)
    yield ending(outcome.status, outcome.starts)


def _sizes(outcome: CycleResult) -> TableSpec:
    rows = []
    for name, value in outcome.design.items():
        quantity = outcome.task.quantities[name]
        size, unit = quantity.display
        low, high = (bound * size for bound in quantity.bounds)
        rows.append(
            (name, strong(dimension(value * size)), unit, dimension(quantity.value * size), quiet(f"{low:g} ... {high:g}"))
        )
    title = "Design" if outcome.status is not Status.INFEASIBLE else "Nearest design found (it does not meet the limits)"
    return table(title, ["", ">result", "", ">initial", ""], rows)


def _figures(outcome: CycleResult) -> TableSpec:
    rows: list[Row] = []
    for one in outcome.figures:
        shown = change(one.result / one.initial - 1.0 if one.initial and math.isfinite(one.initial) else math.nan)
        rows.append((one.words, number(one.initial), strong(number(one.result)), one.unit, shown, quiet(one.limit)))
    if not outcome.task.single:
        rows.append(("weighted sum", "", strong(number(outcome.objective, 8)), "", "", quiet("minimised")))
    return table("Objective and limits, measured over the cycle", ["", ">initial", ">result", "", ">change", "limit"], rows)


def _optima(outcome: CycleResult) -> TableSpec:
    free = list(outcome.design)[:4]
    reached = sum(optimum.count for optimum in outcome.optima)
    rows = []
    for optimum in outcome.optima[:8]:
        values = [dimension(optimum.design[name] * outcome.task.quantities[name].display[0]) for name in free]
        rows.append((number(optimum.objective, 7), *values, str(optimum.count)))
    title = f"Distinct optima: {len(outcome.optima)}, reached by {reached} searches"
    return table(title, [">objective", *(f">{name}" for name in free), ">searches"], rows, appendix=True)


def _backends(outcome: CycleResult) -> TableSpec:
    found = outcome.backends.values()
    rows = [
        ("status", *(solution.status.value for solution in found), ""),
        ("objective", *(number(solution.objective, 9) for solution in found), outcome.unit),
    ]
    for name in outcome.design:
        size, unit = outcome.task.quantities[name].display
        rows.append((name, *(fixed(solution.design[name] * size, 5) for solution in found), unit))
    rows.append(("KKT residual", *(f"{solution.kkt:.1e}" for solution in found), ""))
    return table("Back ends", ["", *(f">{name}" for name in outcome.backends), ""], rows, appendix=True)
