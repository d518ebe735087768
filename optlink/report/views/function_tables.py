"""Tables of a function synthesis result, of a problem file, and of the check of a certificate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from optlink.errors import Status
from optlink.optimization.objectives import MEASURES
from optlink.problem.base_model import Section
from optlink.problem.file import ProblemFile
from optlink.problem.function import DesignProblem
from optlink.problem.interval import Interval
from optlink.problem.mechanism import FourBarSection
from optlink.problem.quantity import Quantity
from optlink.problem.targets.target_points import TargetPoints
from optlink.report.format import dimension, fixed, number, times
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
from optlink.report.views.certificate_view import certificate_table, certified
from optlink.report.views.relaxations import conflict
from optlink.solvers.solution import LimitState
from optlink.tasks.function import FunctionResult, display_value
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.certificate import Certificate, message, share_text
from optlink.tasks.results.fit import Fit
from optlink.validation import Check

if TYPE_CHECKING:
    from optlink.problem.path import PathProblem
    from optlink.validation.certificate import CertificateCheck

MOST = 8  # largest number of points listed
RELAXED = "; <=, >=: its improvement if the bound is relaxed by one unit"


def result(outcome: FunctionResult) -> Summary:
    """Summarise a function synthesis result: design, objective, active constraints, validation, optima, back ends."""
    from optlink.report.views.analysis_tables import machine_strokes

    machine = turning_machine(outcome.problem, outcome.design)
    parts: list[Part | None] = [_design(outcome)]
    parts.append(None if machine is None else machine_strokes(machine, outcome.problem.spec.span))
    if outcome.conflict:
        parts.append(conflict(outcome.conflict, outcome.together))
    else:
        parts.append(_objective(outcome))
        if outcome.solution:
            parts.append(active(outcome.solution.limits, outcome.objective, outcome.unit))
        parts.append(checks(outcome.validation.checks))
    if outcome.certificate is not None:
        parts.insert(
            len(parts) - (not outcome.conflict), certificate_table(outcome.certificate, 1.0, outcome.unit, outcome.seconds)
        )
    if outcome.optima and (len(outcome.optima) > 1 or outcome.starts > 1):
        parts += _optima(outcome)
    if outcome.backends:
        parts.append(_backends(outcome))
    iterations = outcome.solution.iterations if outcome.solution else 0  # none of a stored result
    effort = (f"{outcome.backend}, {iterations} iterations; " if iterations else "") + times(outcome.seconds, 1)
    if effort:
        parts.append(Paragraph(quiet(effort), appendix=True))
    return summary(outcome.problem.spec.title, _status(outcome), *parts)


def _status(outcome: FunctionResult) -> Iterator[Line]:
    word = "valid" if outcome.valid else "not valid"
    if outcome.status not in (Status.OPTIMAL, Status.NOT_SEARCHED):
        word = "no design"
    line = search_verdict(outcome.status, word, outcome.valid, outcome.certificate)
    yield from graded(line, outcome.fit if outcome.valid else None)
    yield from noted(outcome.notes)
    yield ending(outcome.status, outcome.starts, outcome.certificate)


def ending(status: Status, starts: int, certificate: Certificate | None = None) -> Line:
    """Describe how a search ended; an uncertified optimum of one starting point with the option that searches from several.

    Parameters
    ----------
    status : Status
    starts : int
        Starting points of the search.
    certificate : Certificate, optional
    """
    text = message(status, certificate)
    return quiet(text + " (use --starts N for a multistart search)" * (text == Status.OPTIMAL.text and starts == 1))


def search_verdict(status: Status, word: str, positive: bool, certificate: Certificate | None = None) -> list[Inline]:
    """Return how a search ended, and its verdict; an infeasible problem has one phrase for both.

    Parameters
    ----------
    status : Status
    word : str
        The verdict.
    positive : bool
    certificate : Certificate, optional
        Without a closed one an optimum is a local one.
    """
    if status is Status.INFEASIBLE:
        return [bad("no feasible design" if certificate is not None and certificate.closed else "no feasible design found")]
    ended = "given design" if status is Status.NOT_SEARCHED else status.value
    if status is Status.OPTIMAL and (certificate is None or not certificate.proven):
        ended = "locally optimal"
    return [f"{ended}, ", verdict(word, positive)]


def graded(line: Sequence[Inline], fit: Fit | None, tail: str = "") -> Iterator[Line]:
    """Yield a line with the grade of a fit and a tail, then the likely reasons of a poor fit with remedies.

    Parameters
    ----------
    line : sequence of str or Span
    fit : Fit or None
        None appends the tail only.
    tail : str, optional
    """
    if fit is None:
        yield [*line, tail]
        return
    yield [*line, ", ", bad(fit.text) if fit.grade == "poor" else fit.text, tail]
    for each in fit.reasons:
        yield f"{fit.text.partition(':')[0].capitalize()}, likely reason: {each.reason}. Remedy: {each.remedy}."


def _design(outcome: FunctionResult) -> TableSpec:
    problem, rows = outcome.problem.spec, []
    for name, value in outcome.design.items():
        shown, unit = display_value(name, value)
        quantity = problem.quantities.get(name)
        if quantity is None:
            where = str(problem.requirement.start) if name == "phi0" else "the rocker's own angle there"
            remark = where if name == "psi0" else f"at the {where}"
        else:
            low, high = (display_value(name, bound)[0] for bound in quantity.bounds)
            remark = f"free, {low:g} ... {high:g}" if quantity.free else "fixed"
        free = quantity is not None and quantity.free
        rows.append((name, strong(dimension(shown)) if free else dimension(shown), unit, quiet(remark)))
    rows.append(("assembly", outcome.assembly, "", quiet(f"joint C lies to the {outcome.assembly} of B -> D")))
    return table("Design" if not outcome.conflict else "Nearest design found (it does not meet the limits)", "<><<", rows)


def _objective(outcome: FunctionResult) -> TableSpec:
    rms, largest = (math.degrees(MEASURES[name].of(outcome.error())) for name in ("rms", "max"))
    robust = outcome.problem.spec.requirement.robust
    remark = f"error{'' if robust is None else ' at nominal dimensions'}: rms {number(rms, 4)}, largest {number(largest, 4)} deg"
    rows: list[Row] = [(outcome.measure, strong(number(outcome.objective)), outcome.unit, quiet(remark))]
    in_degrees = ("", strong(number(math.degrees(outcome.objective))), "deg")
    if robust is not None and outcome.unit == "rad":
        rows.append((*in_degrees, quiet("objective of the linkage with its tolerances")))
    if outcome.problem.spec.everywhere:
        remark = f"the largest error occurs {outcome.alternations} times in the range, with alternating sign"
        rows.append((*in_degrees, quiet(remark)))
    if outcome.first is not None:
        from optlink.synthesis.function_starts import WIDER

        error, bound = (number(math.degrees(value), 4) for value in (outcome.first.error, outcome.first.bound))
        proof = f"; {bound} deg is a lower bound at its start angles" if outcome.first.proven else ""
        limited = outcome.problem.spec.limits.transmission_at() is not None
        relaxed = f"; searched with the transmission-angle limits relaxed by {math.degrees(WIDER):g} deg" * limited
        remark = f"a starting point, with its error at the design positions alone{relaxed}{proof}"
        rows.append(("convex first step", error, "deg", quiet(remark)))
    return table("Objective", "<><<", rows)


def active(limits: Iterable[LimitState], objective: float, unit: str) -> Part:
    """Tabulate the active constraints with their shadow prices.

    The price of an inequality is the improvement of the objective per unit by which its bound is relaxed; that of an equality
    is the change of the objective, with its sign, per unit by which its value is raised.

    Parameters
    ----------
    limits : iterable of LimitState
        All constraints; inactive ones are left out.
    objective : float
        Value of the objective, for relative prices.
    unit : str
        Unit of the objective.
    """
    rows, raised = [], False
    for limit in (limit for limit in limits if limit.active):
        gain = abs(limit.multiplier)
        share = f" ({gain / objective:z.2%})" if 5e-5 * objective <= gain < 100.0 * objective else ""  # otherwise not informative
        price = f"{limit.multiplier:+.4g}" if limit.sense == "=" else f"{gain:.4g}"
        buys = f"{price} {unit} per {limit.unit or 'unit'}{share}" if gain > 0 else "no effect"
        raised |= limit.sense == "=" and gain > 0
        rows.append((limit.name, f"{limit.sense} {limit.bound:g} {limit.unit}".rstrip(), buys))
    if not rows:
        return Paragraph(strong("Active constraints"), "none: only the requirement determines this design")
    notes = [quiet(f"=: change of the objective if the value is raised by one unit{RELAXED * (len(rows) > 1)}")] if raised else []
    return table("Active constraints and their shadow prices", "<<<", rows, notes=notes)


def checks(selected: Sequence[Check], gathered: Sequence[Check] = ()) -> TableSpec:
    """Tabulate the checks of a validation.

    Parameters
    ----------
    selected : sequence of Check
    gathered : sequence of Check, optional
        Passed bounds of dimensions that share one row.
    """
    rows: list[Row] = [
        (verdict("ok" if one.passed else "FAIL", one.passed), one.name, number(one.value), quiet(one.unit), one.limit)
        for one in selected
        if one not in gathered
    ]
    if gathered:
        rows.append((good("ok"), f"{len(gathered)} dimensions within bounds", "all", "", ""))
    title = f"Validation: {sum(check.passed for check in selected)} of {len(selected)} checks passed"
    return table(title, ["", "check", ">value", "", "limit"], rows, appendix=True)


def _optima(outcome: FunctionResult) -> Iterator[Part]:
    """Yield the statistics of a multistart search and its distinct optima."""
    free = outcome.problem.spec.free
    modes = len({optimum.assembly for optimum in outcome.optima}) > 1
    found = outcome.evidence
    if found is not None and not certified(outcome.certificate):
        different = f"{found.optima} distinct value{'s' * (found.optima > 1)}"
        hits = f"{found.hits} of {found.starts} random starts reached the best value, {different}"
        yield Paragraph(strong("Multistart search"), f"{hits}; {found.chance}", appendix=True)
    rows = []
    for optimum in outcome.optima[:12]:
        values = [dimension(display_value(name, optimum.design[name])[0]) for name in free]
        mode = [optimum.assembly] if modes else []
        rows.append((number(optimum.objective, 6 if modes else 8), *values, *mode, str(optimum.count)))
    range_ = ", largest error over the whole range" if outcome.problem.spec.everywhere else ""
    columns = [">objective", *(f">{name}" for name in free), *(["assembly"] if modes else []), ">starts"]
    listed = sum(optimum.count for optimum in outcome.optima[:12])
    others = f"; {outcome.starts - listed} of them ended at worse optima that are not listed, or at none"
    counted = f"starts: of all {outcome.starts} starting points, random and given{others if listed < outcome.starts else ''}"
    notes = [quiet(counted)] if outcome.starts > 1 else []
    yield table(f"Distinct optima{range_}", columns, rows, appendix=True, notes=notes)


def _backends(outcome: FunctionResult) -> TableSpec:
    free = outcome.problem.spec.free
    few, rows = len(free) < 3, []
    for name, solution in outcome.backends.items():
        values = [fixed(display_value(key, solution.design[key])[0], 6 if few else 3) for key in free]
        shown = number(solution.objective, 9 if few else 6)
        rows.append((name, solution.status.value, shown, *values, str(solution.iterations), f"{solution.kkt:.1e}"))
    columns = ["back end", "status", ">objective", *(f">{name}" for name in free), ">steps", ">KKT"]
    return table("Back ends", columns, rows, appendix=True)


def problem(file: ProblemFile) -> Summary:
    """List all settings of a problem: every key with its value or default, in units."""
    from optlink.problem.cycle.model import CycleProblem
    from optlink.problem.path import PathProblem

    model = file.model
    about = [" ".join(model.about.split())] if model.about else []
    parts: list[Part] = []
    if isinstance(model.mechanism, FourBarSection):
        parts.append(_section("mechanism", model.mechanism))
    if isinstance(model, DesignProblem | PathProblem):
        over = {"transmission_over": model.limits.transmission_range}
        task = holding(model) if isinstance(model, PathProblem) else None
        parts += [_section("requirement", model.requirement, task), _section("limits", model.limits, over)]
    if isinstance(model, CycleProblem):
        from optlink.report.views.cycle_tables import cycle_problem

        parts.append(cycle_problem(model))
    if not isinstance(model, DesignProblem | PathProblem) or model.bodies or model.loads:
        from optlink.report.views.analysis_tables import machine

        parts += machine(file)
    if model.tolerances:
        rows = []
        for deviation, said in zip(model.deviations, model.tolerances.values(), strict=True):
            default = "" if said.shape or said.measured else f"default: {deviation.shape}"
            rows.append((deviation.name, str(said), quiet(default)))
        parts.append(table("[tolerances]", "<<<", rows))
    if model.report.model_fields_set:
        parts.append(_section("report", model.report, only_stated=True))
    if model.expected is not None:
        parts.append(_section("expected", model.expected, only_stated=True))
    return summary(model.title, [*about, quiet(f"Source: {model.source or '-'}")], *parts)


def holding(model: PathProblem) -> dict[str, str]:
    """Return the effective values of optional keys of a path or motion synthesis problem."""
    from optlink.problem.path import MARK, START, ZERO

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


def _section(name: str, section: Section, instead: Mapping[str, str] | None = None, *, only_stated: bool = False) -> TableSpec:
    rows = []
    for key, field in type(section).model_fields.items():
        stated = key in section.model_fields_set
        if stated or not only_stated:
            text = (instead or {}).get(key) or _plain(key, getattr(section, key))
            rows.append((field.alias or key, text, quiet("" if stated else "default")))
    return table(f"[{name}]", "<<<", rows)


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
"""Defaults of the keys that are not limits."""


def _plain(name: str, value: object) -> str:
    if value is None:
        return ABSENT.get(name, "no limit")
    if isinstance(value, Quantity | Interval | str | int | float):
        return str(value)
    if isinstance(value, dict):
        written = ((key, ", ".join(map(str, item)) if isinstance(item, tuple) else item) for key, item in value.items())
        return "\n".join(f"{key}  {item}" for key, item in written) or "none"
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    if isinstance(value, TargetPoints):
        return _listed(value)
    text = getattr(value, "text", None)
    if text is not None:
        return str(text)
    phi, psi = getattr(value, "phi", ()), getattr(value, "psi", ())
    size, unit = (1e3, "mm") if getattr(value, "kind", "angle") == "coordinate" else (math.degrees(1.0), "deg")
    rows = (f"{np.degrees(a):g} deg -> {size * b:g} {unit}" for a, b in zip(phi, psi, strict=True))
    return "table: " + ", ".join(list(rows)[:MOST]) + (f", ... ({len(phi)} rows)" if len(phi) > MOST else "")


def _listed(targets: TargetPoints) -> str:
    """List the first points or poses."""
    angles = targets.angles or (None,) * len(targets.points)
    written = (
        f"({1e3 * x:.6g}, {1e3 * y:.6g})" + ("" if angle is None else f" at {math.degrees(angle):.6g} deg")
        for (x, y), angle in zip(targets.points, angles, strict=True)
    )
    count, what = len(targets.points), "poses" if targets.angles else "points"
    return f"{count} {what} [mm]: {', '.join(list(written)[:MOST])}{', ...' if count > MOST else ''}"


def listing(files: Iterable[ProblemFile]) -> TableSpec:
    """List the shipped problems, one per row."""
    return table("Shipped problems", ["name", "description"], ((one.name, f"{one.model.title} ({one.kind})") for one in files))


def certificate_check(found: CertificateCheck) -> Summary:
    """Summarise the check of a certificate: the verdict, and every check."""
    if not found.valid:
        failed = next(check for check in found.checks if not check.passed)
        verdict = bad(f"certificate does not hold: {failed.name}")
    elif math.isfinite(found.objective):
        verdict = good(f"certificate holds: no design is better by more than {share_text(found.gap)}")
    else:
        verdict = good("certificate holds: no design within the bounds meets all limits")
    bounded = f"{found.pieces:,} parts of {found.boxes:,} boxes bounded in ball arithmetic"
    status: list[Line] = [verdict, bounded]
    if math.isfinite(found.objective):
        status.append(f"objective {number(found.objective, 9)}, lower bound {number(found.lower_bound, 9)} (SI)")
    return summary(found.problem.model.title, status, checks(found.checks))
