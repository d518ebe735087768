"""Terminal tables of parametric studies."""

from __future__ import annotations

import math

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, fixed, grid, number, points
from optlink.studies.motion_sensitivity import OutputSensitivity
from optlink.studies.sensitivity import Sensitivities, Sensitivity, ValidityEnd
from optlink.studies.sweep import TEXT, Sweep

AGREES = 1e-5  # relative tolerance between exact derivatives and those from solving again
SHOWN = 12  # largest number of active-set changes and of points listed
ACROSS = 5  # largest number of quantities side by side
TINY = 5e-6  # relative change that vanishes with three decimals of a percentage
FEW = 3  # largest number of design variables with their own columns
MOVERS = 2  # number of design variables listed otherwise


def step(row: Sensitivity) -> str:
    """Format the parameter change by which effects are compared."""
    p = row.parameter
    if p.unit == "deg":
        return "1 deg"
    return "1 %" if p.value else f"{p.step:g} {p.unit}".rstrip()


def sensitivities(result: Sensitivities) -> RenderableType:
    """Summarise the sensitivities of an optimum to its fixed parameters, largest effect first."""
    names = list(result.units)
    title = Text(result.problem.model.title, style=HEAD)
    for note in result.notes:
        title.append(f"\nNote: {note}")
    found = grid("Optimum", [("", "left"), ("", "right"), ("", "left")])
    found.add_row("objective", Text(number(result.solution.objective), style=HEAD), result.unit)
    for name, value in result.values.items():
        found.add_row(name, Text(fixed(value), style=HEAD), result.units[name])
    few = len(names) <= FEW
    each = [(f"{name}\n[{result.units[name]}]", "right") for name in names] if few else [("moves most", "left")]
    columns = [("given", "left"), ("change", "right"), ("objective", "right"), *each]
    table = grid("Sensitivity to prescribed values, largest effect first", columns, header=True)
    for row in result.moving:
        p = row.parameter
        share = row.effect / result.solution.objective if result.solution.objective else math.nan
        table.add_row(
            p.name,
            f"{number(p.value)} {p.unit}".rstrip() + f" + {step(row)}",
            Text(_percent(share), style=GOOD if row.effect < 0.0 else ""),
            *([_signed(row.design[name] * p.step) for name in names] if few else [_movers(result, row)]),
        )
    parts: list[RenderableType] = [title, Text(), found, Text()]
    if result.moving:
        parts += [table, Text(), _prices(result), Text(), _events(result)]
    else:
        parts.append(Text("Nothing that is given moves this optimum, to first order."))
    still = [row.parameter.name for row in result.rows if not row.moves]
    if still:
        parts += [Text(), Text(f"Without effect here: {'; '.join(dict.fromkeys(still))}.", style=QUIET)]
    if result.gap is not None:
        style = GOOD if result.gap <= AGREES else BAD
        line = Text.assemble(("\nRe-optimised on both sides of each: ", QUIET), (f"largest difference {result.gap:.1e}", style))
        parts.append(line)
    return Group(*parts)


def _movers(result: Sensitivities, row: Sensitivity) -> str:
    """Format the design variables with the largest relative response to a parameter."""
    sizes = {name: abs(result.values[name]) or 1.0 for name in row.design}
    order = sorted(row.design, key=lambda name: -abs(row.design[name]) / sizes[name])
    told = [
        f"{name} {_signed(row.design[name] * row.parameter.step)}\u00a0{result.units[name]}" for name in order if row.design[name]
    ]
    return ", ".join(told[:MOVERS])


def _prices(result: Sensitivities) -> Table:
    """Tabulate the derivatives of the objective."""
    table = grid("Per unit", [("", "left"), ("", "right"), ("", "left")])
    for row in result.moving:
        p = row.parameter
        per = f"{result.unit} per {p.unit or 'unit'}".strip()
        table.add_row(p.key, f"{row.objective:+.6g}" if row.objective else "0", Text(per, style=QUIET))
    return table


def _events(result: Sensitivities) -> Table:
    table = grid("What ends the range in which this holds (to first order)", [("", "left"), ("", "left"), ("", "left")])
    for row in result.moving:
        for word, end in (("below", row.below), ("above", row.above)):
            if math.isfinite(end.value):
                table.add_row(
                    row.parameter.name, f"{word} {_end(end)} {row.parameter.unit}".rstrip(), Text(end.event, style=QUIET)
                )
    return table


def _end(end: ValidityEnd) -> str:
    return number(end.value, 5) if math.isfinite(end.value) else "any"


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return "-"
    tiny = 0.0 < abs(share) < TINY
    return f"{100.0 * share:+.1e} %" if tiny else f"{share:+.3%}".replace("%", " %")


def _signed(value: float) -> str:
    return f"{value:+.4g}" if value else "0"


def outputs(found: OutputSensitivity) -> RenderableType:
    """Tabulate the derivatives of an output with respect to every dimension, one row for each crank angle."""
    angular = found.unit == "rad"
    per = "deg per mm" if angular else "mm per mm"
    factor = math.degrees(1.0) / 1e3 if angular else 1.0
    table = grid(
        f"{found.name}: change per size, at a crank angle that stays [{per}]",
        [("crank [deg]", "right"), (f"{found.name} [{'deg' if angular else 'mm'}]", "right"), *((n, "right") for n in found.by)],
        header=True,
    )
    shown = np.degrees(found.value) if angular else 1e3 * found.value
    for i, angle in enumerate(np.degrees(found.crank_angles)):
        table.add_row(f"{angle:g}", fixed(shown[i], 4), *(fixed(factor * column[i], 6) for column in found.by.values()))
    return table


def sweep(result: Sweep) -> RenderableType:
    """Summarise a parameter sweep."""
    title = Text(result.problem.model.title, style=HEAD)
    every = " x ".join(f"{len(axis.values):,}" for axis in result.grid.axes)
    title.append(f"\n{points(result.grid.count)}" + (f" ({every})" if len(result.grid.axes) > 1 else ""))
    title.append(", ").append(_counted(result), style=GOOD if result.complete else BAD)
    if result.infeasible:
        title.append("\nWhich limits conflict where there is no design: `optlink solve` with --set at such a point")
    parts: list[RenderableType] = [title, Text()]
    axes = grid("Varied", [("", "left"), ("", "left"), ("", "right")])
    for axis in result.grid.axes:
        span = f"{axis.values[0]:g} ... {axis.values[-1]:g} {axis.unit}".rstrip()
        axes.add_row(axis.key, span, Text(f"{len(axis.values):,} values", style=QUIET))
    parts.append(axes)
    if result.best is not None:
        best = grid("Best", [("", "left"), ("", "right")])
        for name, value in result.best.items():
            if name in ("status", "valid", "failed", "found", "active_set_changed"):
                continue
            best.add_row(name, value if name == "active" else number(float(value), 8))
        parts += [Text(), best]
    if result.changes:
        parts += [Text(), _changes(result)]
    if result.evaluated:
        parts += [Text(), *_rows(result)]
    rate = result.done / result.seconds if result.seconds else 0.0
    line = f"{points(result.done)} done in {result.seconds:.1f} s ({rate:,.0f} a second"
    line += f"; {1e3 * result.cpu / result.done:.2f} ms of processor time each)" if result.done else ")"
    if not result.evaluated:
        line += f"; {result.searched:,} needed a search, the others followed a neighbour"
    return Group(*parts, Text(), Text(line, style=QUIET))


def _counted(result: Sweep) -> str:
    """Count the points by outcome."""
    if not result.evaluated:
        if result.complete:
            return "every optimum proven"
        missed = result.grid.count - result.valid - result.infeasible
        counts = {"proven": result.valid, "hold no design": result.infeasible, "not proven": missed}
    else:
        counts = dict(result.statuses)
    return ", ".join(f"{count:,} {words}" for words, count in counts.items() if count)


def _rows(result: Sweep) -> list[RenderableType]:
    """Tabulate the first points of a sweep of analyses; for larger sweeps, the extremes of each quantity."""
    axes = result.grid.axes
    names = [name for name in result.names[len(axes) :] if name not in TEXT and name != "valid"]
    columns = result.columns
    parts: list[RenderableType] = []
    few = result.grid.count <= SHOWN and len(names) <= ACROSS
    if not few and result.valid:
        heads = [("", "left"), ("least", "right"), ("at", "right"), ("largest", "right"), ("at", "right")]
        span = grid("Figures over all valid points", heads, header=True)
        valid = np.flatnonzero(columns["valid"])
        for name in names:
            least, largest = (int(valid[of(columns[name][valid])]) for of in (np.nanargmin, np.nanargmax))
            span.add_row(name, *(text for k in (least, largest) for text in (number(columns[name][k]), _place(result, k))))
        parts += [span, Text()]
    varied = [(_short(axis.key, axis.unit), "right") for axis in axes]
    if few:
        heads = [(name.replace(".", ".\n"), "right") for name in names]
        table = grid("Points", [*varied, *heads, ("status", "left")], header=True)
        for k in range(result.grid.count):
            cells = [number(float(columns[name][k])) for name in names]
            table.add_row(*_values(result, k), *cells, Text(columns["status"][k], style="" if columns["valid"][k] else BAD))
        parts += [table, Text()]
    bad = np.flatnonzero(~columns["valid"])
    if bad.size:
        table = grid(f"Points that are not valid: {bad.size:,}", [*varied, ("reason", "left")], header=True)
        for k in map(int, bad[:SHOWN]):
            table.add_row(*_values(result, k), columns["reason"][k])
        if bad.size > SHOWN:
            table.caption = f"and {bad.size - SHOWN:,} more; the table of the sweep has all"
        parts += [table, Text()]
    return parts[:-1]


def _values(result: Sweep, point: int) -> list[str]:
    return [f"{value:g}" for value in result.grid.values(point)]


def _short(key: str, unit: str) -> str:
    """Abbreviate a key by the section of its mechanism, with its unit below."""
    name = key.removeprefix("mechanism.").removeprefix("links.")
    return name.replace(".", ".\n") + (f"\n[{unit}]" if unit else "")


def _place(result: Sweep, point: int) -> str:
    values = zip(result.grid.axes, result.grid.values(point), strict=True)
    return ", ".join(f"{value:g} {axis.unit}".rstrip() for axis, value in values)


def _changes(result: Sweep) -> Table:
    table = grid(
        f"Where other limits begin to hold the design: {result.changed}",
        [*((axis.column, "right") for axis in result.grid.axes), ("before", "left"), ("from there on", "left")],
        header=True,
    )
    for change in result.changes[:SHOWN]:
        table.add_row(*(f"{value:g}" for value in change.at.values()), change.before or "none", change.after or "none")
    return table
