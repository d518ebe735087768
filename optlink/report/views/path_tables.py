"""Terminal tables of a path, motion, function or transmission synthesis result of any linkage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from optlink.linkage.cognates import Cognate, CouplerLinkage
from optlink.problem.path import TURN, PathProblem
from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, active, checks, conflict, fixed, graded, grid, number
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.path import LEVEL, OUTPUT, PathDesign, PathResult, display_unit
from optlink.validation import Check

ALIKE = 1e-3  # relative tolerance for equal four-bars
BOUNDED = " within its bounds"
GAP = 2  # gap between columns of a table [characters]
SHOWN = 12  # largest number of points listed on a terminal; result.json and points.csv contain all


def generation(outcome: PathResult) -> RenderableType:
    """Summarise a synthesis result: best design, deviations, active constraints, validation, alternatives, cognates."""
    title = Text(outcome.problem.model.title, style=HEAD)
    best = outcome.best
    if best is None:
        title.append("\nno linkage found", style=BAD)
        title.append(
            "\nno start could be assembled at all points within the bounds; widen them, or give more starts", style=QUIET
        )
        if outcome.conflict:
            return Group(title, Text(), conflict(outcome.conflict, outcome.together), Text(), _times(outcome))
        return Group(title, Text(), _times(outcome))
    given = outcome.starts == 0
    title.append("\ngiven design, " if given else f"\n{best.status.value}, ")
    title.append("valid" if best.valid else "not valid", style=GOOD if best.valid else BAD)
    many = (
        f"; {len(outcome.designs)} distinct design{'s' * (len(outcome.designs) != 1)} proven"
        if best.valid
        else "; the nearest miss"
    )
    graded(title, best.fit, "" if given else many)
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    chosen = "either" in str(outcome.problem.model.mechanism.assembly)
    parts: list[RenderableType] = [title, Text(), _sizes(best, chosen), Text(), _objective(best)]
    from optlink.report.views.analysis_tables import machine_strokes

    machine = turning_machine(best.problem, best.values)
    strokes = None if machine is None else machine_strokes(machine, float(best.crank_angles[-1] - best.crank_angles[0]))
    parts += [] if strokes is None else [Text(), strokes]
    if outcome.conflict:
        parts += [Text(), conflict(outcome.conflict, outcome.together)]
    if best.task.pointed:
        parts += [Text(), _points(best)]
    if best.solution is not None:
        parts += [Text(), _active(best)]
    parts += [Text(), _checks(best.validation.checks)]
    if len(outcome.designs) > 1:
        parts += [Text(), _Alternatives(outcome)]
    if best.cognates:
        parts += [Text(), _cognates(outcome)]
    return Group(*parts, Text(), _times(outcome))


def _sizes(design: PathDesign, chosen: bool) -> Table:
    task = design.task
    table = grid("Design", [("", "left"), ("", "right"), ("", "left"), ("", "left")])
    for name, quantity in task.quantities.items():
        factor, unit = display_unit(task, name)
        low, high = (bound * factor for bound in quantity.bounds)
        remark = f"free, {low:g} ... {high:g}" if quantity.free else "given"
        value = design.values[name] * factor
        shown = Text(significant(value), style=HEAD if quantity.free else "")
        table.add_row(name, shown, unit, Text(remark, style=QUIET))
    table.add_row("assembly", Text(words(design), style=HEAD), "", Text("chosen" if chosen else "given", style=QUIET))
    return table


def words(design: PathDesign) -> str:
    """Format the assembly modes."""
    return ", ".join(f"{joint} {mode}".strip() for joint, mode in modes(design).items())


def modes(design: PathDesign) -> dict[str, str]:
    """Return the assembly modes by joint; a four-bar has one mode with an empty name."""
    stated = design.assembly
    return {str(joint): str(mode) for joint, mode in stated.items()} if isinstance(stated, dict) else {"": str(stated)}


def significant(value: float) -> str:
    """Format a dimension with at least three decimals and six significant digits."""
    digits = 3 if abs(value) >= 100.0 or value == 0.0 else min(9, 5 - math.floor(math.log10(max(abs(value), 1e-6))))
    return fixed(value, digits)


def _objective(design: PathDesign) -> Table:
    measured, task = design.measured, design.task
    table = grid("Objective", [("", "left"), ("", "right"), ("", "left"), ("", "left")])
    factor, unit = OUTPUT[task.unit]
    rms, largest = math.sqrt(float((measured.distances**2).mean())), float(measured.distances.max())
    what = {"m": "distance", "rad": "error", "": "cosine"}[task.unit]
    remark = f"{what}: rms {number(factor * rms, 4)}, largest {number(factor * largest, 4)} {unit}".rstrip()
    if measured.turned is not None:
        remark += f"; angle: largest {number(math.degrees(float(abs(measured.turned).max())), 4)} deg"
    objective = Text(_figure(people_objective(design), 8), style=HEAD)
    table.add_row(measure(task), objective, people_objective_unit(design), Text(remark, style=QUIET))
    least = math.degrees(design.least_transmission)
    if math.isfinite(least):
        remark = "from 0 or 180 deg, at its worst " + ("of the revolution" if design.turns else "between the points")
        table.add_row("transmission angle", Text(fixed(least, 2)), "deg", Text(remark, style=QUIET))
    return table


def measure(task: PathProblem) -> str:
    """Return the name of the measure of the deviations, with a note if it is weighted."""
    return task.measure + (", weighted" if task.wanted.weights is not None else "")


def _figure(value: float, digits: int) -> str:
    """Format a number with all its digits, however small it is."""
    return number(value, digits) if value == 0.0 or abs(value) >= 1e-5 else f"{value:.{digits - 1}e}"


def people_objective_unit(design: PathDesign) -> str:
    """Return the display unit of the objective."""
    unit = OUTPUT[design.task.unit][1]
    return f"{unit}^2" if design.task.measure == "sum of squares" and unit else unit


def people_objective(design: PathDesign) -> float:
    """Return the objective in its display unit."""
    factor = OUTPUT[design.task.unit][0]
    return design.objective * (factor**2 if design.task.measure == "sum of squares" else factor)


def _active(design: PathDesign) -> RenderableType:
    """Tabulate the active constraints with their shadow prices in the display unit of the objective."""
    factor = people_objective(design) / design.objective if design.objective > 0.0 else 1.0
    held = [replace(limit, multiplier=limit.multiplier * factor) for limit in design.limits]
    return active(held, people_objective(design), people_objective_unit(design))


def _checks(asked: Sequence[Check]) -> Table:
    """Tabulate the checks of a validation, with passed bounds of dimensions in one row."""
    held = [check for check in asked if check.passed and check.name.endswith(BOUNDED)]
    if len(held) < 2:
        return checks(asked)
    table = checks([check for check in asked if check not in held])
    passed = sum(check.passed for check in asked)
    table.title = Text(f"Validation: {passed} of {len(asked)} checks passed", style=HEAD)
    table.add_row(Text("ok", style=GOOD), f"{len(held)} sizes within their bounds", "all", "", "")
    return table


def _points(design: PathDesign) -> Table:
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
    table = unbroken(grid("Points [mm, deg]", columns, header=True))
    step = max(1, math.ceil(len(wanted) / SHOWN))
    digits = decimals(1e3 * float(abs(wanted[:, :2]).max()))
    for i in range(0, len(wanted), step):
        places = (*wanted[i, :2], *measured.generated[i])
        row = [str(i + 1), *(fixed(1e3 * place, digits) for place in places), number(1e3 * measured.distances[i], 3)]
        row.append(fixed(math.degrees(design.crank_angles[i]), 2))
        if measured.turned is not None:
            row.append(number(math.degrees(measured.turned[i]), 3))
        table.add_row(*row)
    if step > 1:
        table.caption = Text(f"one in {step} of {len(wanted)} points; all of them with --out or --json", style=QUIET)
        table.caption_justify = "left"
    return table


def decimals(largest: float) -> int:
    """Return the number of decimals for coordinates up to `largest`."""
    size = math.floor(math.log10(largest)) if largest > 0.0 else 0
    return max(0, 7 - size) if size > 4 else min(8, 3 - min(size, 0))


def unbroken(table: Table) -> Table:
    """Disable line breaks in the right-aligned columns of a table and return it."""
    for column in table.columns:
        column.no_wrap = column.justify == "right"
    return table


class _Alternatives:
    """Table of the distinct designs, as many side by side as the terminal is wide enough for."""

    def __init__(self, outcome: PathResult) -> None:
        self.designs = outcome.designs
        self.kin = kin(outcome.designs)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield tables of as many designs as fit."""
        columns = [self._column(k) for k in range(len(self.designs))]
        names = [(name, unit) for name, unit in self._names() if any(name in column for column in columns)]
        head = max(len(name) for name, _ in names) + max(len(unit) for _, unit in names) + 2 * GAP
        widths = [max(len(text) for text in column.values()) + GAP for column in columns]
        first, title = 0, f"Designs, best first ({len(columns)} distinct)"
        while first < len(columns):
            last = first + 1
            while last < len(columns) and head + sum(widths[first : last + 1]) <= options.max_width:
                last += 1
            table = unbroken(grid(title, [("", "left"), ("", "left")], header=True))
            for k in range(first, last):
                table.add_column(f"{k + 1}", justify="right", no_wrap=True)
            for name, unit in names:
                table.add_row(name, Text(unit, style=QUIET), *(column.get(name, "") for column in columns[first:last]))
            yield table
            first, title = last, ""

    def _names(self) -> list[tuple[str, str]]:
        """Return the names of the rows with their units."""
        best, task = self.designs[0], self.designs[0].task
        free = [(name, display_unit(task, name)[1]) for name in task.quantities if task.quantities[name].free]
        joints = list(dict.fromkeys(f"assembly {joint}".rstrip() for design in self.designs for joint in modes(design)))
        first = [(measure(task), people_objective_unit(best)), ("least transmission angle", "deg"), ("same curve as", "")]
        return [*first, *free, *((joint, "") for joint in joints)]

    def _column(self, k: int) -> dict[str, str]:
        """Return the cells of a design by row."""
        design = self.designs[k]
        found = {measure(design.task): "exact" if exact(design) else _figure(people_objective(design), 5)}
        if math.isfinite(design.least_transmission):
            found["least transmission angle"] = fixed(math.degrees(design.least_transmission), 1)
        if k in self.kin:
            found["same curve as"] = f"cognate of {self.kin[k] + 1}"
        for name, quantity in design.task.quantities.items():
            if quantity.free:
                found[name] = significant(design.values[name] * display_unit(design.task, name)[0])
        return found | {f"assembly {joint}".rstrip(): mode for joint, mode in modes(design).items()}


def _cognates(outcome: PathResult) -> Table:
    columns = [
        ("crank", "right"),
        ("coupler", "right"),
        ("rocker", "right"),
        ("frame", "right"),
        ("", "left"),
        ("its crank", "left"),
    ]
    table = unbroken(grid("Cognates of the best: four-bars with the same coupler curve [mm]", columns, header=True))
    assert outcome.best is not None
    for cognate in outcome.best.cognates:
        linkage = cognate.linkage
        lengths = [significant(1e3 * length) for length in (linkage.crank, linkage.coupler, linkage.rocker, linkage.frame)]
        full = cognate.crank_turns and cognate.keeps_side
        turning = "turns fully" if full else "does not turn fully"
        listed = [k for k, design in enumerate(outcome.designs[1:], start=2) if _is(cognate, design)]
        told = "".join(f"; design {k}" for k in listed)
        table.add_row(*lengths, cognate.inversion.value, f"{turning}, follows the {cognate.turns_as}{told}")
    return table


def _times(outcome: PathResult) -> Text:
    times = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in outcome.seconds.items() if seconds > 0.0)
    if not outcome.starts:
        return Text(times, style=QUIET)
    told = outcome.evidence
    reached = f"{told.hits} of {outcome.starts} starts reached the best value; {told.chance}; " if outcome.designs else ""
    return Text(f"{reached}batch of least squares, then {outcome.backend}; {times}", style=QUIET)


# --- comparison of designs ---------------------------------------------------------------------------------------------------


def exact_places(design: PathDesign) -> bool:
    """Return whether every point, or every output of a function, is met to rounding."""
    return bool((design.measured.distances <= LEVEL * design.task.whole).all())


def exact_angles(design: PathDesign) -> bool:
    """Return whether all pose angles are met to rounding; true if there are none."""
    turned = design.measured.turned
    return turned is None or bool((abs(turned) <= LEVEL).all())


def exact(design: PathDesign) -> bool:
    """Return whether all prescribed values are met to rounding; false for transmission synthesis, which prescribes none."""
    return bool(design.task.unit) and exact_places(design) and exact_angles(design)


def kin(designs: Sequence[PathDesign]) -> dict[int, int]:
    """Return, by index of a design, the earlier design whose cognate it is: another four-bar with the same coupler curve."""
    found: dict[int, int] = {}
    for j, design in enumerate(designs):
        for i in range(j):
            if any(_is(cognate, design) for cognate in designs[i].cognates):
                found[j] = i
                break
    return found


def _is(cognate: Cognate, design: PathDesign) -> bool:
    """Return whether a design is this cognate, driven at either of its fixed pivots."""
    own = design.coupler_linkage
    return own is not None and any(_alike(own, each.linkage) for each in (cognate, cognate.driven_from_rocker))


def _alike(one: CouplerLinkage, other: CouplerLinkage) -> bool:
    names = ("crank", "coupler", "rocker", "frame", "along", "across", "x", "y")
    size = max(*one.lengths, abs(one.along), abs(one.across))
    turned = math.remainder(one.direction - other.direction, TURN)
    return abs(turned) <= ALIKE and all(abs(getattr(one, name) - getattr(other, name)) <= ALIKE * size for name in names)
