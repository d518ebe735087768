"""Tables of a cycle optimisation."""

import math

from optlink.errors import Status
from optlink.report.format import change, dimension, number
from optlink.report.table_spec import Row, Summary, TableSpec, quiet, strong, table
from optlink.report.views.analysis_tables import machine_strokes
from optlink.report.views.search_tables import NEAREST_DESIGN, optima, search_summary
from optlink.tasks.results.cycle import CycleResult


def cycle_result(outcome: CycleResult) -> Summary:
    """Summarise a cycle optimisation: design, cycle quantities, active constraints, validation, optima."""
    strokes = None if outcome.built is None else machine_strokes(outcome.built, outcome.task.drive.speed.value)
    tail = f"; {outcome.comparison}" if outcome.comparison else ""
    return search_summary(outcome, _sizes(outcome), None, (_figures(outcome), strokes), (optima(outcome),), tail=tail)


def _sizes(outcome: CycleResult) -> TableSpec:
    rows = []
    complete = outcome.complete(outcome.design)
    for name, value in (outcome.design | {name: complete[name] for name in outcome.task.links}).items():
        quantity = outcome.task.quantities[name]
        size, unit = quantity.display
        low, high = (bound * size for bound in quantity.bounds)
        within = f"{low:g} ... {high:g}" if quantity.low is not None else ""
        bounds = quiet(within if quantity.free else ", ".join(filter(None, [quantity.status, within])))
        rows.append((name, strong(dimension(value * size)), unit, dimension(quantity.value * size), bounds))
    title = "Design" if outcome.status is not Status.INFEASIBLE else NEAREST_DESIGN
    return table(title, ["", ">result", "", ">initial", ""], rows)


def _figures(outcome: CycleResult) -> TableSpec:
    rows: list[Row] = []
    for figure in outcome.figures:
        shown = change(figure.result / figure.initial - 1.0 if figure.initial and math.isfinite(figure.initial) else math.nan)
        rows.append(
            (figure.words, number(figure.initial), strong(number(figure.result)), figure.unit, shown, quiet(figure.limit))
        )
    if not outcome.task.single:
        rows.append(("weighted sum", "", strong(number(outcome.objective, 8)), "", "", quiet("minimised")))
    return table("Objective and limits, measured over the cycle", ["", ">initial", ">result", "", ">change", "limit"], rows)
