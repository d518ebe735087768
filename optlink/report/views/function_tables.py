"""Tables of a function synthesis result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from optlink.errors import Status
from optlink.optimization.objectives import MEASURES
from optlink.report.format import dimension, fixed, joined, number, price_step, times
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
from optlink.report.views.certificate_view import certificate_lines, certificate_table, certified
from optlink.report.views.short_text import dimensions, objective_line, short_text, verdict_lines
from optlink.solvers.contract import FOUND, LEAST_SQUARES
from optlink.solvers.solution import LimitState, Relaxation
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.certificate import Certificate
from optlink.tasks.results.conflict import OpposedLimit, opposed_limits, outward
from optlink.tasks.results.fit import Fit
from optlink.units import percent
from optlink.validation import Check

if TYPE_CHECKING:
    from optlink.problem.machine.model import Problem
    from optlink.tasks.results.cycle import CycleResult
    from optlink.tasks.results.design import SynthesisResult

    SearchedResult = SynthesisResult | CycleResult

MAX_OPTIMA, MAX_VARIABLES = 12, 6  # largest number of optima listed, and of their design variables
NEAREST_DESIGN = "Nearest design found (it does not meet the limits)"
RELAXED_NOTE = "; <=, >=: its improvement if the bound is relaxed by that much"


def result(outcome: SynthesisResult) -> Summary:
    """Summarise a function synthesis result: design, objective, active constraints, validation, optima, back ends."""
    from optlink.report.views.analysis_tables import machine_strokes

    best = outcome.best
    assert best is not None
    machine = turning_machine(best.problem, best.values)
    strokes = None if machine is None else machine_strokes(machine, best.rotation[1])
    objective = None if outcome.conflict else _objective(outcome)
    evidence, hits = outcome.evidence, ""
    if evidence is not None and not certified(outcome.certificate):
        different = f"{evidence.optima} distinct value{'s' * (evidence.optima > 1)}"
        reached = f"{evidence.hits} of {evidence.starts} random starts reached the best value, {different}"
        hits = f"{reached}; {evidence.chance}"
    measured = [] if objective is None else [objective_line(objective)]
    over = ", largest error over the whole range" * outcome.problem.spec.everywhere
    return search_summary(outcome, _design(outcome), (strokes, objective), measured, hits, over=over)


def search_summary(
    outcome: SearchedResult,
    design: TableSpec,
    tables: Iterable[Part | None],
    measured: Sequence[Line] = (),
    hits: str = "",
    tail: str = "",
    over: str = "",
) -> Summary:
    """Summarise the search of one design: its own tables, then those that every such search has.

    `measured` is the objective in the short text, `hits` the statistics of the starting points; `tail` is added to the verdict,
    `over` to the title of the distinct optima.
    """
    proof, solution, model = outcome.certificate, outcome.solution, outcome.problem.model
    priced = None
    opposed = conflict(outcome.conflict, outcome.together) if outcome.conflict else None
    if solution is not None and outcome.status != Status.INFEASIBLE:  # elsewhere multipliers are not prices
        priced = active(model, outcome.objective, solution.displayed_limits)
    proven = certificate_lines(proof) if certified(proof) else []
    counted = ["" if outcome.backend == "none" else outcome.backend]
    counted.append(f"{outcome.starts} start{'s' * (outcome.starts != 1)}" if outcome.starts else "")
    counted.append(f"{solution.iterations} iterations" if solution is not None and solution.iterations else "")
    effort = "; ".join(filter(None, [", ".join(filter(None, counted)), times(outcome.seconds, 1)]))
    verdict, checked = list(_verdict(outcome, tail)), checks(outcome.validation.checks)
    notes, ended = [*noted(outcome.notes)], proven if outcome.refuted else [quiet(_message(outcome))]
    evidence = [quiet(hits)] if hits and outcome.optima and outcome.status is Status.OPTIMAL else ended
    full = summary(
        model.title,
        [*verdict, *notes, *ended],
        design,
        *tables,
        opposed or priced,
        None if proof is None else certificate_table(proof, model.shown_objective, outcome.seconds),
        checked,
        Paragraph(strong("Multistart search"), hits, appendix=True) if hits and outcome.optima else None,
        _optima(outcome, over) if len(outcome.optima) > 1 or (outcome.optima and outcome.starts > 1) else None,
        backends(outcome) if len(outcome.backends) > 1 else None,
        Paragraph(quiet(effort), appendix=True),
    )
    unproven = [] if certified(proof) else certificate_lines(proof)
    status = [*verdict_lines(verdict), *notes, *measured, *evidence, *unproven]
    return replace(full, short=short_text(model.title, status, dimensions(design), priced, checked, opposed))


def _verdict(outcome: SearchedResult, tail: str) -> Iterator[Line]:
    yield from refuted_first(outcome)
    line = search_verdict(outcome.status, outcome.valid, outcome.certificate)
    yield from graded_status(line, outcome.fit if outcome.valid else None, tail)


def refuted_first(outcome: SearchedResult) -> Iterator[Line]:
    """Yield which limits exclude each other, the first line of the status of an infeasible problem."""
    if outcome.refuted:
        yield [bad(outcome.refuted)]


def _message(outcome: SearchedResult) -> str:
    text = outcome.message
    single = text == Status.OPTIMAL.text and outcome.starts == 1 and not outcome.exact
    return text + " (use --starts N for a multistart search)" * single


def search_verdict(status: Status, valid: bool, certificate: Certificate | None) -> list[Inline]:
    """Return how a search ended, and its verdict; an infeasible problem has one phrase for both.

    Without a closed certificate an optimum is a local one.
    """
    if status is Status.INFEASIBLE:
        return [bad("no feasible design" if certificate is not None and certificate.closed else "no feasible design found")]
    ended = "given design" if status is Status.NOT_SEARCHED else status.value
    if status is Status.OPTIMAL and (certificate is None or not certificate.proven):
        ended = "locally optimal"
    return [f"{ended}, ", verdict("valid" if valid else "not valid", valid)]


def graded_status(line: Sequence[Inline], fit: Fit | None, tail: str) -> Iterator[Line]:
    """Yield a line with the grade of a fit, if there is one, and a tail, then the likely reasons of a poor fit with remedies."""
    if fit is None:
        yield [*line, tail]
        return
    yield [*line, ", ", bad(fit.text) if fit.grade == "poor" else fit.text, tail]
    for reason in fit.reasons:
        yield f"{fit.text.partition(':')[0].capitalize()}, likely reason: {reason.reason}. Remedy: {reason.remedy}."


def _design(outcome: SynthesisResult) -> TableSpec:
    requirement = outcome.problem.spec.requirement
    default = "" if "start" in requirement.model_fields_set else ", the default start"
    derived = {"phi0": f"at the {outcome.problem.spec.dead_centre}{default}", "psi0": "the rocker angle there"}
    rows = dimension_rows(outcome.problem.spec, outcome.design, derived)
    rows.append(("assembly", outcome.assembly, "", quiet(f"joint C lies to the {outcome.assembly} of B -> D")))
    return table("Design" if not outcome.conflict else NEAREST_DESIGN, "<><<", rows)


def dimension_rows(
    model: Problem, values: Mapping[str, float], derived: Mapping[str, str], shown: Callable[[float], str] = dimension
) -> list[Row]:
    """Return the rows of a design [SI]: name, value, unit, and whether it is free, or the remark on a derived value."""
    rows: list[Row] = []
    for name, value in values.items():
        (factor, unit), quantity = model.display(name), model.quantities.get(name)
        remark = derived[name] if quantity is None else quantity.status
        if quantity is not None and quantity.low is not None:
            low, high = (bound * factor for bound in quantity.bounds)
            remark = f"{remark}, {low:g} ... {high:g}"
        free = quantity is not None and quantity.free
        rows.append((name, strong(shown(value * factor)) if free else shown(value * factor), unit, quiet(remark)))
    return rows


def _objective(outcome: SynthesisResult) -> TableSpec:
    best = outcome.best
    assert best is not None
    rms, largest = (math.degrees(MEASURES[name].of(best.errors())) for name in ("rms", "max"))
    robust = best.task.robust
    remark = f"error{'' if robust is None else ' at nominal dimensions'}: rms {number(rms, 4)}, largest {number(largest, 4)} deg"
    if best.largest_between is not None:
        remark += f" at the positions, {number(math.degrees(best.largest_between), 4)} deg between them"
    shown = outcome.problem.spec.shown_objective(outcome.objective)
    rows: list[Row] = [(best.measure, strong(number(shown.value)), shown.unit, quiet(remark))]
    if outcome.problem.spec.everywhere:
        remark = "times that the largest error occurs in the range, with alternating sign"
        rows.append(("alternations", str(best.alternations), "", quiet(remark)))
    if outcome.first_step is not None:
        from optlink.synthesis.function_starts import WIDER

        error, bound = (number(math.degrees(value), 4) for value in (outcome.first_step.error, outcome.first_step.bound))
        proof = f"; {bound} deg is a lower bound at its start angles" if outcome.first_step.proven else ""
        limited = outcome.problem.spec.limits.transmission_at() is not None
        relaxed = f"; searched with the transmission-angle limits relaxed by {math.degrees(WIDER):g} deg" * limited
        remark = f"a starting point, with its error at the design positions alone{relaxed}{proof}"
        rows.append(("convex first step", error, "deg", quiet(remark)))
    return table("Objective", "<><<", rows)


def active(model: Problem, objective: float, limits: Iterable[LimitState]) -> Part:
    """Tabulate the active constraints with their shadow prices, in the unit in which the model shows its objective.

    The price of an inequality is the improvement of the objective per step by which its bound alone is relaxed; that of an
    equality is the change of the objective, with its sign, per step by which its value is raised. A step is one unit, or 0.01 of
    a ratio.
    """
    (base, factor, unit, _), rows, raised = model.shown_objective(objective), [], False
    joint: dict[frozenset[str], tuple[float, set[str]]] = {}

    def share(gain: float) -> str:
        return f" ({percent(gain / base, 2)})" if 5e-5 * base <= gain < 100.0 * base else ""  # otherwise not informative

    for limit in (limit for limit in limits if limit.active):
        size, step = price_step(limit.unit)
        price = limit.multiplier * factor * size
        gain = abs(price)
        shown = f"{price:+.4g}" if limit.sense == "=" else f"{gain:.4g}"
        effect = f"{shown} {unit} per {step}{share(gain)}" if gain > 0 else "no effect"
        if math.isinf(gain):
            effect = "cannot be raised alone"
        raised |= limit.sense == "=" and gain > 0
        if limit.depends_on:
            effect = effect if gain > 0 else "no effect alone"
            together = frozenset((limit.name, *limit.depends_on))
            joint[together] = abs(limit.joint_gain * factor), joint.get(together, (0.0, set()))[1] | {limit.unit}
        rows.append((limit.name, f"{limit.sense} {limit.bound:g} {limit.unit}".rstrip(), effect))
    if not rows:
        return Paragraph(strong("Active constraints"), "none: only the requirement determines this design")
    note = f"=: change of the objective if the value is raised by that much{RELAXED_NOTE * (len(rows) > 1)}"
    notes = [quiet(note)] if raised else []
    for names, (gain, units) in joint.items():
        words = joined([name for name, *_ in rows if name in names])
        size, step = price_step("") if units == {""} else (1.0, "one unit")
        effect = f"the objective improves by {size * gain:.4g} {unit}{share(size * gain)} if each is relaxed by {step}"
        notes.append(quiet(f"{words} hold together: {effect}"))
    return table("Active constraints and their shadow prices", "<<<", rows, notes=notes)


def checks(selected: Sequence[Check], gathered: Sequence[Check] = ()) -> TableSpec:
    """Tabulate the checks of a validation; passed bounds of dimensions (`gathered`) share one row."""
    rows: list[Row] = [
        (verdict("ok" if item.passed else "FAIL", item.passed), item.name, number(item.value), quiet(item.unit), item.limit)
        for item in selected
        if item not in gathered
    ]
    if gathered:
        rows.append((good("ok"), f"{len(gathered)} dimensions within bounds", "all", "", ""))
    title = f"Validation: {sum(check.passed for check in selected)} of {len(selected)} checks passed"
    return table(title, ["", "check", ">value", "", "limit"], rows, appendix=True)


def _optima(outcome: SearchedResult, over: str) -> TableSpec:
    """Tabulate the distinct optima of a multistart search."""
    model, listed = outcome.problem.model, outcome.optima[:MAX_OPTIMA]
    free, modes = list(model.free)[:MAX_VARIABLES], len({optimum.assembly for optimum in outcome.optima}) > 1
    rows, (scale, unit) = [], model.objective_display
    for optimum in listed:
        values = [dimension(optimum.design[name] * model.display(name)[0]) for name in free]
        mode = [optimum.assembly] if modes else []
        rows.append((number(scale * optimum.objective, 6 if modes else 8), *values, *mode, str(optimum.count)))
    left = outcome.starts - sum(optimum.count for optimum in listed)  # negative: searches of several back ends
    columns = [
        f">objective [{unit}]" if unit else ">objective",
        *(f">{name} [{model.display(name)[1]}]" for name in free),
        *(["assembly"] if modes else []),
        ">starts" if left >= 0 else ">searches",
    ]
    others = f"; {left} of them ended at worse optima that are not listed, or at none" if left > 0 else ""
    note = f"starts: of all {outcome.starts} starting points, random and given{others}"
    notes = [quiet(note)] if outcome.starts > 1 and left >= 0 else []
    return table(f"Distinct optima{over}", columns, rows, appendix=True, notes=notes)


def backends(outcome: SearchedResult) -> TableSpec:
    """Tabulate the solutions of the back ends side by side."""
    model, solutions = outcome.problem.model, outcome.backends.values()
    shown = [model.shown_objective(solution.objective) for solution in solutions]
    rows = [("status", *(solution.status.value for solution in solutions), "")]
    rows.append(("objective", *(number(objective.value, 9) for objective in shown), shown[0].unit))
    for name in model.free:
        factor, unit = model.display(name)
        rows.append((name, *(fixed(solution.design[name] * factor, 5) for solution in solutions), unit))
    methods = [LEAST_SQUARES if solution.message == FOUND else name for name, solution in outcome.backends.items()]
    if LEAST_SQUARES in methods:
        rows.append(("found by", *methods, ""))
    rows.append(("steps", *(str(solution.iterations) for solution in solutions), ""))
    rows.append(("KKT residual", *(f"{solution.kkt:.1e}" for solution in solutions), ""))
    return table("Back ends", ["", *(f">{name}" for name in outcome.backends), ""], rows, appendix=True)


# --- conflicting limits -------------------------------------------------------------------------------------------------------


def conflict(limits: Sequence[Relaxation], together: Sequence[Relaxation]) -> TableSpec:
    """Tabulate conflicting limits with the relaxation that each would need alone, infinite where that does not suffice.

    Limits relaxed together are shown in that case.
    """
    opposed = opposed_limits(limits)
    rows = [(limit.name, _limit(limit), _relaxed(limit) or "not by this limit alone") for limit in opposed]
    single = len(rows)
    if not all(limit.satisfiable for limit in opposed):
        shared = opposed_limits(together)
        rows += [(limit.name, _limit(limit), f"together: {_relaxed(limit) or 'dropped'}") for limit in shared]
    columns = ["limit", "limit value", "feasible if relaxed alone"]
    return table("Conflicting limits", columns, rows, sections=[single], notes=_exact_values(opposed))


def _exact_values(limits: Sequence[OpposedLimit]) -> list[str]:
    """Return how to state a least or a greatest value, for each limit whose two sides are the same."""
    values = [(limit.name, _value(limit.sides[0])) for limit in limits if limit.exact]
    return [f'A single value is exact: write ">= {x}" for the smallest or "<= {x}" for the largest {name}.' for name, x in values]


def _value(side: Relaxation) -> str:
    return f"{side.bound:g} {side.unit}".rstrip()


def _limit(limit: OpposedLimit) -> str:
    if "<=" in limit.name:
        return "must hold"
    if limit.exact:
        return f"exactly {_value(limit.sides[0])}"
    return _stated(limit.sides, lambda side: f"{side.bound:g}")


def _relaxed(limit: OpposedLimit) -> str:
    if not limit.satisfiable:
        return ""
    sides = limit.sides
    amounts = dict.fromkeys(f"{side.amount:.4g} {side.unit}".rstrip() for side in sides)
    amount = f"{' and '.join(amounts)}{' each' * (len(amounts) < len(sides))}"
    if "<=" in limit.name:
        return f"missed by {amount}"
    return f"{_stated(sides, lambda side: f'{outward(side, 6):.6g}', 'about ' * sides[0].approximate)} ({amount})"


def _stated(sides: tuple[Relaxation, ...], value: Callable[[Relaxation], str], before: str = "") -> str:
    """Return a limit as sense and value, or a range as its two values, with the unit."""
    sense = f"{sides[0].sense} " if len(sides) == 1 else ""
    return f"{sense}{before}{' ... '.join(value(side) for side in sides)} {sides[0].unit}".rstrip()
