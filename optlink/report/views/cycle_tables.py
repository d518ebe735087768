"""Terminal tables of a cycle optimisation."""

from __future__ import annotations

import math

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.errors import Status
from optlink.problem.cycle import CycleProblem
from optlink.report.views.analysis_tables import machine_strokes
from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, active, checks, fixed, graded, grid, number
from optlink.solvers.infeasibility import Relaxation
from optlink.tasks.results.cycle import CycleResult, display_unit


def machine_design(outcome: CycleResult) -> RenderableType:
    """Summarise a cycle optimisation: design, cycle quantities, active constraints, validation, optima."""
    parts: list[RenderableType] = [_headline(outcome), Text(), _sizes(outcome), Text(), _figures(outcome)]
    strokes = machine_strokes(outcome.built, outcome.task.drive.speed.value) if outcome.built is not None else None
    parts += [Text(), strokes] if strokes is not None else []
    if outcome.conflict:
        parts += [Text(), _conflict(outcome)]
    elif outcome.solution is not None:
        parts += [Text(), active(outcome.solution.limits, outcome.objective, outcome.unit)]
    parts += [Text(), checks(outcome.validation.checks)]
    if len(outcome.optima) > 1:
        parts += [Text(), _optima(outcome)]
    if len(outcome.backends) > 1:
        parts += [Text(), _backends(outcome)]
    return Group(*parts, Text(), _times(outcome))


def asked(task: CycleProblem) -> Table:
    """List the objective and the limits of a problem."""
    table = grid("\n[objective] and [limits]", [("", "left"), ("", "left"), ("", "left")])
    for goal in task.goals:
        share = "" if task.single else f"weight {goal.weight:g}" + (f" per {goal.scale}" if goal.scale is not None else "")
        table.add_row(f"{goal.sense}", goal.words, share)
    for bound in task.bounds:
        table.add_row(bound.name, bound.term.words, str(bound.interval))
    limits = task.limits
    default = "" if "alignment" in limits.model_fields_set else ", default"
    table.add_row("alignment", "every joint off alignment", f"at least {limits.alignment}{default}")
    return table


def _headline(outcome: CycleResult) -> Text:
    title = Text(outcome.task.title, style=HEAD)
    word = "valid" if outcome.valid else "no feasible design" if outcome.status is Status.INFEASIBLE else "not valid"
    title.append(f"\n{outcome.status.value}, ").append(word, style=GOOD if outcome.valid else BAD)
    graded(title, outcome.fit if outcome.valid else None, f"; {outcome.comparison}" if outcome.comparison else "")
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    return title.append(f"\n{outcome.status.text}", style=QUIET)


def _sizes(outcome: CycleResult) -> Table:
    note = "Design" if outcome.status is not Status.INFEASIBLE else "Nearest design found (it does not meet the limits)"
    columns = [("", "left"), ("found", "right"), ("", "left"), ("given", "right"), ("", "left")]
    table = grid(note, columns, header=True)
    for name, value in outcome.values.items():
        size, unit = display_unit(outcome.task, name)
        quantity = outcome.task.quantities[name]
        low, high = (bound * size for bound in quantity.bounds)
        remark = Text(f"{low:g} ... {high:g}", style=QUIET)
        table.add_row(name, Text(fixed(value * size), style=HEAD), unit, fixed(quantity.value * size), remark)
    return table


def _figures(outcome: CycleResult) -> Table:
    columns = [("", "left"), ("given", "right"), ("found", "right"), ("", "left"), ("change", "right"), ("asked", "left")]
    table = grid("What it does, measured over the cycle", columns, header=True)
    for told in outcome.figures:
        change = told.found / told.given - 1.0 if told.given and math.isfinite(told.given) else math.nan
        shown = f"{change:+.2%}" if math.isfinite(change) else "-"
        table.add_row(
            told.words, number(told.given), Text(number(told.found), style=HEAD), told.unit, shown, Text(told.limit, style=QUIET)
        )
    if not outcome.task.single:
        table.add_row("weighted sum", "", Text(number(outcome.objective, 8), style=HEAD), "", "", Text("minimised", style=QUIET))
    return table


def _conflict(outcome: CycleResult) -> Table:
    columns = [("limit", "left"), ("limit value", "left"), ("feasible if relaxed alone", "left")]
    table = grid("These limits cannot hold together", columns, header=True)
    for item in outcome.conflict:
        table.add_row(item.name, _asked(item), _given(item) or "never: see below")
    if any(not math.isfinite(item.amount) for item in outcome.conflict):
        table.add_section()
        for item in outcome.together:
            table.add_row(item.name, _asked(item), f"together: {_given(item) or 'dropped'}")
    return table


def _asked(item: Relaxation) -> str:
    return f"{item.sense} {item.bound:g} {item.unit}".rstrip()


def _given(item: Relaxation) -> str:
    if not math.isfinite(item.amount):
        return ""
    about = "about " * item.approximate
    return f"{item.sense} {about}{item.relaxed:.6g} {item.unit} ({item.amount:.4g} {item.unit})".replace(" )", ")")


def _optima(outcome: CycleResult) -> Table:
    free = list(outcome.values)[:4]
    reached = sum(optimum.count for optimum in outcome.optima)
    title = f"Distinct optima: {len(outcome.optima)}, reached by {reached} searches"
    table = grid(title, [("objective", "right"), *((name, "right") for name in free), ("searches", "right")], header=True)
    for optimum in outcome.optima[:8]:
        values = [fixed(optimum.design[name] * display_unit(outcome.task, name)[0], 2) for name in free]
        table.add_row(number(optimum.objective, 7), *values, str(optimum.count))
    return table


def _backends(outcome: CycleResult) -> Table:
    table = grid("Back ends", [("", "left"), *((name, "right") for name in outcome.backends), ("", "left")], header=True)
    found = outcome.backends.values()
    table.add_row("status", *(solution.status.value for solution in found), "")
    table.add_row("objective", *(number(solution.objective, 9) for solution in found), outcome.unit)
    for name in outcome.values:
        size, unit = display_unit(outcome.task, name)
        table.add_row(name, *(fixed(solution.design[name] * size, 5) for solution in found), unit)
    table.add_row("KKT residual", *(f"{solution.kkt:.1e}" for solution in found), "")
    return table


def _times(outcome: CycleResult) -> Text:
    words = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in outcome.seconds.items() if seconds > 0.0)
    return Text(f"{outcome.backend}, {outcome.starts} starts; {words}", style=QUIET)
