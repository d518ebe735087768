"""Terminal tables of a function synthesis result and of a problem file, and the table helpers of all views."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.errors import Status
from optlink.optimization.objectives import MEASURES
from optlink.problem.base_model import Section
from optlink.problem.cycle import CycleProblem
from optlink.problem.file import ProblemFile
from optlink.problem.function import DesignProblem
from optlink.problem.mechanism import FourBarSection
from optlink.problem.path import MARK, START, ZERO, PathProblem
from optlink.problem.quantity import Interval, Quantity
from optlink.solvers.solution import LimitState
from optlink.tasks.function import FunctionResult, display_value
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.common import Relaxed
from optlink.tasks.results.fit import Fit
from optlink.validation import Check

GOOD, BAD, QUIET, HEAD = "green", "bold red", "dim", "bold"


def grid(title: str, columns: Iterable[tuple[str, str]], header: bool = False) -> Table:
    """Return an empty table with a title.

    Parameters
    ----------
    title : str
    columns : iterable of (str, str)
        Name and justification ("left" or "right") of each column.
    header : bool, optional
        Show the column names.
    """
    table = Table(
        title=Text(title, style=HEAD),
        title_justify="left",
        min_width=min(len(title), 79),
        box=box.SIMPLE_HEAD if header else None,
        show_header=header,
        header_style=QUIET,
        pad_edge=False,
        padding=(0, 2, 0, 0),
    )
    for name, justify in columns:
        table.add_column(name, justify=justify, overflow="fold")  # type: ignore[arg-type]
    return table


def number(value: float, digits: int = 6) -> str:
    """Format a number with significant digits; a dash if it is not finite.

    Parameters
    ----------
    value : float
    digits : int, optional
        Significant digits.
    """
    if not math.isfinite(value):
        return "-"
    if abs(value) < 1e-300:
        return "0"
    return f"{value:.{digits}g}" if abs(value) >= 1e-5 else f"{value:.1e}"


def points(count: int) -> str:
    """Format a number of points, with its noun."""
    return f"{count:,} point{'' if count == 1 else 's'}"


def fixed(value: float, digits: int = 3) -> str:
    """Format a number with fixed decimals; a dash if it is not finite.

    Parameters
    ----------
    value : float
    digits : int, optional
        Number of decimals.
    """
    return f"{round(value, digits) + 0.0:.{digits}f}" if math.isfinite(value) else "-"  # + 0.0: no negative zero


def result(outcome: FunctionResult) -> RenderableType:
    """Summarise a function synthesis result: design, objective, active constraints, validation, optima, back ends."""
    parts: list[RenderableType] = [_headline(outcome), Text(), _design(outcome)]
    parts += _strokes(outcome)
    if outcome.conflict:
        parts += [Text(), conflict(outcome.conflict, outcome.together)]
    else:
        parts += [Text(), _objective(outcome)]
        if outcome.solution:
            parts += [Text(), active(outcome.solution.limits, outcome.objective, outcome.unit)]
        parts += [Text(), checks(outcome.validation.checks)]
    if outcome.optima and (len(outcome.optima) > 1 or outcome.starts > 1):
        parts += [Text(), _optima(outcome)]
    if outcome.backends:
        parts += [Text(), _backends(outcome)]
    parts += [Text(), _times(outcome)]
    return Group(*parts)


def _strokes(outcome: FunctionResult) -> list[RenderableType]:
    """Tabulate the forward and return strokes of the rocker if the crank turns fully."""
    from optlink.report.views.analysis_tables import machine_strokes

    machine = turning_machine(outcome.problem, outcome.design)
    table = None if machine is None else machine_strokes(machine, outcome.problem.spec.span)
    return [] if table is None else [Text(), table]


def _headline(outcome: FunctionResult) -> Text:
    title = Text(outcome.problem.spec.title, style=HEAD)
    word = "valid" if outcome.valid else "not valid"
    if outcome.conflict:
        word = "no feasible design"
    elif outcome.status not in (Status.OPTIMAL, Status.NOT_SEARCHED):
        word = "no design"
    title.append(f"\n{outcome.status.value}, " if outcome.status is not Status.NOT_SEARCHED else "\ngiven design, ")
    title.append(word, style=GOOD if outcome.valid else BAD)
    if outcome.valid:
        graded(title, outcome.fit)
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    return title.append(f"\n{outcome.status.text}", style=QUIET)


def graded(title: Text, fit: Fit | None, tail: str = "") -> None:
    """Append the grade of a fit to a title, then a tail, then the likely reasons of a poor fit with remedies.

    Parameters
    ----------
    title : Text
        Changed in place.
    fit : Fit or None
        None appends the tail only.
    tail : str, optional
    """
    if fit is None:
        title.append(tail)
        return
    title.append(", ").append(fit.text, style=BAD if fit.grade == "poor" else "").append(tail)
    for each in fit.reasons:
        title.append(f"\n{fit.text.partition(':')[0].capitalize()}, likely reason: {each.reason}. Remedy: {each.remedy}.")


def _design(outcome: FunctionResult) -> Table:
    problem = outcome.problem.spec
    note = "Design" if not outcome.conflict else "Nearest design found (it does not meet the limits)"
    table = grid(note, [("", "left"), ("", "right"), ("", "left"), ("", "left")])
    for name, value in outcome.design.items():
        shown, unit = display_value(name, value)
        quantity = problem.quantities.get(name)
        if quantity is None:
            where = str(problem.requirement.start) if name == "phi0" else "the rocker's own angle there"
            remark = where if name == "psi0" else f"at the {where}"
        else:
            low, high = (display_value(name, bound)[0] for bound in quantity.bounds)
            remark = f"free, {low:g} ... {high:g}" if quantity.free else "given"
        bold = quantity is not None and quantity.free
        table.add_row(name, Text(fixed(shown), style=HEAD if bold else ""), unit, Text(remark, style=QUIET))
    table.add_row("assembly", Text(outcome.assembly), "", Text(f"joint C lies to the {outcome.assembly} of B -> D", style=QUIET))
    return table


def _objective(outcome: FunctionResult) -> Table:
    table = grid("Objective", [("", "left"), ("", "right"), ("", "left"), ("", "left")])
    rms, largest = (math.degrees(MEASURES[name].of(outcome.error())) for name in ("rms", "max"))
    robust = outcome.problem.spec.requirement.robust
    remark = f"error{'' if robust is None else ' as drawn'}: rms {number(rms, 4)}, largest {number(largest, 4)} deg"
    table.add_row(outcome.measure, Text(number(outcome.objective), style=HEAD), outcome.unit, Text(remark, style=QUIET))
    if robust is not None and outcome.unit == "rad":
        remark = "objective of the linkage with its tolerances"
        table.add_row("", Text(number(math.degrees(outcome.objective)), style=HEAD), "deg", Text(remark, style=QUIET))
    if outcome.problem.spec.everywhere:
        remark = f"the largest error is reached {outcome.alternations} times in turn, anywhere in the range"
        table.add_row("", Text(number(math.degrees(outcome.objective)), style=HEAD), "deg", Text(remark, style=QUIET))
    if outcome.first is not None:
        error, bound = (number(math.degrees(value), 4) for value in (outcome.first.error, outcome.first.bound))
        proof = f"; {bound} deg is the least at its start angles, proven" if outcome.first.proven else ""
        remark = f"a starting point: its error at the design positions alone, transmission angle 2 deg beyond its limits{proof}"
        table.add_row("convex first step", Text(error), "deg", Text(remark, style=QUIET))
    return table


def active(limits: Iterable[LimitState], objective: float, unit: str) -> RenderableType:
    """Tabulate the active constraints with their shadow prices.

    Parameters
    ----------
    limits : iterable of LimitState
        All constraints; inactive ones are left out.
    objective : float
        Value of the objective, for relative prices.
    unit : str
        Unit of the objective.
    """
    held = [limit for limit in limits if limit.active]
    if not held:
        return Text.assemble(("Active constraints", HEAD), "\nnone: only the requirement shapes this design")
    table = grid("Active constraints and their shadow prices", [("", "left"), ("", "left"), ("", "left")])
    for limit in held:
        bound = f"{limit.sense} {limit.bound:g} {limit.unit}".rstrip()
        gain = abs(limit.multiplier)
        share = f" ({gain / objective:.2%})" if 5e-5 * objective <= gain < 100.0 * objective else ""  # otherwise not informative
        buys = f"{gain:.4g} {unit} per {limit.unit or 'unit'}{share}" if gain > 0 else "nothing"
        table.add_row(limit.name, bound, buys)
    return table


def checks(asked: Sequence[Check]) -> Table:
    """Tabulate the checks of a validation."""
    passed = sum(check.passed for check in asked)
    table = grid(
        f"Validation: {passed} of {len(asked)} checks passed",
        [("", "left"), ("check", "left"), ("found", "right"), ("", "left"), ("allowed", "left")],
        header=True,
    )
    for check in asked:
        mark = Text("ok" if check.passed else "FAIL", style=GOOD if check.passed else BAD)
        table.add_row(mark, check.name, number(check.value), Text(check.unit, style=QUIET), check.limit)
    return table


def conflict(limits: Sequence[Relaxed], together: Sequence[Relaxed]) -> Table:
    """Tabulate conflicting limits with the relaxation that each would need.

    Parameters
    ----------
    limits : sequence of Relaxed
        Each limit relaxed alone; an infinite amount where that does not suffice.
    together : sequence of Relaxed
        Limits relaxed simultaneously; shown if one of `limits` does not suffice alone.
    """
    table = grid(
        "These limits cannot hold together",
        [("limit", "left"), ("limit value", "left"), ("feasible if relaxed alone", "left")],
        header=True,
    )
    for item in limits:
        table.add_row(item.name, _asked(item), _given(item) or "never: see below")
    if any(not math.isfinite(item.amount) for item in limits):
        table.add_section()
        for item in together:
            table.add_row(item.name, _asked(item), f"together: {_given(item) or 'dropped'}")
    return table


def _asked(item: Relaxed) -> str:
    return "must hold" if "<=" in item.name else f"{item.sense} {item.bound:g} {item.unit}"


def _given(item: Relaxed) -> str:
    if not math.isfinite(item.amount):
        return ""
    if "<=" in item.name:
        return f"missed by {item.amount:.4g} {item.unit}"
    return f"{item.sense} {item.relaxed:.6g} {item.unit} ({item.amount:.4g} {item.unit})"


def _optima(outcome: FunctionResult) -> RenderableType:
    """Show the statistics of a multistart search and its distinct optima."""
    free = outcome.problem.spec.free
    modes = len({optimum.assembly for optimum in outcome.optima}) > 1
    range_ = ", largest error over the whole range" if outcome.problem.spec.everywhere else ""
    parts: list[RenderableType] = []
    if outcome.evidence is not None:
        told = outcome.evidence
        hits = f"{told.hits} of {told.starts} random starts reached the best value, {told.optima} distinct values; {told.chance}"
        parts = [Text.assemble(("Multistart search", HEAD), f"\n{hits}"), Text()]
    columns = [("objective", "right"), *((name, "right") for name in free), *([("assembly", "left")] if modes else [])]
    table = grid(f"Distinct optima{range_}", [*columns, ("starts", "right")], header=True)
    for optimum in outcome.optima[:12]:
        values = [fixed(display_value(name, optimum.design[name])[0]) for name in free]
        mode = [optimum.assembly] if modes else []
        table.add_row(number(optimum.objective, 6 if modes else 8), *values, *mode, str(optimum.count))
    return Group(*parts, table)


def _backends(outcome: FunctionResult) -> Table:
    free = outcome.problem.spec.free
    columns = [("back end", "left"), ("status", "left"), ("objective", "right")]
    columns += [(name, "right") for name in free]
    table = grid("Back ends", [*columns, ("steps", "right"), ("KKT", "right")], header=True)
    for name, solution in outcome.backends.items():
        values = [fixed(display_value(key, solution.design[key])[0], 6 if len(free) < 3 else 3) for key in free]
        table.add_row(
            name,
            solution.status.value,
            number(solution.objective, 9 if len(free) < 3 else 6),
            *values,
            str(solution.iterations),
            f"{solution.kkt:.1e}",
        )
    return table


def _times(outcome: FunctionResult) -> Text:
    words = ", ".join(f"{name} {1e3 * seconds:.1f} ms" for name, seconds in outcome.seconds.items() if seconds > 0.0)
    head = f"{outcome.backend}, {outcome.solution.iterations} iterations; " if outcome.solution else ""
    return Text(head + words, style=QUIET)


def problem(file: ProblemFile) -> RenderableType:
    """List all settings of a problem: every key with its value or default, in units."""
    model = file.model
    parts: list[RenderableType] = [Text(model.title, style=HEAD)]
    if model.about:
        parts.append(Text(" ".join(model.about.split())))
    parts.append(Text(f"Source: {model.source or '-'}", style=QUIET))
    if isinstance(model.mechanism, FourBarSection):
        parts.append(_section("mechanism", model.mechanism))
    if isinstance(model, DesignProblem | PathProblem):
        over = {"transmission_over": model.transmission_over}
        task = holding(model) if isinstance(model, PathProblem) else None
        parts += [_section("requirement", model.requirement, task), _section("limits", model.limits, over)]
    if isinstance(model, CycleProblem):
        from optlink.report.views.cycle_tables import asked

        parts.append(asked(model))
    if not isinstance(model, DesignProblem | PathProblem) or model.bodies or model.loads:
        from optlink.report.views.analysis_tables import machine

        parts += machine(file)
    if model.tolerances:
        table = grid("\n[tolerances]", [("", "left"), ("", "left"), ("", "left")])
        for deviation, said in zip(model.deviations, model.tolerances.values(), strict=True):
            own = "" if said.shape or said.measured else f"default: {deviation.shape}"
            table.add_row(deviation.name, str(said), Text(own, style=QUIET))
        parts.append(table)
    if model.expected is not None:
        parts.append(_section("expected", model.expected, only_stated=True))
    return Group(*parts)


def holding(model: PathProblem) -> dict[str, str]:
    """Return the effective values of optional keys of a path or motion synthesis problem."""
    found = {"timing": model.timing, "measure": model.measure, "closed": str(model.closed).lower()}
    if model.requirement.kind == "motion":
        found["angle_length"] = f"{1e3 * model.radian:.6g} mm"
    else:
        found["angle_length"] = "none"
    added = {key: str(model.quantities[key]) for key in (START, MARK) if key in model.quantities}
    found["psi0"] = "none"
    if ZERO in model.quantities:
        added["zero" if model.slides else "psi0"] = str(model.quantities[ZERO])
    return found | added


def _section(name: str, section: Section, instead: Mapping[str, str] | None = None, *, only_stated: bool = False) -> Table:
    table = grid(f"\n[{name}]", [("", "left"), ("", "left"), ("", "left")])
    for key, field in type(section).model_fields.items():
        stated = key in section.model_fields_set
        if stated or not only_stated:
            text = (instead or {}).get(key) or _plain(key, getattr(section, key))
            table.add_row(field.alias or key, text, Text("" if stated else "default", style=QUIET))
    return table


ABSENT = {
    "psi0": "the rocker's own angle at the start",
    "span": "that of the table",
    "points": "its rows",
    "robust": "no",
    "pivot": "fixed: 0 mm, 0 mm",
    "direction": "fixed: 0 deg",
    "law": "none",
    "output": "none",
    "zero": "none",
    "start": "none",
    "mark": "none",
}
"""What holds where a key is left out that is no limit."""


def _plain(name: str, value: object) -> str:
    if value is None:
        return ABSENT.get(name, "no limit")
    if isinstance(value, Quantity | Interval | str | int | float):
        return str(value)
    if isinstance(value, dict):
        told = ((key, ", ".join(map(str, item)) if isinstance(item, tuple) else item) for key, item in value.items())
        return "\n".join(f"{key}  {item}" for key, item in told) or "none"
    text = getattr(value, "text", None)
    if text is not None:
        return str(text)
    phi, psi = getattr(value, "phi", ()), getattr(value, "psi", ())
    size, unit = (1e3, "mm") if getattr(value, "kind", "angle") == "coordinate" else (math.degrees(1.0), "deg")
    rows = (f"{np.degrees(a):g} deg -> {size * b:g} {unit}" for a, b in zip(phi, psi, strict=True))
    return "table: " + ", ".join(list(rows)[:8]) + (f", ... ({len(phi)} rows)" if len(phi) > 8 else "")


def listing(files: Iterable[ProblemFile]) -> Table:
    """List the shipped problems, one per row."""
    table = grid("Shipped problems", [("name", "left"), ("kind", "left"), ("what it is", "left")], header=True)
    for file in files:
        table.add_row(file.name, file.kind, file.model.title)
    return table


NARROWEST = 79
"""Columns that a table needs; a narrower terminal breaks its lines rather than lose digits."""


class _Console(Console):
    """Console that leaves a closed pipe to the command line, which sets the exit code."""

    def on_broken_pipe(self) -> None:
        """Re-raise the error."""
        raise  # noqa: PLE0704  (rich calls this while it handles the error)


def console(*, stderr: bool = False) -> Console:
    """Return a console that prints text verbatim, without markup or highlighting."""
    made = _Console(stderr=stderr, highlight=False, markup=False, emoji=False)
    made.width = max(made.width, NARROWEST)
    return made
