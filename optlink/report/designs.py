"""Path and motion generation as tables for people."""

from __future__ import annotations

import math

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.generation import OUTPUT, Design, Generation, objective_unit, people_unit
from optlink.report.terminal import BAD, GOOD, HEAD, QUIET, active, checks, fixed, grid, number

SHOWN = 12  # points listed on a terminal; result.json and points.csv have all


def generation(outcome: Generation) -> RenderableType:
    """Everything about a search for points or poses."""
    title = Text(outcome.problem.model.title, style=HEAD)
    best = outcome.best
    if best is None:
        title.append("\nno linkage found", style=BAD)
        title.append(
            "\nno start could be assembled at all points within the bounds; widen them, or give more starts", style=QUIET
        )
        return Group(title, Text(), _times(outcome))
    given = outcome.starts == 0
    title.append("\ngiven design, " if given else f"\n{best.status.value}, ")
    title.append("valid" if best.valid else "not valid", style=GOOD if best.valid else BAD)
    if not given:
        many = (
            f"{len(outcome.designs)} distinct design{'s' * (len(outcome.designs) != 1)} proven"
            if best.valid
            else "the nearest miss"
        )
        title.append(f"; {many}")
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    parts: list[RenderableType] = [title, Text(), _sizes(best), Text(), _objective(best)]
    if best.task.pointed:
        parts += [Text(), _points(best)]
    if best.solution is not None:
        parts += [Text(), active(best.limits, best.objective, objective_unit(best.task))]
    parts += [Text(), checks(best.validation.checks)]
    if len(outcome.designs) > 1:
        parts += [Text(), _designs(outcome)]
    if best.cognates:
        parts += [Text(), _cognates(best)]
    return Group(*parts, Text(), _times(outcome))


def _sizes(design: Design) -> Table:
    task = design.task
    table = grid("Design", [("", "left"), ("", "right"), ("", "left"), ("", "left")])
    for name, quantity in task.quantities.items():
        factor, unit = people_unit(task, name)
        low, high = (bound * factor for bound in quantity.bounds)
        remark = f"free, {low:g} ... {high:g}" if quantity.free else "given"
        value = design.values[name] * factor
        shown = Text(significant(value), style=HEAD if quantity.free else "")
        table.add_row(name, shown, unit, Text(remark, style=QUIET))
    table.add_row("assembly", Text(words(design), style=HEAD), "", Text("chosen" if _open(design) else "given", style=QUIET))
    return table


def words(design: Design) -> str:
    """Assembly modes in words."""
    modes = design.assembly
    return ", ".join(f"{joint} {mode}" for joint, mode in modes.items()) if isinstance(modes, dict) else str(modes)


def _open(design: Design) -> bool:
    return design.solution is not None and "either" in str(design.problem.model.mechanism.assembly)


def significant(value: float) -> str:
    """A size with at least three decimals and six digits."""
    digits = 3 if abs(value) >= 100.0 else min(9, 5 - math.floor(math.log10(max(abs(value), 1e-6))))
    return fixed(value, digits)


def _objective(design: Design) -> Table:
    measured, task = design.measured, design.task
    table = grid("Objective", [("", "left"), ("", "right"), ("", "left"), ("", "left")])
    factor, unit = OUTPUT[task.unit]
    squared = task.measure == "sum of squares"
    rms, largest = math.sqrt(float((measured.distances**2).mean())), float(measured.distances.max())
    what = {"m": "distance", "rad": "error", "": "cosine"}[task.unit]
    remark = f"{what}: rms {number(factor * rms, 4)}, largest {number(factor * largest, 4)} {unit}".rstrip()
    if measured.turned is not None:
        remark += f"; angle: largest {number(math.degrees(float(abs(measured.turned).max())), 4)} deg"
    name = task.measure + (", weighted" if task.wanted.weights is not None else "")
    objective = Text(number(people_objective(design), 8), style=HEAD)
    table.add_row(name, objective, f"{unit}^2" if squared and unit else unit, Text(remark, style=QUIET))
    least = math.degrees(design.least_transmission)
    if math.isfinite(least):
        remark = "from 0 or 180 deg, at its worst " + ("of the revolution" if design.turns else "between the points")
        table.add_row("transmission angle", Text(fixed(least, 2)), "deg", Text(remark, style=QUIET))
    return table


def people_objective(design: Design) -> float:
    """The objective in the unit that people read."""
    factor = OUTPUT[design.task.unit][0]
    return design.objective * (factor**2 if design.task.measure == "sum of squares" else factor)


def _points(design: Design) -> Table:
    measured, wanted = design.measured, design.task.data.columns
    columns = [
        ("", "right"),
        ("wanted", "right"),
        ("", "right"),
        ("generated", "right"),
        ("", "right"),
        ("off by", "right"),
        ("crank at", "right"),
    ]
    if measured.turned is not None:
        columns.append(("turned by", "right"))
    table = grid("Points [mm, deg]", columns, header=True)
    step = max(1, math.ceil(len(wanted) / SHOWN))
    for i in range(0, len(wanted), step):
        x, y = (1e3 * wanted[i, k] for k in (0, 1))
        gx, gy = 1e3 * measured.generated[i]
        row = [str(i + 1), fixed(x), fixed(y), fixed(gx), fixed(gy), number(1e3 * measured.distances[i], 3)]
        row.append(fixed(math.degrees(design.crank_angles[i]), 2))
        if measured.turned is not None:
            row.append(number(math.degrees(measured.turned[i]), 3))
        table.add_row(*row)
    if step > 1:
        table.add_row("", Text(f"every {step}th of {len(wanted)}", style=QUIET))
    return table


def _designs(outcome: Generation) -> Table:
    names = [name for name in outcome.designs[0].task.mechanism.quantities if outcome.designs[0].task.quantities[name].free]
    shown = names[:6]
    columns = [
        ("", "right"),
        ("objective", "right"),
        ("transm.", "right"),
        *((name, "right") for name in shown),
        ("assembly", "left"),
    ]
    table = grid(f"Designs, best first ({len(outcome.designs)} distinct)", columns, header=True)
    for k, design in enumerate(outcome.designs, start=1):
        values = [significant(design.values[name] * people_unit(design.task, name)[0]) for name in shown]
        objective = number(people_objective(design), 5)
        table.add_row(str(k), objective, fixed(math.degrees(design.least_transmission), 1), *values, words(design))
    return table


def _cognates(design: Design) -> Table:
    columns = [
        ("crank", "right"),
        ("coupler", "right"),
        ("rocker", "right"),
        ("frame", "right"),
        ("", "left"),
        ("its crank", "left"),
    ]
    table = grid("Cognates: other four-bars with the same coupler curve [mm]", columns, header=True)
    for cognate in design.cognates:
        linkage = cognate.linkage
        lengths = [fixed(1e3 * length) for length in (linkage.crank, linkage.coupler, linkage.rocker, linkage.frame)]
        full = cognate.crank_turns and cognate.keeps_side
        turning = "turns fully" if full else "does not turn fully"
        table.add_row(*lengths, cognate.inversion.value, f"{turning}, follows the {cognate.turns_as}")
    return table


def _times(outcome: Generation) -> Text:
    times = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in outcome.seconds.items() if seconds > 0.0)
    if not outcome.starts:
        return Text(times, style=QUIET)
    reached = f"{outcome.hits} of {outcome.starts} starts reached the best value; " if outcome.best is not None else ""
    return Text(f"{reached}batch of least squares, then {outcome.backend}; {times}", style=QUIET)
