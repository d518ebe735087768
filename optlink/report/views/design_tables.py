"""Tables of a synthesis result of any linkage: design, figures, limits, alternatives, cognates."""

import math
from collections.abc import Sequence

from optlink.errors import Status
from optlink.linkage.cognates import Cognate, CouplerLinkage
from optlink.linkage.vector2d import TURN
from optlink.report.format import change, dimension, fixed, number, precise, significant
from optlink.report.table_spec import Line, Row, Summary, TableSpec, bad, noted, quiet, strong, summary, table
from optlink.report.views.certificate_view import certificate_lines, certificate_table, certified
from optlink.report.views.design_words import measure, modes, words_of
from optlink.report.views.search_tables import (
    NEAREST_DESIGN,
    conflict,
    dimension_rows,
    effort,
    optima,
    refuted_first,
    search_summary,
)
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.design import LinkageDesign, SynthesisResult

LINKAGE_TOLERANCE = 1e-3  # relative tolerance for equal four-bars


def design_result(outcome: SynthesisResult) -> Summary:
    """Summarise a synthesis result: best design, deviations, active constraints, validation, alternatives, cognates."""
    from optlink.report.views.analysis_tables import machine_strokes

    model, best, count = outcome.problem.model, outcome.best, len(outcome.designs)
    if best is None:
        proof = outcome.certificate
        certificate = None if proof is None else certificate_table(proof, model.shown_objective, outcome.seconds)
        remark = "no start could be assembled at all points within the bounds; widen them, or give more starts"
        reason: list[Line] = [*noted(outcome.notes)] or ([] if certified(proof) else [quiet(remark)])
        status: list[Line] = [*refuted_first(outcome), bad("no linkage found"), *reason, *certificate_lines(proof)]
        opposed = conflict(outcome.conflict, outcome.together) if outcome.conflict else None
        return summary(model.title, status, opposed, certificate, effort(outcome))
    machine, alone = turning_machine(best.problem, best.values), best.whole.of_cycle
    strokes = None if machine is None else machine_strokes(machine, best.rotation[1])
    distinct = f"{count} distinct designs verified" if count > 1 else ""
    return search_summary(
        outcome,
        _compared_sizes(outcome, best) if alone else _sizes(outcome, best),
        None if alone or not math.isfinite(best.objective) else _figures(outcome, best),
        (_compared_figures(best) if alone else None, strokes, *(words_of(part).targets(part) for part in best.parts)),
        (
            optima(outcome),
            _alternatives(outcome.designs) if count > 1 else None,
            _cognates(outcome, best) if best.cognates else None,
        ),
        evidence=outcome.evidence,
        tail="".join(f"; {text}" for text in (best.comparison, distinct) if text),
    )


def _sizes(outcome: SynthesisResult, design: LinkageDesign) -> TableSpec:
    derived = {}
    for task in (part.task for part in design.parts if part.follows_law):
        default = "" if "start" in task.requirement.model_fields_set else ", the default start"
        derived[task.prefix + task.start_name] = f"at the {task.dead_centre}{default}" if task.dead_centre else "given"
        derived[task.prefix + task.base_name] = f"the {task.output} angle there"
    rows = dimension_rows(design.whole, design.values, derived)
    chosen = "either" in str(outcome.problem.model.mechanism.assembly)
    shown = ", ".join(f"{joint} {mode}".removeprefix("assembly").strip() for joint, mode in modes(design).items())
    remark = "chosen" if chosen else "fixed"
    if isinstance(design.assembly, str):
        remark = f"joint C lies to the {design.assembly} of B -> D{', chosen' * chosen}"
    rows.append(("assembly", strong(shown), "", quiet(remark)))
    return table(NEAREST_DESIGN if design.status is Status.INFEASIBLE else "Design", "<><<", rows)


def _figures(outcome: SynthesisResult, design: LinkageDesign) -> TableSpec:
    """Tabulate the objective, the deviations from every requirement, the transmission angle, quantities of the machine."""
    whole, goals = design.whole, list(design.whole.goals)
    parts = sorted(design.parts, key=lambda part: part.task.tolerance is not None)
    rows: list[Row] = []
    if len(goals) + sum(part.task.tolerance is None for part in parts) > 1:
        rows.append(("weighted sum", strong(precise(design.objective, 6)), "", quiet("minimised")))
    elif goals:
        (goal,), goals, shown = goals, [], whole.shown_objective(design.objective)
        rows.append((goal.words, strong(precise(shown.value, 6)), shown.unit, quiet(f"{goal.sense}d")))
    rows += [row for part in parts for row in words_of(part).rows(part, outcome)]
    least, where = math.degrees(design.least_transmission), "revolution" if design.crank_turns else "range"
    if math.isfinite(least) and not any(part.task.requirement.by_angle for part in design.parts):
        remark = f"least distance from 0 or 180 deg over the {where}"
        rows.append(("transmission angle", fixed(least, 2), "deg", quiet(remark)))
    figures = design.figures[len(whole.goals) - len(goals) :]
    rows += [(figure.words, number(figure.result, 6), figure.unit, quiet(figure.limit)) for figure in figures]
    return table("Objective", "<><<", rows)


def _compared_sizes(outcome: SynthesisResult, design: LinkageDesign) -> TableSpec:
    """Tabulate the design variables beside their initial values."""
    rows: list[Row] = []
    for name in (*design.whole.free, *design.whole.links):
        quantity = design.whole.quantities[name]
        size, unit = quantity.display
        low, high = (bound * size for bound in quantity.bounds)
        within = f"{low:g} ... {high:g}" if quantity.low is not None else ""
        bounds = quiet(within if quantity.free else ", ".join(filter(None, [quantity.status, within])))
        value, initial = (dimension(one * size) for one in (design.values[name], quantity.value))
        rows.append((name, strong(value), unit, initial, bounds))
    title = NEAREST_DESIGN if outcome.status is Status.INFEASIBLE else "Design"
    return table(title, ["", ">result", "", ">initial", ""], rows)


def _compared_figures(design: LinkageDesign) -> TableSpec:
    """Tabulate the quantities of the machine beside those of the initial one."""
    rows: list[Row] = []
    for figure in design.figures:
        shown = change(figure.result / figure.initial - 1.0 if figure.initial and math.isfinite(figure.initial) else math.nan)
        values = number(figure.initial), strong(number(figure.result))
        rows.append((figure.words, *values, figure.unit, shown, quiet(figure.limit)))
    if not design.whole.single:
        rows.append(("weighted sum", "", strong(number(design.objective, 8)), "", "", quiet("minimised")))
    return table("Objective and limits, measured over the cycle", ["", ">initial", ">result", "", ">change", "limit"], rows)


def _alternatives(designs: Sequence[LinkageDesign]) -> TableSpec:
    """Tabulate the distinct designs side by side."""
    task, related = designs[0].whole, cognate_sources(designs)
    (factor, unit), least = task.objective_display, [math.degrees(design.least_transmission) for design in designs]
    objectives = ["exact" if design.exact else precise(factor * design.objective, 6) for design in designs]
    rows: list[tuple[str, ...]] = (
        [] if task.by_angle else [("objective" if task.composed else measure(designs[0]), unit, *objectives)]
    )
    rows.append(("least transmission angle", "deg", *(fixed(angle, 1) if math.isfinite(angle) else "" for angle in least)))
    rows.append(("same curve as", "", *(f"cognate of {related[k] + 1}" if k in related else "" for k in range(len(designs)))))
    for name in (name for name, quantity in task.quantities.items() if not quantity.fixed):
        size, shown = task.display(name)
        rows.append((name, shown, *(significant(design.values[name] * size) for design in designs)))
    for joint in dict.fromkeys(joint for design in designs for joint in modes(design)):
        rows.append((joint, "", *(modes(design).get(joint, "") for design in designs)))
    cells: list[Row] = [(name, quiet(unit), *values) for name, unit, *values in rows if any(values)]
    heads = ["", "", *(f">{k + 1}" for k in range(len(designs)))]
    return table(f"Designs, best first ({len(designs)} distinct)", heads, cells, leading=2, unbroken=True)


def _cognates(outcome: SynthesisResult, best: LinkageDesign) -> TableSpec:
    rows = []
    for cognate in best.cognates:
        linkage = cognate.linkage
        lengths = [significant(1e3 * length) for length in (linkage.crank, linkage.coupler, linkage.rocker, linkage.frame)]
        full = cognate.crank_turns and cognate.keeps_side
        rotation = "turns fully" if full else "does not turn fully"
        same = "".join(f"; design {k}" for k, design in enumerate(outcome.designs[1:], start=2) if _is_cognate(cognate, design))
        rows.append((*lengths, cognate.inversion.value, f"{rotation}, follows the {cognate.turns_as}{same}"))
    title = "Cognates of the best: four-bars with the same coupler curve [mm]"
    return table(title, [">crank", ">coupler", ">rocker", ">frame", "", "its crank"], rows, unbroken=True)


def cognate_sources(designs: Sequence[LinkageDesign]) -> dict[int, int]:
    """Return, by index of a design, the earlier design whose cognate it is: another four-bar with the same coupler curve."""
    originals: dict[int, int] = {}
    for j, design in enumerate(designs):
        for i in range(j):
            if any(_is_cognate(cognate, design) for cognate in designs[i].cognates):
                originals[j] = i
                break
    return originals


def _is_cognate(cognate: Cognate, design: LinkageDesign) -> bool:
    """Return whether a design is this cognate, driven at either of its fixed pivots."""
    linkage = design.coupler_linkage
    return linkage is not None and any(_same_linkage(linkage, driven.linkage) for driven in (cognate, cognate.driven_from_rocker))


def _same_linkage(first: CouplerLinkage, second: CouplerLinkage) -> bool:
    names = ("crank", "coupler", "rocker", "frame", "along", "across", "x", "y")
    size = max(*first.lengths, abs(first.along), abs(first.across))
    turned = math.remainder(first.direction - second.direction, TURN)
    return abs(turned) <= LINKAGE_TOLERANCE and all(
        abs(getattr(first, name) - getattr(second, name)) <= LINKAGE_TOLERANCE * size for name in names
    )
