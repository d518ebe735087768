"""Tables of a balancing result and of the `[balance]` section."""

import math
from dataclasses import replace

from optlink.balancing.measures import unit_of
from optlink.problem.machine.balance import BalanceSection
from optlink.report.format import change, fixed, joined, number, scale, times
from optlink.report.table_spec import (
    Line,
    Paragraph,
    Part,
    Row,
    Span,
    Summary,
    TableSpec,
    bad,
    good,
    noted,
    quiet,
    strong,
    summary,
    table,
)
from optlink.report.views.short_text import objective_line, short_text
from optlink.tasks.results.balance import Balance, TradeOff
from optlink.units import percent

MAX_POINTS = 15  # largest number of listed points of a trade-off


def balance(outcome: Balance) -> Summary:
    """Summarise a balancing result."""
    styled = good if outcome.valid and outcome.proven else Span if outcome.valid else bad
    status: list[Line] = [styled(outcome.message), *noted(outcome.notes)]
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
    effort = f"{outcome.solver}, {outcome.iterations} iterations, {len(outcome.angles)} positions; {times(outcome.seconds)}"
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
            what += f" x {number(thickness * 1e3, 4)} mm"
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
        rows.append((limit.name, f"{limit.sense} {limit.bound:.6g} {limit.unit}", price))
    if not rows:
        none = "none: only the permitted counterweights and springs determine this optimum"
        return Paragraph(strong("Active constraints"), none)
    return table("Active constraints and their shadow prices", "<<<", rows, notes=[*map(quiet, together.values())])


def _conflict(outcome: Balance) -> TableSpec:
    rows = []
    for item in outcome.conflict:
        single = "never" if not math.isfinite(item.alone) else f"{item.sense} {item.alone:.6g} {item.unit}"
        off = item.together - item.bound
        kept = abs(off) <= 1e-6 * max(abs(item.bound), 1e-9)
        together = "unchanged" if kept else f"{item.together:.6g} {item.unit} ({off:+.4g})"
        rows.append((item.name, f"{item.sense} {item.bound:.6g} {item.unit}", single, together))
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
        shares = [change(value / before - 1.0) for value, before in zip(point.realised, trade.before, strict=True)]
        price = f"{point.rate:.3g}" if math.isfinite(point.rate) else ""
        rows.append((mark, number(point.realised[0]), shares[0], number(point.realised[1]), shares[1], price, f"{point.gap:.0e}"))
    heads = [f">{term.words} {unit_of(term)}" for term in (first, second)]
    return table(title, ["", heads[0], ">", heads[1], ">", ">price", ">gap"], rows)


def balance_problem(section: BalanceSection) -> TableSpec:
    """List the settings of the `[balance]` section."""
    rows = [("minimise", section.words)]
    rows += [("limit", f"{term.words} at most {limit.max}") for term, limit in section.limited]
    if section.mass is not None:
        rows.append(("mass of all", str(section.mass)))
    rows.append(("positions", str(section.positions)))
    for weight in section.counterweights:
        settings = {key: getattr(weight, key) for key in type(weight).model_fields if key != "body"}
        rows.append((f"on {weight.body}", ", ".join(f"{key} {value}" for key, value in settings.items() if value is not None)))
    for spring in section.springs:
        rows.append((spring.name, f"spring {'-'.join(spring.between)}, stiffness {spring.stiffness or 'free'}"))
    return table("[balance]", "<<", rows)
