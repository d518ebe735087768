"""Chart, tables and page of the sensitivities of an optimum to its fixed parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.errors import Status
from optlink.presentation.chart_spec import LIMIT, MUTED, RESULT, Axis, Bars, ChartSpec, Line, Panel
from optlink.presentation.format import dimension, figure, fixed, number, price_step, signed
from optlink.presentation.table_spec import (
    Paragraph,
    Part,
    Summary,
    TableSpec,
    good,
    noted,
    quiet,
    strong,
    summary,
    table,
    verdict,
)
from optlink.presentation.view import View
from optlink.studies.motion_sensitivity import OutputStudy
from optlink.studies.sensitivity import DERIVATIVE_TOLERANCE, Derivatives, Sensitivities, Sensitivity
from optlink.tasks.run import validate
from optlink.units import percent

if TYPE_CHECKING:
    from optlink.presentation.report_model import ReportModel


MIN_CHANGE = 5e-6  # relative change that vanishes with three decimals of a percentage
MOST_CHANGE = 1e3  # share of the objective from which a change is shown in its unit
MAX_VARIABLES = 3  # largest number of design variables with their own columns
LISTED_VARIABLES = 2  # number of design variables listed otherwise

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


def columns(result: Sensitivities) -> Mapping[str, list[float | str]]:
    """Return one row for each parameter by column [SI]; `unit` is that of the parameter."""
    rows = result.rows
    return {
        **{key: [getattr(row.parameter, key) for row in rows] for key in ("key", "name", "value", "unit", "step")},
        "objective_per_unit": [row.objective for row in rows],
        **{f"{name}_{unit}_per_unit": [row.design[name] for row in rows] for name, unit in result.units.items()},
        "valid_from": [row.below.value for row in rows],
        "valid_to": [row.above.value for row in rows],
    }


def page(result: Sensitivities) -> ReportModel:
    """Return the page of the optimum, with its sensitivities."""
    from optlink.presentation.report_model import report_model_of

    problem, solution = result.problem, result.solution
    outcome: Any = validate(problem, {name: solution.design[name] for name in problem.model.free})
    best = replace(outcome.best, status=Status.OPTIMAL, solution=solution)
    kept: dict[str, Any] = {"designs": (best, *outcome.designs[1:])} if outcome.designs else {"nearest": best}
    found = replace(outcome, seconds={}, **kept)
    return replace(report_model_of(found), effects=result)


def step(row: Sensitivity) -> str:
    """Format the parameter change by which effects are compared."""
    p = row.parameter
    if p.unit == "deg":
        return "1 deg"
    return "1 %" if p.value else f"{p.step:g} {p.unit}".rstrip()


def overview(result: Sensitivities) -> Summary:
    """Summarise the sensitivities of an optimum to its fixed parameters, largest effect first."""
    shown, optimum = result.problem.model.shown_objective(result.solution.objective), result.displayed
    rows = [(shown.name, strong(number(shown.value)), shown.unit)]
    rows += [(name, strong(dimension(value)), optimum.units[name]) for name, value in optimum.values.items()]
    return summary(result.problem.model.title, noted(result.notes), table("Optimum", "<><", rows), *parts(result))


def parts(result: Sensitivities) -> Iterator[Part]:
    """Yield the tables of the sensitivities without the optimum itself."""
    if result.displayed.moving:
        yield from (_effects(result), _prices(result), _events(result))
    else:
        yield Paragraph("No parameter changes this optimum to first order.")
    still = [row.parameter.name for row in result.displayed.rows if not row.moves and row.parameter.in_file]
    if still:
        yield Paragraph(quiet(f"No effect to first order: {'; '.join(dict.fromkeys(still))}."))
    if result.gap is not None:
        gap = verdict(f"largest difference {result.gap:.1e}", result.gap <= DERIVATIVE_TOLERANCE)
        yield Paragraph((quiet("Re-optimised on both sides of each: "), gap))


def _effects(result: Sensitivities) -> TableSpec:
    """Tabulate the effect of one step of every parameter on the objective and the design."""
    optimum, rows = result.displayed, []
    names = list(optimum.units)
    objective, factor, unit, *_ = result.problem.model.shown_objective(result.solution.objective)
    narrow = len(names) <= MAX_VARIABLES
    for row in optimum.moving:
        p = row.parameter
        effect = factor * row.effect  # of an objective that is zero but for rounding no share is informative
        share = _percent(effect / objective) if abs(effect) < MOST_CHANGE * abs(objective) else f"{effect:+.3g} {unit}".rstrip()
        responses = [signed(row.design[name] * p.step) for name in names] if narrow else [_largest_responses(optimum, row)]
        changed = f"{number(p.value)} {p.unit}".rstrip() + f" + {step(row)}"
        rows.append((p.name, changed, good(share) if row.effect < 0.0 else share, *responses))
    effect_columns = [f">{name}\n[{optimum.units[name]}]" for name in names] if narrow else ["moves most"]
    columns = ["parameter", ">change", ">objective", *effect_columns]
    return table("Sensitivity to prescribed values, largest effect first", columns, rows)


def _largest_responses(optimum: Derivatives, row: Sensitivity) -> str:
    """Format the design variables with the largest relative response to a parameter."""
    sizes = {name: abs(optimum.values[name]) or 1.0 for name in row.design}
    order = sorted(row.design, key=lambda name: -abs(row.design[name]) / sizes[name])
    responses = [
        f"{name} {signed(row.design[name] * row.parameter.step)}\u00a0{optimum.units[name]}" for name in order if row.design[name]
    ]
    return ", ".join(responses[:LISTED_VARIABLES])


def _prices(result: Sensitivities) -> TableSpec:
    """Tabulate the derivatives of the objective."""
    (_, factor, unit, _), rows = result.problem.model.shown_objective(result.solution.objective), []
    for row in result.displayed.moving:
        size, words = price_step(row.parameter.unit, row.parameter.value)
        per = quiet(f"{unit} per {words}".strip())
        rows.append((row.parameter.key, f"{factor * size * row.objective:+.6g}" if row.objective else "0", per))
    return table("Change of the objective if the value is raised", "<><", rows)


def _events(result: Sensitivities) -> TableSpec:
    rows = [
        (row.parameter.name, f"{word} {number(end.value, 5)} {row.parameter.unit}".rstrip(), quiet(end.event))
        for row in result.displayed.moving
        for word, end in (("below", row.below), ("above", row.above))
        if math.isfinite(end.value)
    ]
    return table("Range of validity, to first order", "<<<", rows)


def _percent(share: float) -> str:
    return f"{100.0 * share:+.1e} %" if 0.0 < abs(share) < MIN_CHANGE else percent(share, 3, signed=True)


def outputs(study: OutputStudy) -> TableSpec:
    """Tabulate the derivatives of an output with respect to every dimension, one row for each position of the drive."""
    sensitivity, driving = study.derivatives, study.problem.model.driving
    angular = sensitivity.unit == "rad"
    per, unit = ("deg per mm", "deg") if angular else ("mm per mm", "mm")
    factor = math.degrees(1.0) / 1e3 if angular else 1.0
    shown = np.degrees(sensitivity.value) if angular else 1e3 * sensitivity.value
    rows = [
        (f"{place:g}", fixed(shown[i], 4), *(fixed(factor * column[i], 6) for column in sensitivity.by.values()))
        for i, place in enumerate(driving.shown(sensitivity.crank_angles))
    ]
    first = "crank" if driving.column == "crank_angle_deg" else driving.coordinate
    columns = [f">{first} [{driving.unit}]", f">{sensitivity.name} [{unit}]", *(f">{name}" for name in sensitivity.by)]
    return table(
        f"{sensitivity.name}: derivative with respect to each dimension at constant {driving.noun} [{per}]", columns, rows
    )


def conclusion(result: Sensitivities) -> str:
    """Return the conclusion of a sensitivity analysis."""
    if not result.displayed.moving:
        return "No prescribed value has an effect on this optimum, to first order."
    first = result.displayed.moving[0]
    base, factor, *_ = result.problem.model.shown_objective(result.solution.objective)
    words = step(first).replace(" deg", "°")
    change = percent(factor * first.effect / base, 2, signed=True) if base else figure(first.effect, result.unit)
    return f"The optimum reacts most to {first.parameter.name}: {words} more changes the objective by {change.replace('-', '−')}."


VIEW = View(overview, charts=charts, tables=lambda result: {"sensitivity": columns(result)}, page=page)
OUTPUTS = View(no_page="Read the derivatives of an output in the sensitivity.csv beside it")
