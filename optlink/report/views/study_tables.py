"""Tables of parametric studies and of Pareto fronts."""

import math
import re
from collections.abc import Iterator

import numpy as np

from optlink.report.format import change, dimension, fixed, number, points, price_step, signed
from optlink.report.table_spec import (
    Inline,
    Line,
    Paragraph,
    Part,
    Row,
    Summary,
    TableSpec,
    bad,
    good,
    noted,
    quiet,
    strong,
    summary,
    table,
    verdict,
)
from optlink.studies.motion_sensitivity import OutputSensitivity
from optlink.studies.pareto.epsilon_constraint import Pareto
from optlink.studies.sensitivity import Derivatives, Sensitivities, Sensitivity
from optlink.studies.sweep import TEXT, Sweep
from optlink.units import percent

DERIVATIVE_TOLERANCE = 1e-5  # relative tolerance between exact derivatives and those from solving again
MAX_ROWS = 12  # largest number of active-set changes and of points listed
MAX_COLUMNS = 5  # largest number of quantities side by side
MIN_CHANGE = 5e-6  # relative change that vanishes with three decimals of a percentage
MOST_CHANGE = 1e3  # share of the objective from which a change is shown in its unit
MAX_VARIABLES = 3  # largest number of design variables with their own columns
LISTED_VARIABLES = 2  # number of design variables listed otherwise
_UNIT = re.compile(r"(.+)_((?:rad|m)_s2?|(?:rad|mm|m|deg)2?|N|Nm|W|J)")


def step(row: Sensitivity) -> str:
    """Format the parameter change by which effects are compared."""
    p = row.parameter
    if p.unit == "deg":
        return "1 deg"
    return "1 %" if p.value else f"{p.step:g} {p.unit}".rstrip()


def sensitivities(result: Sensitivities) -> Summary:
    """Summarise the sensitivities of an optimum to its fixed parameters, largest effect first."""
    shown, optimum = result.problem.model.shown_objective(result.solution.objective), result.displayed
    rows = [(shown.name, strong(number(shown.value)), shown.unit)]
    rows += [(name, strong(dimension(value)), optimum.units[name]) for name, value in optimum.values.items()]
    return summary(result.problem.model.title, noted(result.notes), table("Optimum", "<><", rows), *sensitivity_parts(result))


def sensitivity_parts(result: Sensitivities) -> Iterator[Part]:
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


def outputs(sensitivity: OutputSensitivity) -> TableSpec:
    """Tabulate the derivatives of an output with respect to every dimension, one row for each crank angle."""
    angular = sensitivity.unit == "rad"
    per, unit = ("deg per mm", "deg") if angular else ("mm per mm", "mm")
    factor = math.degrees(1.0) / 1e3 if angular else 1.0
    shown = np.degrees(sensitivity.value) if angular else 1e3 * sensitivity.value
    rows = [
        (f"{angle:g}", fixed(shown[i], 4), *(fixed(factor * column[i], 6) for column in sensitivity.by.values()))
        for i, angle in enumerate(np.degrees(sensitivity.crank_angles))
    ]
    columns = [">crank [deg]", f">{sensitivity.name} [{unit}]", *(f">{name}" for name in sensitivity.by)]
    return table(f"{sensitivity.name}: derivative with respect to each dimension at constant crank angle [{per}]", columns, rows)


def sweep(result: Sweep) -> Summary:
    """Summarise a parameter sweep."""
    every = " x ".join(f"{len(axis.values):,}" for axis in result.grid.axes)
    counted = points(result.grid.count) + (f" ({every})" if len(result.grid.axes) > 1 else "")
    conflict = "Conflicting limits at a point without a design: `optlink solve` with --set at that point"
    status = [(f"{counted}, ", verdict(_point_counts(result), result.complete)), *([conflict] if result.infeasible else [])]
    axes = []
    for axis in result.grid.axes:
        ends = dict.fromkeys(f"{end:g}" for end in (min(axis.values), max(axis.values)))
        axes.append((axis.key, f"{' ... '.join(ends)} {axis.unit}".rstrip(), quiet(points(len(axis.values)))))
    parts = [table("Varied", "<<>", axes)]
    if result.best is not None:
        omitted = ("status", "valid", "failed", "method", "active_set_changed")
        best = {name: value for name, value in result.best.items() if name not in omitted}
        rows = (
            ("active constraints", value or "none") if name == "active" else (column_label(name), number(float(value)))
            for name, value in best.items()
        )
        parts.append(table("Best", "<>", rows))
    if result.changes:
        parts.append(_changes(result))
    parts += _rows(result) if result.evaluated else []
    rate = result.done / result.seconds if result.seconds else 0.0
    pace = f"{rate:z,.0f}" if rate >= 10.0 else number(rate, 2)
    line = f"{points(result.done)} done in {result.seconds:z.1f} s ({pace} a second"
    line += f"; {1e3 * result.cpu / result.done:z.2f} ms of processor time each)" if result.done else ")"
    if not result.evaluated:
        line += f"; {searches(result)}"
    return summary(result.problem.model.title, status, *parts, Paragraph(quiet(line), appendix=True))


def searches(result: Sweep) -> str:
    """Return how the optima of a sweep were computed."""
    if result.searched >= result.grid.count:
        return "all by a search"
    return f"{result.searched:,} by a search, the others from a neighbouring optimum"


def _point_counts(result: Sweep) -> str:
    """Count the points by outcome."""
    if not result.evaluated:
        if result.complete:
            return "every point a verified local optimum"
        missed = result.grid.count - result.valid - result.infeasible
        counts = {"verified": result.valid, "without a feasible design": result.infeasible, "not verified": missed}
    else:
        counts = dict(result.statuses)
    return ", ".join(f"{count:,} {words}" for words, count in counts.items() if count)


def _rows(result: Sweep) -> Iterator[TableSpec]:
    """Yield the first points of a sweep of analyses; for larger sweeps, the extremes of each quantity."""
    axes = result.grid.axes
    names = [name for name in result.names[len(axes) :] if name not in TEXT and name != "valid"]
    columns = result.columns
    all_points = result.grid.count <= MAX_ROWS and len(names) <= MAX_COLUMNS
    if not all_points and result.valid:
        valid, rows = np.flatnonzero(columns["valid"]), []
        for name in names:
            if np.all(np.isnan(columns[name][valid])):
                continue
            ends = [int(valid[of(columns[name][valid])]) for of in (np.nanargmin, np.nanargmax)]
            rows.append((name, *(text for k in ends for text in (number(columns[name][k]), _place(result, k)))))
        yield table("Extremes over all valid points", ["", ">least", ">at", ">largest", ">at"], rows)
    varied = [f">{_short(axis.key, axis.unit)}" for axis in axes]
    if all_points:
        heads = [">" + name.replace(".", ".\n") for name in names]
        table_rows: list[Row] = []
        for k in range(result.grid.count):
            status = columns["status"][k] if columns["valid"][k] else bad(columns["status"][k])
            table_rows.append((*_values(result, k), *(number(float(columns[name][k])) for name in names), status))
        yield table("Points", [*varied, *heads, "status"], table_rows)
    invalid = np.flatnonzero(~columns["valid"])
    if invalid.size:
        failed = [(*_values(result, k), columns["reason"][k]) for k in map(int, invalid[:MAX_ROWS])]
        more = invalid.size - MAX_ROWS
        notes = [quiet(f"and {more:,} more; the table of the sweep has all")] if more > 0 else []
        yield table(f"Points that are not valid: {invalid.size:,}", [*varied, "reason"], failed, notes=notes)


def _values(result: Sweep, point: int) -> list[str]:
    return [f"{value:g}" for value in result.grid.values(point)]


def named(column: str) -> tuple[str, str]:
    """Return display name and unit of a column."""
    match = _UNIT.fullmatch(column)
    if match is None:
        return column, ""
    name, unit = match.groups()
    return name, unit.replace("_", "/").replace("Nm", "N m").removesuffix("2") + ("²" if unit.endswith("2") else "")


def column_label(column: str) -> str:
    """Return the display name of a column with its unit."""
    return with_unit(*named(column))


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit, if it has one."""
    return f"{name} [{unit}]" if unit else name


def _short(key: str, unit: str) -> str:
    """Abbreviate a key by the section of its mechanism, with its unit below."""
    name = key.removeprefix("mechanism.").removeprefix("links.")
    return name.replace(".", ".\n") + (f"\n[{unit}]" if unit else "")


def _place(result: Sweep, point: int) -> str:
    values = zip(result.grid.axes, result.grid.values(point), strict=True)
    return ", ".join(f"{value:g} {axis.unit}".rstrip() for axis, value in values)


def _changes(result: Sweep) -> TableSpec:
    rows = [
        (*(f"{value:g}" for value in change.at.values()), change.before or "none", change.after or "none")
        for change in result.changes[:MAX_ROWS]
    ]
    columns = [*(f">{_short(axis.key, axis.unit)}" for axis in result.grid.axes), "before", "from there on"]
    return table(f"Changes of the active constraints: {result.changed}", columns, rows)


RATIO_ABOVE = 3.0  # ratio above which a change is not given in per cent
MAX_POINTS = 24  # largest number of listed points, besides the end points and the knee


def pareto_front(result: Pareto) -> Summary:
    """Summarise a Pareto front: points, end points, knee, and the change of each objective from the reference design."""
    title = result.problem.model.title
    if not result.points:
        return summary(title, _status(result))
    rate = f"; {1e3 * result.cpu / result.done:z.0f} ms of processor time each" if result.done else ""
    knee = "knee by the distance from the chord of the ends (Das 1999)"
    effort = Paragraph(quiet(f"{points(result.done)} done in {result.seconds:z.1f} s{rate}; {knee}"), appendix=True)
    return summary(title, _status(result), _points(result), _designs(result), effort)


def _status(result: Pareto) -> Iterator[Line]:
    names = [objective.name for objective in result.objectives]
    yield f"Front of {', '.join(names[:-1])} and {names[-1]}"
    missed = result.solved - result.valid - result.infeasible
    empty = f", {result.infeasible} without a feasible design" if result.infeasible else ""
    counted = f": {result.solved} solved, {result.dominated} dominated by others{empty}"
    left_out = bad(f", {missed} not verified and left out" if missed else "")
    yield f"{points(len(result.points))}, ", good("each a verified local optimum"), counted, left_out
    if result.single_point:
        yield result.single_point
    elif result.points and result.knee is None:
        yield "No knee: the front is straight or curved away from the ideal point"


def _shown(result: Pareto) -> list[int]:
    """Return the indices of the listed points."""
    step = max(1, math.ceil(len(result.points) / MAX_POINTS))
    return [k for k, point in enumerate(result.points) if k % step == 0 or point.mark]


def _points(result: Pareto) -> TableSpec:
    """Tabulate the objectives of the points and their change from the reference design."""
    rows: list[Row] = [(str(k + 1), *_cells(result, result.points[k].values), result.points[k].mark) for k in _shown(result)]
    if result.reference is not None:
        rows.append(("", *_cells(result, result.reference), quiet(result.reference_label)))
    columns = [">"]
    for objective in result.objectives:
        columns.append(f">{objective.name}\n[{objective.unit}]" if objective.unit else f">{objective.name}")
        columns += [">change"] if _compared(result) else []
    return table("Front", [*columns, ""], rows, unbroken=True)


def _designs(result: Pareto) -> TableSpec:
    """Tabulate the design variables of the points."""
    free = list(result.points[0].design)
    rows = [(str(k + 1), *(number(result.points[k].design[name], 5) for name in free)) for k in _shown(result)]
    return table("Designs", [">", *(">{}\n[{}]".format(*name.rpartition("_")[::2]) for name in free)], rows)


def _compared(result: Pareto) -> bool:
    """Return whether the table has columns for the change from the reference design."""
    return result.reference is not None and len(result.objectives) == 2


def _cells(result: Pareto, values: tuple[float, ...]) -> Iterator[Inline]:
    for k, value in enumerate(values):
        yield number(value, 6)
        if result.reference is not None and _compared(result):
            yield quiet("" if values is result.reference else relative_change(value, result.reference[k]))


def relative_change(value: float, before: float) -> str:
    """Format the change of a value: in per cent, or as a ratio if it is large; empty if it was zero before."""
    if not before:
        return ""
    ratio = value / before
    return f"x {ratio:.3g}" if ratio >= RATIO_ABOVE else change(ratio - 1.0)
