"""Terminal tables of a balancing result and of the `[balance]` section."""

from __future__ import annotations

import math

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.problem.machine.balance import BalanceSection
from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, grid, number
from optlink.tasks.results.balance import Balance, TradeOff

COLUMN = tuple[str, str]
SHOWN = 15  # largest number of listed points of a trade-off

WORDS = {
    "optimal": "optimal, proven: no counterweights within the limits do better",
    "relaxed": "near the proven bound: discs do not reach it",
    "infeasible": "no counterweights meet all limits",
    "stalled": "the solver could not prove an optimum; loosen a limit or scale the problem",
}


def balance(outcome: Balance) -> RenderableType:
    """Summarise a balancing result."""
    title = Text(outcome.problem.model.title, style=HEAD)
    good = outcome.valid and outcome.proven
    title.append(f"\n{WORDS[outcome.status]}", style=GOOD if good else "" if outcome.valid else BAD)
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    parts: list[RenderableType] = [title, Text()]
    if outcome.conflict:
        parts += [_conflict(outcome)]
    elif outcome.rows:
        parts += [_objective(outcome), Text(), _added(outcome), Text(), _measures(outcome)]
        if outcome.limits:
            parts += [Text(), _limits(outcome)]
        if outcome.trade is not None:
            parts += [Text(), _trade(outcome.trade)]
    words = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in outcome.seconds.items())
    parts += [
        Text(),
        Text(f"{outcome.solver}, {outcome.iterations} iterations, {len(outcome.angles)} positions; {words}", style=QUIET),
    ]
    return Group(*parts)


def percent(share: float) -> str:
    """Format a relative change in per cent, with its sign."""
    if not math.isfinite(share):
        return "-"
    shown = round(100.0 * share, 2) + 0.0
    return f"{shown:+.2f} %".replace("-", "−")


def _objective(outcome: Balance) -> Table:
    table = grid("Objective", [("", "left"), ("", "right"), ("", "left"), ("", "left")])
    unit = outcome.unit or "of the given machine's"
    change = f"{percent(-outcome.reduction)} against the given {number(outcome.before)}"
    table.add_row(outcome.measure, Text(number(outcome.objective, 9), style=HEAD), unit, Text(change, style=QUIET))
    proof = f"duality gap {outcome.gap:.1e}, computed from the dual point"
    if outcome.exact:
        proof = "least squares without any limit: nothing can be below"
    table.add_row("proven lower bound", number(max(outcome.lower, 0.0), 9), unit, Text(proof, style=QUIET))
    agreed = "inverse dynamics of the balanced machine agrees" if outcome.verified else "inverse dynamics DISAGREES"
    off = max([outcome.disagreement, *(p.disagreement for p in (outcome.trade.points if outcome.trade else ()))])
    table.add_row("verification", f"{off:.1e}", "", Text(agreed, style=QUIET if outcome.verified else BAD))
    return table


def _added(outcome: Balance) -> Table:
    columns: list[COLUMN] = [("body", "left"), ("mass kg", "right"), ("centre mm", "right")]
    columns += [("m r kg m", "right"), ("radius", "right"), ("", "left")]
    table = grid("Counterweights; centre and m r along and across their bodies", columns, header=True)
    for one in outcome.added:
        x, y = one.place
        size, what = (one.radius, "disc") if one.radius is not None else (one.gyration, "of gyration")
        thickness = one.asked.thickness_of(one.mass) if one.asked.kind == "disc" else None
        if thickness is not None:
            what += f" x {number(thickness * 1e3, 4)} mm"
        along, across = float(one.parameters.along), _tiny(float(one.parameters.across), float(one.parameters.along))
        product = f"{along:.6g} {across:+.6g}i".replace("-", "−")
        place = f"({number(x * 1e3, 5)}, {number(y * 1e3 if abs(y) > 1e-9 * abs(x) else 0.0, 5)})"
        table.add_row(one.body, number(one.mass), place, product, number(size * 1e3, 5), Text(what, style=QUIET))
    for spring in outcome.springs:
        ends = "-".join(point for _, point in spring.asked.ends)
        told = f"spring {ends}: {number(spring.stiffness)} N/m, free length {number(spring.free * 1e3)} mm"
        table.add_row(spring.asked.name, "", "", "", "", told)
    return table


def _measures(outcome: Balance) -> Table:
    columns: list[COLUMN] = [("", "left"), ("rms", "right"), ("after", "right"), ("%", "right")]
    columns += [("largest", "right"), ("after", "right"), ("%", "right"), ("", "left")]
    table = grid("Before and after, by inverse dynamics", columns, header=True)
    for rms, most in zip(outcome.rows[::2], outcome.rows[1::2], strict=True):
        cells, largest = [], max(rms.before, rms.after)
        factor, letter = next(
            ((f, u) for f, u in ((1e-3, "k"), (1.0, ""), (1e3, "m"), (1e6, "µ")) if largest * f >= 1.0), (1.0, "")
        )
        for row in (rms, most):
            change = f"{100.0 * row.change:+.1f}".replace("-", "−") if math.isfinite(row.change) else "-"
            cells += [f"{value * factor:.4g}" for value in (row.before, _tiny(row.after, row.before))] + [change]
        table.add_row(rms.measure.quantity.removeprefix("reaction "), *cells, Text(letter + rms.measure.unit, style=QUIET))
    return table


def _tiny(value: float, scale: float) -> float:
    """Return zero for values that are rounding error relative to `scale`."""
    return value if abs(value) > 1e-12 * abs(scale) else 0.0


def _limits(outcome: Balance) -> RenderableType:
    active = [limit for limit in outcome.limits if limit.active]
    if not active:
        return Text.assemble(("Active constraints", HEAD), "\nnone: only what can be added shapes this optimum")
    columns: list[COLUMN] = [("limit", "left"), ("", "left"), ("what it costs", "left")]
    table = grid("Active constraints and their shadow prices", columns)
    for limit in active:
        more = "more" if limit.sense == "at most" else "less"
        step = f"{limit.step * 1e3:.4g} g" if limit.unit == "kg" else f"{limit.step:.4g} {limit.unit}"
        buys = f"{step} {more} buys {100.0 * limit.buys:.3g} %"
        if limit.buys <= 1e-9:
            buys = "nothing: of many optima that with the least mass was chosen"
        table.add_row(limit.name, f"{limit.sense} {limit.bound:.6g} {limit.unit}", buys)
    return table


def _conflict(outcome: Balance) -> Table:
    columns: list[COLUMN] = [
        ("limit", "left"),
        ("limit value", "left"),
        ("feasible if relaxed alone", "left"),
        ("together", "left"),
    ]
    table = grid("These limits cannot hold together", columns, header=True)
    for item in outcome.conflict:
        asked = f"{item.sense} {item.bound:.6g} {item.unit}"
        alone = "never" if not math.isfinite(item.alone) else f"{item.sense} {item.alone:.6g} {item.unit}"
        off = item.together - item.bound
        together = (
            "as asked" if abs(off) <= 1e-6 * max(abs(item.bound), 1e-9) else f"{item.together:.6g} {item.unit} ({off:+.4g})"
        )
        table.add_row(item.name, asked, alone, together)
    return table


def _trade(trade: TradeOff) -> Table:
    one, other = trade.first, trade.second
    columns: list[COLUMN] = [("", "left"), (f"{one} {one.unit}", "right"), ("", "right"), (f"{other} {other.unit}", "right")]
    columns += [("", "right"), ("price", "right"), ("gap", "right")]
    title = f"Trade-off, {len(trade.points)} points"
    if math.isfinite(trade.ratio):
        title += f"; a further point costs {trade.ratio:.1%} of the first"
    if len(trade.points) == 1:
        title = "No trade-off: one machine has the least of both"
    table = grid(title, columns, header=True)
    step = max(1, math.ceil(len(trade.points) / SHOWN))
    for k, point in enumerate(trade.points):
        ends = {0: f"least {one.quantity}", len(trade.points) - 1: f"least {other.quantity}"}
        mark = ends.get(k, "knee" if k == trade.knee else "")
        if k % step and not mark:
            continue
        shares = [percent(value / before - 1.0) for value, before in zip(point.made, trade.before, strict=True)]
        price = f"{point.rate:.3g}" if math.isfinite(point.rate) else ""
        table.add_row(mark, number(point.made[0]), shares[0], number(point.made[1]), shares[1], price, f"{point.gap:.0e}")
    return table


def asked(section: BalanceSection) -> list[RenderableType]:
    """List the settings of the `[balance]` section."""
    table = grid("\n[balance]", [("", "left"), ("", "left")])
    goal = section.goal
    table.add_row("minimise", str(goal[0][0]) if len(goal) == 1 else " + ".join(f"{w:g} {measure}" for measure, w in goal))
    for ceiling in section.limits.values():
        table.add_row("limit", f"{ceiling.measure} at most {ceiling.text}")
    if section.mass is not None:
        table.add_row("mass of all", str(section.mass))
    table.add_row("positions", str(section.positions))
    for weight in section.counterweights:
        stated = {key: getattr(weight, key) for key in type(weight).model_fields if key != "body"}
        table.add_row(f"on {weight.body}", ", ".join(f"{key} {value}" for key, value in stated.items() if value is not None))
    for spring in section.springs:
        table.add_row(spring.name, f"spring {'-'.join(spring.between)}, stiffness {spring.stiffness or 'free'}")
    return [table]
