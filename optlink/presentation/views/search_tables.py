"""Tables that every search of a design has: verdict, limits with their prices, checks, conflicting limits, solvers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import ROUND_FLOOR, Context
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.errors import Status
from optlink.presentation.chart_spec import Axis, Boxes, ChartSpec, Curve, Mark, Panel
from optlink.presentation.format import (
    comparable,
    dimension,
    fixed,
    joined,
    number,
    pretty,
    price_step,
    significant,
    times,
)
from optlink.presentation.table_spec import (
    Inline,
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
    verdict,
)
from optlink.problem.machine.model import ShownObjective
from optlink.solvers.contract import METHODS
from optlink.solvers.solution import LimitState, Relaxation
from optlink.tasks.results.certificate import MOST_DRAWN, Certificate, Cover, share_text, verdict_words
from optlink.tasks.results.common import Evidence
from optlink.tasks.results.conflict import OpposedLimit, opposed_limits, outward
from optlink.tasks.results.exact import BY_TRANSMISSION, DEFECTS
from optlink.tasks.results.fit import Fit
from optlink.tasks.results.rounding import Influence, Rounding
from optlink.units import DISPLAYED, count_noun, percent
from optlink.validation import Check
from optlink.validation.check import requirements

if TYPE_CHECKING:
    from optlink.problem.machine.model import Problem
    from optlink.problem.quantity import Quantity
    from optlink.tasks.results.design import SynthesisResult


# Short text of a design, which `solve` prints: verdict, objective, proof, design and what limits it; all else is a detail.

LINES = 25
"""Lines that the short text of a valid design has at most, 80 characters wide."""
MAX_DIMENSIONS = 8  # rows of a design; a longer one is written as text
MAX_LIMITS = 4  # rows of the active limits
EXACT, NARROW = 1e-4, 1e-2  # margins of a limit, relative to bound and range, up to which a design that meets it is at it
SENSES = ("minimised", "maximised")  # remarks on what is optimised beside other demands
DETAILS = "--details shows the rest"


def short_text(
    title: str,
    status: Iterable[Line],
    design: Part,
    limits: Part | None,
    checks: TableSpec | None = None,
    conflict: TableSpec | None = None,
) -> Summary:
    """Return the short text of a design: verdict, objective, proof, dimensions, and active limits with failed checks.

    Conflicting limits take the place of these two.
    """
    return summary(title, status, design, conflict or first_rows(limits), _failed(None if conflict else checks))


def verdict_lines(lines: Sequence[Line]) -> list[Line]:
    """Return a verdict with the first one of the reasons that follow it."""
    if len(lines) <= 2:
        return list(lines)
    reason = [lines[1]] if isinstance(lines[1], str | Span) else list(lines[1])
    return [lines[0], [*reason, quiet(f" {len(lines) - 2} more: --details")]]


def objective_line(objective: TableSpec) -> Line:
    """Return a table of the objective as one line: name, value, unit and the remark on the first row.

    Of several demands the line begins with what is minimised or maximised. Rows without a name are the same value in other units.
    """
    first, *others = objective.rows
    sense = first[3].text if first[3].text in SENSES else ""
    pieces = [Span(f"{sense or 'objective'}: {first[0].text} "), first[1], Span(f" {first[2].text}".rstrip())]
    for _, value, unit, _ in (row for row in others if not row[0].text):
        pieces += [Span(" = "), value, Span(f" {unit.text}")]
    if first[3].text and not sense:
        pieces.append(replace(first[3], text=f" ({first[3].text})"))
    for name, value, unit, _ in (row for row in others if row[0].text):
        pieces += [Span(f"; {name.text} "), value, Span(f" {unit.text}".rstrip())]
    return pieces


def dimensions(design: TableSpec) -> Part:
    """Return a design as a table without a heading, or as text where it has many dimensions."""
    if len(design.rows) <= MAX_DIMENSIONS:
        return table(design.title, "<><", [row[:3] for row in design.rows]) if design.header else design
    pieces: list[Span] = []
    for name, value, unit, *_ in design.rows:
        pieces += [Span(f"{', ' if pieces else ''}{name.text} "), value, Span(f" {unit.text}".rstrip())]
    return Paragraph(strong(design.title), pieces)


def first_rows(limits: Part | None) -> Part | None:
    """Return the table of active limits with its first rows."""
    if limits is None or isinstance(limits, Paragraph) or len(limits.rows) <= MAX_LIMITS:
        return limits
    left = len(limits.rows) - MAX_LIMITS + 1
    return replace(limits, rows=limits.rows[: MAX_LIMITS - 1], notes=(quiet(f"and {left} more: --details"),), sections=())


def _failed(checks: TableSpec | None) -> Part:
    """Return how many checks are passed, and the failed ones."""
    if checks is None:
        return Paragraph(quiet(DETAILS))
    failed = tuple(row for row in checks.rows if row[0].role == "bad")
    if failed:
        return replace(checks, rows=failed, notes=(quiet(DETAILS),))
    return Paragraph([f"{checks.title}; ", quiet(DETAILS)])


# Table, clauses and charts for the certificate of a global optimum, the same for every kind of result.

ROUNDING_NOTE = "no design within the bounds has a smaller one; rounding errors are included"
Shown = Callable[[float], ShownObjective]
"""Returns an objective [SI] in its display unit."""
CONTINUE = "to continue the proof: --certify with a longer --time-limit or a larger --gap"


def certificate_table(certificate: Certificate, shown: Shown, seconds: Mapping[str, float]) -> TableSpec:
    """Tabulate a certificate: best design and lower bound, gap, effort, finding, and how to continue a proof that is not closed.

    `shown` returns an objective [SI] in its display unit; `seconds` is the wall time per stage.
    """
    rows: list[Row] = []
    objective, bound = certificate.objective, certificate.lower_bound
    digits = min(14, max(6, 2 - math.floor(math.log10(certificate.gap)))) if 0.0 < certificate.gap < 1.0 else 6
    value, unit, name = shown(objective).value, *shown(objective if math.isfinite(objective) else bound)[2:]
    if math.isfinite(objective):
        rows.append(("best design", strong(f"{value:.{digits}g}"), unit, quiet(name * (name != "objective"))))
    if math.isfinite(bound):
        rows.append(("lower bound", strong(rounded_down(shown(bound).value, digits)), unit, quiet(ROUNDING_NOTE)))
    if math.isfinite(objective) and not certificate.exact:
        required = "" if certificate.proven else f", {share_text(certificate.asked)} was required"
        rows.append(("gap", share_text(certificate.gap), "", quiet(f"largest share by which a design could be better{required}")))
    left = f", {certificate.open_boxes:,} of them left" if certificate.open_boxes else ""
    if certificate.boxes:
        rows.append(("boxes", f"{certificate.boxes:,}", "", quiet(f"parts of the bounds that were examined{left}")))
    if "certify" in seconds:
        rows.append(("time", f"{seconds['certify']:.3g}", "s", ""))
    notes = [certificate.text]
    if certificate.improved:
        notes.append("the design is better than that of the local search: the proof found it")
    if not certificate.closed:
        notes.append(CONTINUE)
    return table("Global optimum", "<><<", rows, notes=[quiet(note) for note in notes], exact=True)


def rounded_down(value: float, digits: int) -> str:
    """Format a lower bound with significant digits that do not exceed it."""
    return f"{float(Context(digits, ROUND_FLOOR).create_decimal_from_float(value)):.{digits}g}"


def certified(certificate: Certificate | None) -> bool:
    """Return whether a certificate takes the place of statistical evidence: its search came to an end."""
    return certificate is not None and certificate.closed


def certificate_lines(certificate: Certificate | None) -> list[Line]:
    """Return the line of a status; none without a certificate."""
    return [] if certificate is None else [quiet(certificate.text)]


def clause(certificate: Certificate | None) -> str:
    """Return the sentence of a conclusion; an empty text if nothing is proven."""
    if certificate is None or not certificate.closed:
        return ""
    if not certificate.proven:
        return "It is proven that no design within the bounds meets all limits."
    if certificate.exact:
        return "No design can be better."
    return f"It is proven that no design within the bounds is better by more than {share_text(certificate.gap)}."


# --- charts ------------------------------------------------------------------------------------------------------------------

Design = Mapping[str, float]
Display = Callable[[str], tuple[float, str]]
"""Returns factor and display unit of a design variable."""
MIN_BOXES = 256  # boxes up to which the bounds are not drawn: about one batch of the search
SCHEME = {
    "limits": ("limit violated", "#c0392b"),
    "objective": ("objective too large", "#2c6fbb"),
    "Lagrangian": ("Lagrangian too large", "#2e8b57"),
    "cut": ("cut off", "#d07d00"),
}
"""Name and colour of the boxes that each test discards."""


def certificate_charts(
    certificate: Certificate | None, title: str, shown: Shown, design: Design, assembly: Any, display: Display
) -> list[ChartSpec]:
    """Return the boxes of two design variables, and the bounds of the objective against the number of boxes.

    `design` [SI] and `assembly`, its mode in the words of the file, are those of the best design, empty if there is none; `shown`
    returns an objective [SI] in its display unit, `display` factor and unit of a design variable.
    """
    if certificate is None:
        return []
    charts = []
    if len(certificate.unknowns) == 2 and 0 < sum(len(cover.test) for cover in certificate.covers) <= MOST_DRAWN:
        for k, cover in enumerate(certificate.covers):
            at = design if certificate.proven and str(cover.assembly) == str(assembly) else {}
            mode = f", assembly {cover.assembly}" if len(certificate.covers) > 1 else ""
            charts.append(replace(_boxes(cover, certificate.unknowns, title, mode, at, display), remark=certificate.text, row=k))
    if certificate.boxes > MIN_BOXES and np.isfinite(certificate.history[-1:, 2]).any():
        charts.append(_bounds(certificate, title, shown))
    return charts


def _boxes(cover: Cover, unknowns: Sequence[str], about: str, mode: str, design: Design, display: Display) -> ChartSpec:
    """Return the boxes of one assembly mode, coloured by the tests that discarded them."""
    scales = [display(name) for name in unknowns]
    factors = np.array([factor for factor, _ in scales])
    low, high = cover.low * factors, cover.high * factors
    x, y = (np.stack([low[:, k], high[:, k]], axis=1) for k in range(2))
    traces = []
    for k, (key, (name, colour)) in enumerate(SCHEME.items()):
        chosen = cover.test == k
        if chosen.any():
            traces.append(Boxes(x[chosen], y[chosen], f"{name} ({int(chosen.sum())})", colour, gid=f"boxes {key}"))
    marks = []
    if design:
        at_x, at_y = (design[name] * factor for name, factor in zip(unknowns, factors, strict=True))
        marks.append(Mark(at_x, at_y, "design", "#111111", "star", 11.0, prefer=(1.0, 1.0), gid="design"))
    axes = [
        Axis(f"{name} [{unit}]", (float(ends.min()), float(ends.max())))
        for name, (_, unit), ends in zip(unknowns, scales, (x, y), strict=True)
    ]
    panel = Panel(axes[1], traces, 2.1, marks=marks)
    title = f"Global search: boxes of designs and the test that discarded each{mode}"
    return ChartSpec("boxes", title, [panel], axes[0], f"{about}: boxes of the global search", cursor=False)


def _bounds(certificate: Certificate, title: str, shown: Shown) -> ChartSpec:
    """Return the lower bound and the best known objective as steps over the number of boxes."""
    boxes, lower, best = certificate.history.T
    steps = np.repeat(boxes, 2)[1:]
    curves = [
        Curve(steps, np.repeat([shown(value).value for value in values.tolist()], 2)[:-1], name, colour, 1.8, gid=name)
        for values, name, colour in ((best, "best known design", "#2e8b57"), (lower, "lower bound", "#2c6fbb"))
    ]
    unit = pretty(shown(certificate.objective).unit)
    axis = Axis(f"objective [{unit}]" if unit else "objective")
    x = Axis("boxes examined", (boxes[0], boxes[-1]), "log")
    name, heading = "Global search: bounds of the objective", f"{title}: bounds of the objective"
    return ChartSpec("bounds", name, [Panel(axis, curves, 1.4)], x, heading, certificate.text, cursor=False)


MAX_OPTIMA, MAX_VARIABLES, MOST_EXACT = 12, 6, 24  # largest numbers of optima, their design variables, and exact solutions listed
MOST_REASONS = 2  # of one of them
NEAREST_DESIGN = "Nearest design found (it does not meet the limits)"
BOUNDED = " within its bounds"  # end of the names of the checks of bounds
RELAXED_NOTE = "; <=, >=: its improvement if the bound is relaxed by that much"


def search_summary(
    outcome: SynthesisResult,
    design: TableSpec,
    figures: TableSpec | None,
    tables: Iterable[Part | None],
    others: Iterable[Part | None] = (),
    *,
    evidence: Evidence | None = None,
    tail: str = "",
) -> Summary:
    """Summarise a search by its best design: dimensions, `figures`, further tables of it, limits with prices, proof, checks.

    `others` are tables of other designs, `evidence` is that of the starts; `tail` is added to the verdict.
    """
    hits = "" if evidence is None else reached(outcome, evidence)
    proof, model, best = outcome.certificate, outcome.problem.model, outcome.best
    assert best is not None
    opposed, priced = conflict(outcome.conflict, outcome.together) if outcome.conflict else None, None
    if best.solution is not None and best.status != Status.INFEASIBLE:  # elsewhere multipliers are not prices
        priced = active(model, best.objective, best.solution.displayed_limits)
    verdict = [*refuted_first(outcome), *graded_status(search_verdict(outcome, best), best, tail)]
    notes, checked = [*noted(outcome.notes)], checks(best.validation.checks)
    proven = certificate_lines(proof)
    single = outcome.message == Status.OPTIMAL.text and outcome.starts == 1 and not best.exact
    message = quiet(outcome.message + " (use --starts N for a multistart search)" * single)
    ended: list[Line] = (proven if certified(proof) else []) if outcome.refuted else [message]
    full = summary(
        model.title,
        [*verdict, *notes, *ended],
        design,
        figures,
        *tables,
        opposed or priced,
        None if proof is None else certificate_table(proof, model.shown_objective, outcome.seconds),
        None if outcome.rounding is None else _rounded_sizes(outcome, outcome.rounding, best.values),
        None if outcome.rounding is None else _influences(outcome.rounding),
        checked,
        *others,
        backends(outcome) if len(outcome.backends) > 1 else None,
        effort(outcome, hits),
    )
    shown = [quiet(hits)] if hits and best.status is Status.OPTIMAL else ended
    headline = [] if figures is None or outcome.conflict else [objective_line(figures)]
    status = [*verdict_lines(verdict), *notes, *headline, *shown, *([] if certified(proof) else proven)]
    return replace(full, short=short_text(model.title, status, dimensions(design), priced, checked, opposed))


def _rounded_sizes(outcome: SynthesisResult, rounding: Rounding, values: Mapping[str, float]) -> TableSpec:
    """Tabulate the rounded sizes beside those of the optimum."""
    model = outcome.problem.model
    rows: list[Row] = []
    for name, step in rounding.steps.items():
        factor, unit = model.display(name)
        rows.append((name, dimension(rounding.optimum[name] * factor), strong(dimension(values[name] * factor)), unit, step))
    naive = "" if rounding.naive is None else f"{number(model.shown_objective(rounding.naive).value, 6)}, "
    nearest = f"nearest sizes: {naive}{'valid' if rounding.naive_valid else 'not valid'}"
    before = model.shown_objective(rounding.objective)
    notes = (quiet(f"optimum without rounding: {number(before.value, 6)} {before.unit}".rstrip()), quiet(nearest))
    return replace(table("Rounding", ["", ">optimum", ">rounded", "", "grid"], rows), notes=notes)


def _influences(rounding: Rounding) -> TableSpec | None:
    """Tabulate for each limit the size that changes it most by half a step, and what the limit admits."""
    largest: dict[str, Influence] = {}
    for one in rounding.influences:  # the largest shares first
        if one.limit not in largest or one.change > largest[one.limit].change:
            largest[one.limit] = one
    rows = [
        (limit, one.size, number(one.change, 3), one.unit, f"{'' if one.one_sided else '+- '}{number(one.room, 3)}")
        for limit, one in largest.items()
    ]
    columns = ["limit", "size", ">changes it by", "", ">may change by"]
    return table("What half a step changes most", columns, rows) if rows else None


def reached(outcome: SynthesisResult, evidence: Evidence) -> str:
    """Return how many starts reached the best value; nothing if its optimality is proven, or without a search."""
    if outcome.starts < 2 or not outcome.valid or outcome.none_better or certified(outcome.certificate):
        return ""
    distinct = f", {evidence.optima} distinct values" if evidence.optima > 1 else ""
    return f"{evidence.hits} of {outcome.starts} starts reached the best value{distinct}; {evidence.chance}"


def effort(outcome: SynthesisResult, hits: str = "") -> Paragraph:
    """Return what the search consisted of, and how long it took."""
    solution, words = outcome.solution, ["" if outcome.backend == "none" else outcome.backend]
    words.append(count_noun(outcome.starts, "start") if outcome.starts else "")
    words.append(count_noun(solution.iterations, "iteration") if solution is not None and solution.iterations else "")
    texts = hits, ", ".join(filter(None, words)), times(outcome.seconds, 1)
    return Paragraph(quiet("; ".join(filter(None, texts))), appendix=True)


def refuted_first(outcome: SynthesisResult) -> Iterator[Line]:
    """Yield which limits exclude each other, the first line of the status of an infeasible problem."""
    if outcome.refuted:
        yield [bad(outcome.refuted)]


def search_verdict(outcome: SynthesisResult, best: Any) -> list[Inline]:
    """Return how a search ended, and its verdict; an infeasible problem has one phrase for both."""
    ended, *judged = verdict_words(best.status, best.valid, outcome.certificate, none_better=outcome.none_better)
    return [f"{ended}, ", verdict(judged[0], best.valid)] if judged else [bad(ended)]


def graded_status(line: Sequence[Inline], best: Any, tail: str) -> Iterator[Line]:
    """Yield a line with the grade of a valid design, if it has one, and a tail, then the likely reasons of a poor one."""
    fit: Fit | None = best.fit if best.valid else None
    if fit is None:
        yield [*line, tail]
        return
    yield [*line, ", ", bad(fit.text) if fit.grade == "poor" else fit.text, tail]
    for reason in fit.reasons:
        yield f"{fit.text.partition(':')[0].capitalize()}, likely reason: {reason.reason}. Remedy: {reason.remedy}."


def dimension_rows(model: Problem, values: Mapping[str, float], derived: Mapping[str, str]) -> list[Row]:
    """Return the rows of a design [SI]: name, value, unit, and whether it is free, or the remark on a derived value."""
    rows: list[Row] = []
    for name, value in values.items():
        (factor, unit), quantity = model.display(name), model.quantities.get(name)
        shown = (dimension if unit == "deg" else significant)(value * factor)
        remark = derived[name] if quantity is None else ", ".join(filter(None, (quantity.status, allowed(quantity, value))))
        rows.append((name, strong(shown) if quantity is not None and quantity.free else shown, unit, quiet(remark)))
    return rows


def allowed(quantity: Quantity, value: float) -> str:
    """Return the bounds of a quantity, and how far a value [SI] lies beyond them; nothing if the file states none."""
    if quantity.low is None:
        return ""
    (size, unit), (low, high) = quantity.display, quantity.bounds
    beyond = max(low - value, value - high)
    passed = f": {beyond * size:.4g} {unit} beyond" if beyond > 1e-6 * max(abs(low), abs(high)) else ""
    return f"{low * size:g} ... {high * size:g}{passed}"


def active(model: Problem, objective: float, limits: Iterable[LimitState]) -> Part:
    """Tabulate the active constraints with their shadow prices, in the unit in which the model shows its objective.

    The price of an inequality is the improvement of the objective per step by which its bound alone is relaxed; that of an
    equality is the change of the objective, with its sign, per step by which its value is raised; see `price_step`.
    """
    (base, factor, unit, _), rows, raised = model.shown_objective(objective), [], False
    joint: dict[frozenset[str], tuple[float, set[str]]] = {}

    def share(gain: float) -> str:
        return f" ({percent(gain / base, 2)})" if 5e-5 * base <= gain <= base else ""  # otherwise not informative

    for limit in (limit for limit in limits if limit.active):
        size, step = price_step(limit.unit, limit.bound, abs(limit.multiplier * factor / base) if base else 0.0)
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


def checks(selected: Sequence[Check]) -> TableSpec:
    """Tabulate the checks of a validation; passed bounds of dimensions share one row."""
    bounds = [check for check in selected if check.passed and check.name.endswith(BOUNDED)]
    gathered = bounds if len(bounds) > 1 else []
    rows: list[Row] = [
        (verdict("ok" if item.passed else "FAIL", item.passed), item.name, number(item.value), quiet(item.unit), item.limit)
        for item in selected
        if item not in gathered
    ]
    if gathered:
        rows.append((good("ok"), f"{count_noun(len(gathered), 'dimension')} within bounds", "all", "", ""))
    title = f"Validation: {sum(check.passed for check in selected)} of {len(selected)} checks passed"
    return table(title, ["", "check", ">value", "", "limit"], rows, appendix=True)


def limits(selected: Sequence[Check], most: int) -> list[TableSpec]:
    """Tabulate the limits of a file with measured values and margins, violated ones first; none if it states none.

    Of more than `most` limits, those with the least margins relative to their bounds are shown.
    """
    rated: list[tuple[bool, float, Row]] = []
    for one in requirements(selected):
        gap, size = abs(one.margin), max((abs(end) for end in (one.low, one.high) if math.isfinite(end)), default=0.0) or 1.0
        value, exact = one.low == one.high, one.met and gap <= min(EXACT * size, NARROW * (one.high - one.low))
        words = f"{number(gap, 3)} {one.unit}{'' if one.met else ' short'}"
        if one.met and (value or exact):
            words = "met" if value else "none"
        bound = " ... ".join(f"{end:.6g}" for end in dict.fromkeys((one.low, one.high)) if math.isfinite(end))
        sense = "= " if value else ">= " if one.high == math.inf else "<= " if one.low == -math.inf else ""
        row = (
            one.name if one.met else bad(one.name),
            strong(f"{comparable(one.value, 0.0 if exact else gap)} {one.unit}".rstrip()),
            f"{sense}{bound} {one.unit}".rstrip(),
            verdict(words.rstrip(), one.met),
        )
        rated.append((one.met, gap / size, row))
    rated.sort(key=lambda one: one[:2])
    notes = [quiet(f"and {len(rated) - most} more, with larger margins")] if len(rated) > most else []
    rows = [row for *_, row in rated[:most]]
    return [table("", ["", ">value", "required", "margin"], rows, notes=notes)] if rows else []


def optima(outcome: SynthesisResult) -> TableSpec | None:
    """Tabulate the distinct optima of a multistart search, if it found any."""
    if not outcome.optima or max(len(outcome.optima), outcome.starts) < 2:
        return None
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
    return table("Distinct optima", columns, rows, appendix=True, notes=notes)


def exact_solutions(outcome: SynthesisResult) -> TableSpec | None:
    """Tabulate all linkages that meet exact targets: usable ones with their dimensions, the others with the reason."""
    found = outcome.exact_solutions
    if found is None or not found.solutions:
        return None
    model, rows = outcome.problem.model, list[Row]()
    names = [name for name in model.free if model.quantities[name].kind == "length"][:MAX_VARIABLES]
    by = "" if found.ranked_by == BY_TRANSMISSION else f"{found.ranked_by} [{found.unit}]".removesuffix(" []")
    errs = any(one.between is not None for one in found.solutions)
    factor, unit = DISPLAYED[outcome.problem.spec.unit] if errs else (1.0, "")
    for k, one in enumerate(found.solutions[:MOST_EXACT], start=1):
        sizes = [number(one.values[name] * model.display(name)[0], 4) for name in names]
        angle, others = fixed(math.degrees(one.transmission), 1), len(one.reasons) - MOST_REASONS
        reasons = "; ".join(one.reasons[:MOST_REASONS]) + (f"; and {others} more" if others > 0 else "")
        ranked = ["–" if one.figure is None else number(one.figure, 4)] if by else []
        ranked += ["–" if one.between is None else number(factor * one.between, 4)] if errs else []
        rows.append((str(k), *sizes, *ranked, angle, Span(reasons) if one.reasons else good("usable")))
    columns = [
        ">",
        *(f">{name}" for name in names),
        *([f">{by}"] if by else []),
        *([f">error [{unit}]"] if errs else []),
        ">angle",
        "usable, or why not",
    ]
    units = joined(sorted({model.display(name)[1] for name in names}))
    notes = [f"sizes in {units}; transmission angle from 0 or 180 deg: least over the motion if usable, else at the targets"]
    notes += ["error: largest one over the whole range of the law"] if errs else []
    notes += [f"{name}: {words}" for name, words in DEFECTS.items() if any(name in one.reasons for one in found.solutions)]
    if more := len(found.solutions) - len(rows):
        notes.append(f"{count_noun(more, 'more is', 'more are')} in --json")
    title = "The best exact solutions" if found.special else "All exact solutions"
    return table(title, columns, rows, notes=map(quiet, notes))


def backends(outcome: SynthesisResult) -> TableSpec:
    """Tabulate the solutions of the back ends side by side."""
    model, solutions = outcome.problem.model, outcome.backends.values()
    shown = [model.shown_objective(solution.objective) for solution in solutions]
    rows = [("status", *(solution.status.value for solution in solutions), "")]
    rows.append(("objective", *(number(objective.value, 9) for objective in shown), shown[0].unit))
    for name in model.free:
        factor, unit = model.display(name)
        rows.append((name, *(fixed(solution.design[name] * factor, 5) for solution in solutions), unit))
    methods = [METHODS.get(solution.message, name) for name, solution in outcome.backends.items()]
    if methods != [*outcome.backends]:
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
    exact = [(limit.name, _value(limit.sides[0])) for limit in opposed if limit.exact]
    notes = [f'A single value is exact: write ">= {x}" for the smallest or "<= {x}" for the largest {name}.' for name, x in exact]
    return table("Conflicting limits", columns, rows, sections=[single], notes=notes)


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
