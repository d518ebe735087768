"""Tables, charts, files and page of a balancing result, which is checked against inverse dynamics when it is read."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from optlink.balancing.socp import measured, unit_of
from optlink.dynamics.inverse import reported_on
from optlink.errors import Status
from optlink.presentation import files
from optlink.presentation.chart_spec import (
    BODIES,
    CRANK,
    LIMIT,
    RESULT,
    TARGET,
    Array,
    Axis,
    Band,
    ChartSpec,
    Curve,
    Line,
    Mark,
    Panel,
    Picks,
    drive_axis,
    max_abs,
)
from optlink.presentation.format import change, figure, fixed, joined, number, position, scale, shown, times
from optlink.presentation.scene import colours_of
from optlink.presentation.shapes import normed
from optlink.presentation.table_spec import (
    Inline,
    Paragraph,
    Part,
    Row,
    Summary,
    TableSpec,
    bad,
    noted,
    quiet,
    strong,
    summary,
    table,
    verdict,
)
from optlink.presentation.view import PageSection, SomeDrawing, StoredStudy, View
from optlink.presentation.views.search_tables import objective_line, short_text
from optlink.problem.file import ProblemFile, fixed_design
from optlink.problem.mechanism import sizes_of
from optlink.problem.terms import Term
from optlink.tasks.results.balance import Balance, TradeOff, TradePoint, column_of
from optlink.units import count_noun, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SENSES = {"<=": "at most", ">=": "at least"}
ROUNDING = 1e-9  # share of the initial value below which the remainder is rounding error

MAX_POINTS = 15  # largest number of listed points of a trade-off

INITIAL = "#8a8a8a"
COLOURS = {"shaking force": RESULT, "shaking moment": BODIES[3], "torque": CRANK}
MAX_PANELS = 4  # largest number of stacked panels in a chart of the page


def charts(result: Balance) -> list[ChartSpec]:
    """Return the charts of a balancing result, as computed or as stored."""
    return [*trade_off(result), *cycle_charts(result)]


def cycle_charts(result: Balance) -> list[ChartSpec]:
    """Return the charts over the crank angle and the hodograph; none without a balanced machine."""
    return [] if result.heavier is None else [*before_after(result), hodograph(result)]


# --- before and after ------------------------------------------------------------------------------------------------------


def _amounts(result: Balance, term: Term, when: str) -> Array:
    """Return the magnitude of a force or the value of a torque at the positions [SI]."""
    parts = [result.columns[f"{when}.{column_of(term, axis)}"] for axis in (("_x", "_y") if term.nature.vector else ("",))]
    return np.hypot(*parts) if len(parts) > 1 else parts[0]


def before_after(result: Balance) -> list[ChartSpec]:
    """Plot shaking force and moment, driving torque and joint reactions over the crank angle, before and after.

    The picture has the minimised and limited reactions only.
    """
    every = measured(result.original, result.section)
    named = [goal.term for goal in result.section.goals] + [term for term, _ in result.section.limited]
    common = [term for term in every if term.quantity in COLOURS]
    reactions = [term for term in every if term.quantity not in COLOURS]
    chosen = [reaction for reaction in reactions if any(_of_reaction(reaction, term, result) for term in named)]
    remaining = [reaction for reaction in reactions if reaction not in chosen]
    groups = [("Shaking and drive", common, "before_after"), ("Joint reactions", chosen, "before_after")]
    groups += [
        (f"Joint reactions, {k // MAX_PANELS + 1}" if k or chosen else "Joint reactions", remaining[k : k + MAX_PANELS], "")
        for k in range(0, len(remaining), MAX_PANELS)
    ]
    x, closing = np.degrees(result.angles), []
    if abs(abs(x[-1] - x[0]) + abs(x[1] - x[0]) - 360.0) < 1e-6:  # a whole revolution is closed
        closing = [x[0] + math.copysign(360.0, x[1] - x[0])]
    angles = np.append(x, closing)
    driving = result.problem.model.driving
    places = driving.shown(np.radians(angles))
    axis = drive_axis(driving, limits=(np.min(places), np.max(places)))
    heading = f"{result.problem.model.title}: least {result.measure}"
    specs = []
    for row, (title, group, file) in enumerate(groups):
        panels = [_panel(result, term, places, BODIES[k]) for k, term in enumerate(group)]
        specs.append(ChartSpec(file, title, panels, axis, heading, row=row, width=8.2))
    return [chart for chart in specs if chart.panels]


def _panel(result: Balance, term: Term, angles: Array, default: str) -> Panel:
    old, new = (_amounts(result, term, when) for when in ("before", "after"))
    unit = scale(max_abs(np.array([old, new])), unit_of(term))
    old_rms, new_rms = (float(np.sqrt(np.mean(values * values))) for values in (old, new))
    share = f" ({change(new_rms / old_rms - 1.0)})" if old_rms > 0.0 else ""
    shown = unit.text(new_rms) if new_rms > 1e-12 * old_rms else "0"
    name, colour = term.subject, COLOURS.get(term.quantity, default)
    before, after = (np.append(values, values[: len(angles) - len(values)]) * unit.factor for values in (old, new))
    curves = [
        Curve(angles, before, f"initial: rms {unit.text(old_rms)}", INITIAL, 1.3, gid=f"initial {name}"),
        Curve(angles, after, f"balanced {name}: {shown}{share}", colour, 2.1, gid=f"balanced {name}"),
    ]
    bounds = [limit.bound for limit in result.limits if limit.name == f"peak {name}"]
    force = term.nature.kind == "force"
    signs = (1.0,) if force else (1.0, -1.0)
    lines = [Line(sign * bound * unit.factor, "", LIMIT, gid="limit") for bound in bounds for sign in signs]
    positive = force and np.min([old, new]) >= 0.0
    top = max(np.max([before, after]), *(line.at for line in lines), 0.0)
    return Panel(Axis(f"{name}\n[{unit.unit}]", (0.0, 1.06 * top) if positive and top > 0.0 else None), curves, lines=lines)


def _of_reaction(reaction: Term, term: Term, result: Balance) -> bool:
    """Return whether a term is of a reaction."""
    if reaction.quantity != term.quantity or reaction.of != term.of:
        return False
    return not reaction.on or reaction.on == (term.on or reported_on(result.original)[str(term.of)])


def hodograph(result: Balance) -> ChartSpec:
    """Plot the hodograph of the shaking force over the motion before and after balancing, with equal scales."""
    names = (("before", INITIAL, 1.4, "initial"), ("after", RESULT, 2.1, "balanced"))
    paths = [np.stack([result.columns[f"{when}.shaking_force_{axis}_N"] for axis in "xy"], axis=-1) for when, *_ in names]
    largest, driving = max_abs(paths[0]), result.problem.model.driving
    unit, limits = scale(largest, "N"), driving.mechanism.limits
    centre = Curve(np.zeros(1), np.zeros(1), "", TARGET, mode="markers", symbol="plus", size=10.0, legend=False, hover=False)
    curves, marks = [centre], []
    for (_, colour, width, name), path in zip(names, paths, strict=True):
        most, drawn = np.max(np.linalg.norm(path, axis=1)), path * unit.factor
        closed, middle = np.concatenate([drawn, drawn[:1]]), np.mean(drawn, axis=0)
        recorded = f"{name}: at most {unit.text(most) if most > 1e-12 * largest else '0'}"
        curves.append(Curve.through(closed, recorded, colour, width, gid=f"hodograph {name}"))
        if most < 0.02 * largest:  # degenerates to a point: no crank angles to mark
            marks.append(Mark(middle[0], middle[1], "", colour, size=6.0))
            continue
        marked = np.radians(range(0, 360, 60)) if limits is None else np.linspace(*limits, 5)
        for at in marked:
            k = int(np.argmin(np.abs(np.mod(result.angles - at + np.pi, 2.0 * np.pi) - np.pi)))
            x, y = normed(drawn[k] - middle)
            mark = partial(Mark, drawn[k, 0], drawn[k, 1], size=4.0, written=True)
            text = f"{math.degrees(at):.4g}°" if driving.ends is None else position(driving, at)
            marks.append(mark(text, colour, prefer=(float(x), float(y))))
    x_axis, y_axis = (Axis(f"shaking force in {axis} [{unit.unit}]") for axis in "xy")
    heading = f"{result.problem.model.title}: shaking force, {driving.noun} marked"
    panel, title = Panel(y_axis, curves, marks=marks), f"Shaking force over the motion, {driving.noun} marked"
    return ChartSpec("hodograph", title, [panel], x_axis, heading, equal=True, cursor=False)


# --- trade-off -------------------------------------------------------------------------------------------------------------


def trade_off(result: Balance) -> list[ChartSpec]:
    """Plot the trade-off curve with its end points, its knee and the unbalanced machine; below it the counterweight masses."""
    trade = result.trade
    if trade is None or len(trade.points) < 2:
        return []
    objectives = (trade.first, trade.second)
    units = [scale(max(trade.before[k], *(p.realised[k] for p in trade.points)), unit_of(m)) for k, m in enumerate(objectives)]
    factors = np.array([unit.factor for unit in units])
    bound = np.array([[p.first, p.second] for p in trade.points]) * factors
    real, initial = np.array([p.realised for p in trade.points]) * factors, np.array(trade.before) * factors
    below = Band(bound[:, 0], np.full(len(bound), np.min(bound[:, 1])), bound[:, 1], "", "#888888", 0.14, gid="out of reach")
    designs = partial(Curve.through, mode="markers", size=4.0, picks=range(len(real)), gid="realised")
    curves: list[Curve | Band] = [
        below,
        Curve.through(bound, "lower bound", RESULT, 1.8, gid="bound"),
        designs(real, "designs, by inverse dynamics", RESULT),
        Curve(initial[:1], initial[1:], "initial machine", TARGET, mode="markers", symbol="square", size=6.5, gid="initial"),
    ]
    names = {0: f"least {trade.first.subject}", len(trade.points) - 1: f"least {trade.second.subject}"}
    if trade.knee is not None:
        names[trade.knee] = "knee"
    marks = [Mark(initial[0], initial[1], "initial machine", TARGET, "square", 6.5, font=9.0)]
    for k, name in names.items():
        shares = _compared(trade, trade.points[k])[1::2]
        text = f"{name}\n{', '.join(f'{_short(m)} {share}' for m, share in zip(objectives, shares, strict=True))}"
        marks.append(Mark(real[k, 0], real[k, 1], text, LIMIT, size=7.0, prefer=(0.7, 0.7), gid=name))
    panels = [Panel(Axis(f"{trade.second.words} [{units[1].unit}]"), curves, 2.0, marks=marks)]
    colours = colours_of(result.original.mechanism)
    masses = {body: [p.masses.get(body, 0.0) for p in trade.points] for point in trade.points for body in point.masses}
    if masses:
        mass = partial(Curve, real[:, 0], width=1.3, mode="lines+markers", size=3.0)
        weights = [mass(np.array(values), body, colours[body], gid=f"mass {body}") for body, values in masses.items()]
        highest = max(max(values) for values in masses.values())
        panels.append(Panel(Axis("mass [kg]", (0.0, 1.06 * highest) if highest > 0.0 else None), weights))
    title, heading = f"{trade.second.words} against {trade.first.words}", f"{result.problem.model.title}: trade-off"
    ends = (*real[:, 0], *bound[:, 0], initial[0])
    room = 0.08 * (max(ends) - min(ends))
    x = Axis(f"{trade.first.words} [{units[0].unit}]", (float(min(ends) - room), float(max(ends) + room)))
    return [ChartSpec("trade", title, panels, x, heading, picks=_picks(trade, real), cursor=False)]


def _short(term: Term) -> str:
    return term.of or term.quantity.split(" ")[-1]


def _compared(trade: TradeOff, point: TradePoint) -> list[str]:
    """Return both terms at a point, each with its change from the initial machine."""
    pairs = zip(point.realised, trade.before, strict=True)
    return [text for value, before in pairs for text in (number(value), change(value / before - 1.0))]


def _picks(trade: TradeOff, places: Array) -> Picks:
    """Return the designs of a trade-off with their measures and counterweights."""
    bodies = sorted({body for point in trade.points for body in point.masses})
    names = [
        words
        for term in (trade.first, trade.second)
        for words in (f"{term.words} [{unit_of(term)}]", f"{term.subject}: against the initial machine")
    ]
    rows = []
    for point in trade.points:
        rows.append(
            (
                *_compared(trade, point),
                *(f"{number(point.masses[body])} kg" if body in point.masses else "none" for body in bodies),
            )
        )
    what = (*names, *(f"counterweight on {body}" for body in bodies))
    return Picks("point", what, tuple(rows), places[:, 0], places[:, 1], trade.knee or 0)


def _mechanism(result: Balance) -> Figure:
    from optlink.presentation.views.balance_drawing import mechanism

    return mechanism(result)


# --- files -----------------------------------------------------------------------------------------------------------------


def _tables(result: Balance) -> dict[str, dict[str, Array]]:
    tables: dict[str, dict[str, Array]] = {"balance": result.columns}
    if result.trade is not None:
        trade, points = result.trade, result.trade.points
        columns = {
            f"{m.words}_{unit_of(m)}".replace(" ", "_"): [p.realised[k] for p in points]
            for k, m in enumerate((trade.first, trade.second))
        }
        bodies = [weight.specification.body for weight in result.added] + [b for p in points for b in p.masses]
        masses = {f"{body}_kg": [point.masses.get(body, 0.0) for point in points] for body in dict.fromkeys(bodies)}
        tables["trade"] = {**columns, "rate": [p.rate for p in points], "gap": [p.gap for p in points], **masses}  # type: ignore[dict-item]
    return tables


def _design(result: Balance) -> tuple[ProblemFile, str] | None:
    if result.machine is None:
        return None
    sizes = sizes_of(result.machine.model.quantities)
    machine = fixed_design(result.machine, sizes) if result.machine.model.free else result.machine
    return machine, files.verdict(result.status, result.valid, result.status)


VERDICTS = {
    Status.OPTIMAL: "Globally optimal within the limits",
    Status.RELAXED: "Near the lower bound",
    Status.INFEASIBLE: "No counterweights meet all limits",
    Status.STALLED: "Not verified as an optimum",
}


# --- the page ----------------------------------------------------------------------------------------------------------------


def page(result: Balance) -> StoredStudy:
    """Return the page of a balanced machine."""
    shown = overview(result)
    chapters = {"Trade-off": trade_off(result), "Before and after": cycle_charts(result)}
    curves = [PageSection(name, group) for name, group in chapters.items()]
    return StoredStudy(
        problem=result.problem,
        kind="balance",
        verdict=VERDICTS[result.status] if result.valid or result.status is Status.INFEASIBLE else "Not valid",
        valid=result.valid,
        conclusion=conclusion(result),
        status=shown.status.lines[1:] if result.refuted else shown.status.lines,  # the conclusion states the conflict
        sections=[PageSection("Balance and verification", (shown.parts,)), *curves],
        design=None if result.machine is None else (result.machine, {}),
        by=f"a convex programme, {result.solver}; verified by the inverse dynamics of the balanced machine",
        drawn="The balanced machine: rings mark the centroids of its bodies with their counterweights.",
        after=1,
    )


def overview(outcome: Balance) -> Summary:
    """Summarise a balancing result."""
    message: Inline = verdict(outcome.message, outcome.valid) if outcome.proven or not outcome.valid else outcome.message
    status: list[Inline] = [message, *noted(outcome.notes)]
    title, parts, short = outcome.problem.model.title, list[Part](), None
    if outcome.conflict:
        parts.append(_conflict(outcome))
    elif outcome.rows:
        objective, added = _objective(outcome), _added(outcome)
        limits = _limits(outcome) if outcome.limits else None
        parts += [objective, added, _measures(outcome), *([limits] if limits else [])]
        if outcome.trade is not None:
            parts.append(_trade(outcome.trade))
        measured = objective_line(replace(objective, rows=objective.rows[:2]))
        short = short_text(title, [*status, measured], _in_words(added), limits)
    counts = f"{count_noun(outcome.iterations, 'iteration')}, {count_noun(len(outcome.angles), 'position')}"
    effort = f"{outcome.solver}, {counts}; {times(outcome.seconds)}"
    return replace(summary(title, status, *parts, Paragraph(quiet(effort), appendix=True)), short=short)


def _objective(outcome: Balance) -> TableSpec:
    unit = outcome.unit or "of the initial machine's"
    comparison = f"{change(-outcome.reduction)} against the initial {number(outcome.before)}"
    remark = f"duality gap {outcome.gap:.1e}, computed from the dual point"
    if outcome.exact:
        remark = "unconstrained least-squares optimum: a lower bound for all counterweights"
    agrees = quiet("inverse dynamics of the balanced machine agrees")
    off = max([outcome.disagreement, *(p.disagreement for p in (outcome.trade.points if outcome.trade else ()))])
    rows: list[Row] = [
        (outcome.measure, strong(number(outcome.objective, 9)), unit, quiet(comparison)),
        ("lower bound", number(max(outcome.lower, 0.0), 9), unit, quiet(remark)),
        ("verification", f"{off:.1e}", "", agrees if outcome.verified else bad("inverse dynamics DISAGREES")),
    ]
    return table("Objective", "<><<", rows)


def _added(outcome: Balance) -> TableSpec:
    rows: list[Row] = []
    for weight in outcome.added:
        x, y = weight.place
        size, what = (weight.gyration, "of gyration") if weight.radius is None else (weight.radius, "disc")
        thickness = weight.specification.thickness_of(weight.mass) if weight.specification.kind == "disc" else None
        if thickness is not None:
            what += f", {number(thickness * 1e3, 4)} mm thick"
        along = float(weight.parameters.along)
        across = _tiny(float(weight.parameters.across), along)
        moment = number(math.hypot(along, across)), fixed(math.degrees(math.atan2(across, along)), 2)
        place = f"({number(x * 1e3, 5)}, {number(y * 1e3 if abs(y) > 1e-9 * abs(x) else 0.0, 5)})"
        rows.append((weight.body, number(weight.mass), place, *moment, number(size * 1e3, 5), quiet(what)))
    for spring in outcome.springs:
        ends = "-".join(point for _, point in spring.specification.ends)
        made = f"spring {ends}: {number(spring.stiffness)} N/m, free length {number(spring.free * 1e3)} mm"
        rows.append((spring.specification.name, "", "", "", "", "", made))
    columns = ["body", ">mass [kg]", ">centre [mm]", ">m·r [kg·m]", ">at [deg]", ">radius\n[mm]", ""]
    return table("Counterweights: centre along and across the body; m·r and its angle from the body", columns, rows)


def _in_words(added: TableSpec) -> Paragraph:
    """Return the table of counterweights and springs as a line for each."""
    lines = []
    for name, mass, place, _, _, radius, what in (tuple(cell.text for cell in row) for row in added.rows):
        size = f"{mass} kg at {place} mm, radius {radius} mm, " if mass else ""
        lines.append(f"{name}: {size}{what}")
    return Paragraph(strong("Counterweights: centre along and across the body"), *lines)


def _measures(outcome: Balance) -> TableSpec:
    rows: list[Row] = []
    for rms, most in zip(outcome.rows[::2], outcome.rows[1::2], strict=True):
        cells, largest = [], max(rms.before, rms.after)
        unit = scale(largest, unit_of(rms.measure))
        for row in (rms, most):
            less = percent(row.change, 1, signed=True).removesuffix(" %")
            cells += [f"{value * unit.factor:.4g}" for value in (row.before, _tiny(row.after, row.before))] + [less]
        rows.append((rms.measure.subject.removeprefix("reaction "), *cells, quiet(unit.unit)))
    columns = ["", ">rms", ">after", ">%", ">largest", ">after", ">%", ""]
    return table("Before and after, by inverse dynamics", columns, rows)


def _tiny(value: float, scale: float) -> float:
    """Return zero for values that are rounding error relative to `scale`."""
    return value if abs(value) > 1e-12 * abs(scale) else 0.0


def _limits(outcome: Balance) -> Part:
    rows, together = [], dict[frozenset[str], str]()
    for limit in (limit for limit in outcome.limits if limit.active):
        step = f"{limit.step * 1e3:.4g} g" if limit.unit == "kg" else f"{limit.step:.4g} {limit.unit}"
        price = f"{100.0 * limit.buys:.3g} % per {step}"
        if limit.buys <= 1e-9:
            price = "no effect alone" if limit.depends_on else "no effect: of several optima the lightest was chosen"
        if limit.depends_on:
            names = (limit.name, *limit.depends_on)
            together.setdefault(frozenset(names), f"limits that gain less alone than together: {joined(names)}")
        rows.append((limit.name, f"{SENSES[limit.sense]} {limit.bound:.6g} {limit.unit}", price))
    if not rows:
        none = "none: only the permitted counterweights and springs determine this optimum"
        return Paragraph(strong("Active constraints"), none)
    return table("Active constraints and their shadow prices", "<<<", rows, notes=[*map(quiet, together.values())])


def _conflict(outcome: Balance) -> TableSpec:
    rows = []
    for item in outcome.conflict:
        sense = SENSES[item.sense]
        single = "never" if not math.isfinite(item.relaxed) else f"{sense} {item.relaxed:.6g} {item.unit}"
        off = item.together - item.bound
        kept = abs(off) <= 1e-6 * max(abs(item.bound), 1e-9)
        together = "unchanged" if kept else f"{item.together:.6g} {item.unit} ({off:+.4g})"
        rows.append((item.name, f"{sense} {item.bound:.6g} {item.unit}", single, together))
    columns = ["limit", "limit value", "feasible if relaxed alone", "together"]
    return table("Conflicting limits", columns, rows)


def _trade(trade: TradeOff) -> TableSpec:
    first, second = trade.first, trade.second
    title = f"Trade-off, {len(trade.points)} points"
    if math.isfinite(trade.ratio):
        title += f"; a further point takes {percent(trade.ratio)} of the time of the first"
    if len(trade.points) == 1:
        title = "No trade-off: one machine minimises both"
    step, rows = max(1, math.ceil(len(trade.points) / MAX_POINTS)), []
    ends = {len(trade.points) - 1: f"least {second.subject}", 0: f"least {first.subject}"}
    for k, point in enumerate(trade.points):
        mark = ends.get(k, "knee" if k == trade.knee else "")
        if k % step and not mark:
            continue
        price = f"{point.rate:.3g}" if math.isfinite(point.rate) else ""
        rows.append((mark, *_compared(trade, point), price, f"{point.gap:.0e}"))
    heads = [f">{term.words} {unit_of(term)}" for term in (first, second)]
    return table(title, ["", heads[0], ">", heads[1], ">", ">price", ">gap"], rows)


def conclusion(result: Balance) -> str:
    """Return the conclusion of a balancing: change of the objective, and active limits."""
    if result.conflict:
        return shown(result.refuted)
    if not result.rows:
        return "No balancing was found."
    left = result.objective if abs(result.objective) > ROUNDING * abs(result.before) else 0.0
    mass = sum(counterweight.mass for counterweight in result.added)
    text = f"The {result.measure} decreases by {100.0 * result.reduction:.4g} % to {figure(left, result.unit or '')}"
    text = text.rstrip() + f" with {figure(mass, 'kg')} of counterweights"
    active = [limit.name for limit in result.limits if limit.active]
    limiting = f" Active limits: {joined(active[:3])}." if active else ""
    return f"{text}.{limiting}" if result.valid else f"Not valid. {text}.{limiting}"


VIEW = View(
    overview,
    charts=charts,
    drawings={"mechanism": SomeDrawing(lambda result: result.heavier and result, _mechanism)},
    tables=_tables,
    design=_design,
    page=page,
)
