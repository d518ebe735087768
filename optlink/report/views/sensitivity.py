"""Chart and table of the sensitivities of an optimum to its fixed parameters."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from optlink.errors import Status
from optlink.report.chart_spec import Axis, Bars, ChartSpec, Line, Panel
from optlink.report.report_model import ReportModel, report_model_of
from optlink.report.style import LIMIT, MUTED, RESULT
from optlink.report.view import View
from optlink.report.views.study_tables import step
from optlink.studies.sensitivity import Sensitivities
from optlink.tasks.run import validate

MAX_BARS, MIN_BAR = 14, 1e-3  # largest number of bars, and smallest bar as a share of the largest
ZERO_CHANGE = 5e-5  # share of the objective below which a change is shown as zero


def charts(result: Sensitivities) -> list[ChartSpec]:
    """Return the tornado chart: the change of the objective by one step of each parameter up and down, largest on top."""
    moving, base = result.displayed.moving, result.solution.objective
    largest = max((abs(row.effect) for row in moving), default=0.0)
    if largest <= ZERO_CHANGE * base:
        return []
    rows = [row for row in moving if abs(row.effect) >= MIN_BAR * largest][:MAX_BARS]
    value, factor, unit, _ = result.problem.model.shown_objective(base)
    factor, unit = (100.0 * factor / value, "%") if value > 0.0 and base > 0.0 else (factor, unit)
    effects = np.array([abs(factor) * row.effect for row in rows])
    places = np.arange(len(rows), 0.0, -1.0)
    shown = [(row, f"{row.parameter.value:.5g} {row.parameter.unit}".rstrip()) for row in rows]
    bars, one_sided = [], False
    for sign, words, width, opacity in ((1.0, "one step more", 0.34, 1.0), (-1.0, "one step less", 0.26, 0.45)):
        ends = [row.above.value if sign > 0.0 else row.below.value for row in rows]
        known = [
            not math.isclose(end, row.parameter.value, rel_tol=1e-9, abs_tol=1e-9) for end, row in zip(ends, rows, strict=True)
        ]
        one_sided |= not all(known)
        colours = [LIMIT if sign * effect > 0.0 else RESULT for effect in effects]
        text = [f"{row.parameter.name}: {value} {'+' if sign > 0.0 else '−'} {step(row)}" for row, value in shown]
        style: dict[str, Any] = {"horizontal": True, "opacity": opacity, "legend": False, "text": text}
        bars.append(Bars(places - (1.0 - sign) * 0.17, np.where(known, sign * effects, 0.0), words, colours, width, **style))
    names = [f"{row.parameter.name}\n{value}, {step(row)}" for row, value in shown]
    y = Axis(ticks=[(float(place) - 0.15, name) for place, name in zip(places, names, strict=True)])
    x, zero = Axis(f"change of the objective [{unit}]"), Line(0.0, colour=MUTED, width=1.0, dash="solid")
    title = "Effect of one step more or less: 1 deg of an angle, else 1 %"
    remark = "To first order; solid: one step more, pale: one step less; left is better"
    remark += "; no bar to the side where a limit ends the derivative at once" * one_sided
    panel = Panel(y, bars, 0.25 * len(rows) + 0.15)
    heading = f"{result.problem.model.title}: sensitivities"
    return [ChartSpec("tornado", title, [panel], x, heading, remark, lines=[zero], cursor=False, width=8.0)]


def table(result: Sensitivities) -> Mapping[str, list[float | str]]:
    """Return one row for each parameter by column."""
    rows = result.displayed.rows
    parameters = [row.parameter for row in rows]
    return {
        "key": [parameter.key for parameter in parameters],
        "name": [parameter.name for parameter in parameters],
        "value": [parameter.value for parameter in parameters],
        "unit": [parameter.unit for parameter in parameters],
        "step": [parameter.step for parameter in parameters],
        "objective_per_unit": [row.objective for row in rows],
        **{f"{name}_{unit}_per_unit": [row.design[name] for row in rows] for name, unit in result.displayed.units.items()},
        "valid_from": [row.below.value for row in rows],
        "valid_to": [row.above.value for row in rows],
    }


def page(result: Sensitivities) -> ReportModel:
    """Return the page of the optimum, with its sensitivities."""
    problem, solution = result.problem, result.solution
    outcome: Any = validate(problem, {name: solution.design[name] for name in problem.model.free})
    found = replace(outcome.with_best(status=Status.OPTIMAL, solution=solution), seconds={})
    return replace(report_model_of(found), effects=result)


VIEW = View(charts=charts, tables=lambda result: {"sensitivity": table(result)}, page=page, result=Sensitivities)
