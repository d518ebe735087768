"""Tables of a path, motion, function or transmission synthesis result of any linkage."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from optlink.errors import Status
from optlink.linkage.cognates import Cognate, CouplerLinkage
from optlink.linkage.vector2d import TURN
from optlink.problem.design import DesignProblem
from optlink.report.format import fixed, number, precise, significant, times
from optlink.report.table_spec import Line, Paragraph, Row, Summary, TableSpec, bad, noted, quiet, strong, summary, table
from optlink.report.views.certificate_view import certificate_lines, certificate_table, certified
from optlink.report.views.function_tables import (
    active,
    backends,
    checks,
    conflict,
    dimension_rows,
    graded_status,
    refuted_first,
    search_verdict,
)
from optlink.report.views.short_text import dimensions, objective_line, short_text, verdict_lines
from optlink.solvers.contract import LEAST_SQUARES
from optlink.tasks.machine import turning_machine
from optlink.tasks.results.design import LEVEL, LinkageDesign, SynthesisResult
from optlink.units import DISPLAYED

LINKAGE_TOLERANCE = 1e-3  # relative tolerance for equal four-bars
BOUNDED = " within its bounds"
MIN_LENGTH = 1e-8  # m, least length that is shown
MAX_POINTS = 12  # largest number of points listed on a terminal; result.json and points.csv contain all


def path_result(outcome: SynthesisResult) -> Summary:
    """Summarise a synthesis result: best design, deviations, active constraints, validation, alternatives, cognates."""
    from optlink.report.views.analysis_tables import machine_strokes

    model, best, search_proof = outcome.problem.model, outcome.best, outcome.certificate
    certificate = None if search_proof is None else certificate_table(search_proof, model.shown_objective, outcome.seconds)
    impossible = conflict(outcome.conflict, outcome.together) if outcome.conflict else None
    if best is None:
        remark = "no start could be assembled at all points within the bounds; widen them, or give more starts"
        proof = certificate_lines(outcome.certificate)
        reason: list[Line] = [*noted(outcome.notes)] or ([] if certified(outcome.certificate) else [quiet(remark)])
        status: list[Line] = [*refuted_first(outcome), bad("no linkage found"), *reason, *proof]
        return summary(model.title, status, impossible, certificate, _times(outcome))
    machine = turning_machine(best.problem, best.values)
    strokes = None if machine is None else machine_strokes(machine, float(best.crank_angles[-1] - best.crank_angles[0]))
    bounds = [check for check in best.validation.checks if check.passed and check.name.endswith(BOUNDED)]
    priced = best.solution is not None and best.status != Status.INFEASIBLE
    limits = active(best.task, best.objective, best.displayed_limits) if priced else None
    verdict, notes, proof = list(_verdict(outcome, best)), [*noted(outcome.notes)], certificate_lines(outcome.certificate)
    design, objective = _sizes(best, "either" in str(outcome.problem.model.mechanism.assembly)), _objective(best)
    checked, reached = checks(best.validation.checks, bounds if len(bounds) > 1 else ()), _reached(outcome)
    full = summary(
        model.title,
        [*verdict, *notes, *proof],
        design,
        objective,
        strokes,
        impossible,
        _points(best) if best.task.pointed else None,
        limits,
        certificate,
        checked,
        _alternatives(outcome) if len(outcome.designs) > 1 else None,
        _cognates(outcome, best) if best.cognates else None,
        backends(outcome) if len(outcome.backends) > 1 else None,
        _times(outcome),
    )
    evidence = [quiet(reached)] if reached else []
    status = [*verdict_lines(verdict), *notes, objective_line(objective), *proof, *evidence]
    return replace(full, short=short_text(model.title, status, dimensions(design), limits, checked, impossible))


def _verdict(outcome: SynthesisResult, best: LinkageDesign) -> Iterator[Line]:
    count = len(outcome.designs)
    suffix = f"; {count} distinct design{'s' * (count != 1)} verified" if best.valid else "; the nearest design is shown"
    yield from refuted_first(outcome)
    line = search_verdict(best.status, best.valid, outcome.certificate)
    yield from graded_status(line, best.fit if best.valid else None, "" if outcome.starts == 0 else suffix)


def _sizes(design: LinkageDesign, chosen: bool) -> TableSpec:
    values = {name: design.values[name] for name in design.task.quantities}
    rows = dimension_rows(design.task, values, {}, significant)
    rows.append(("assembly", strong(words(design)), "", quiet("chosen" if chosen else "fixed")))
    return table("Design", "<><<", rows)


def words(design: LinkageDesign) -> str:
    """Format the assembly modes."""
    return ", ".join(f"{joint} {mode}".strip() for joint, mode in modes(design).items())


def modes(design: LinkageDesign) -> dict[str, str]:
    """Return the assembly modes by joint; a four-bar has one mode with an empty name."""
    assembly = design.assembly
    return {str(joint): str(mode) for joint, mode in assembly.items()} if isinstance(assembly, dict) else {"": str(assembly)}


def _objective(design: LinkageDesign) -> TableSpec:
    measured, task = design.measured, design.task
    factor, unit = DISPLAYED[task.unit]
    rms, largest = math.sqrt(float((measured.distances**2).mean())), float(measured.distances.max())
    what = {"m": "distance", "rad": "error", "": "cosine"}[task.unit]
    remark = f"{what}: rms {number(factor * rms, 4)}, largest {number(factor * largest, 4)} {unit}".rstrip()
    if design.between is not None and np.nanmax(design.between, initial=0.0) > MIN_LENGTH:
        remark += f"; between the points up to {number(1e3 * np.nanmax(design.between), 3)} mm"
    if measured.turned is not None:
        remark += f"; angle: largest {number(math.degrees(float(abs(measured.turned).max())), 4)} deg"
    scale, square = task.objective_display
    rows: list[Row] = [
        (measure(task), strong((number if exact(design) else precise)(scale * design.objective, 8)), square, quiet(remark))
    ]
    least, where = math.degrees(design.least_transmission), "over the revolution" if design.crank_turns else "between the points"
    if task.by_angle and math.isfinite(least):
        remark = f"{number(90.0 - least, 4)} deg from ideal, {where}"
        return table("Objective", "<><<", [("worst transmission angle", strong(fixed(least, 2)), "deg", quiet(remark))])
    if math.isfinite(least):
        rows.append(("transmission angle", fixed(least, 2), "deg", quiet(f"least distance from 0 or 180 deg {where}")))
    return table("Objective", "<><<", rows)


def measure(task: DesignProblem) -> str:
    """Return the name of the measure of the deviations, with a note if it is weighted."""
    return task.measure + (", weighted" if task.target_points.weights is not None else "")


def _points(design: LinkageDesign) -> TableSpec:
    measured, targets = design.measured, design.task.data.columns
    step = max(1, math.ceil(len(targets) / MAX_POINTS))
    digits = decimals(1e3 * float(abs(targets[:, :2]).max()))
    rows, between = [], design.between
    for i in range(0, len(targets), step):
        places = (*targets[i, :2], *measured.generated[i])
        row = [str(i + 1), *(fixed(1e3 * place, digits) for place in places), number(1e3 * measured.distances[i], 3)]
        row.append(fixed(math.degrees(design.crank_angles[i]), 2))
        if between is not None:
            after = between[i : i + step]
            row.append(number(1e3 * np.nanmax(after), 3) if np.any(np.isfinite(after)) else "")
        if measured.turned is not None:
            row.append(number(math.degrees(measured.turned[i]), 3))
        rows.append(row)
    columns = [">", ">target x", ">y", ">generated x", ">y", ">error", ">crank angle"]
    columns += [">between"] if between is not None else []
    columns += [">turned by"] if measured.turned is not None else []
    notes = [quiet(f"{len(rows)} of {len(targets)} points; all of them with --out or --json")] if step > 1 else []
    if between is not None:
        note = "between: distance of the curve from the line to the next point, beyond the arc that the points suggest"
        notes.append(quiet(note))
    return table("Points [mm, deg]", columns, rows, notes=notes, unbroken=True)


def decimals(largest: float) -> int:
    """Return the number of decimals for coordinates up to `largest`."""
    size = math.floor(math.log10(largest)) if largest > 0.0 else 0
    return max(0, 7 - size) if size > 4 else min(8, 3 - min(size, 0))


def _alternatives(outcome: SynthesisResult) -> TableSpec:
    """Tabulate the distinct designs side by side."""
    designs, related, task = outcome.designs, cognate_sources(outcome.designs), outcome.designs[0].task
    columns = [_column(design, related.get(k)) for k, design in enumerate(designs)]
    names = [("least transmission angle", "deg"), ("same curve as", "")]
    names = names if task.by_angle else [(measure(task), task.objective_display[1]), *names]
    names += [(name, quantity.display[1]) for name, quantity in task.quantities.items() if not quantity.fixed]
    names += [(joint, "") for joint in dict.fromkeys(f"assembly {mode}".rstrip() for design in designs for mode in modes(design))]
    rows: list[Row] = [
        (name, quiet(unit), *(column.get(name, "") for column in columns))
        for name, unit in names
        if any(name in column for column in columns)
    ]
    heads = ["", "", *(f">{k + 1}" for k in range(len(designs)))]
    return table(f"Designs, best first ({len(designs)} distinct)", heads, rows, leading=2, unbroken=True)


def _column(design: LinkageDesign, related: int | None) -> dict[str, str]:
    """Return the cells of a design by row; `related` is the design whose cognate it is."""
    cells = {measure(design.task): "exact" if exact(design) else precise(design.task.objective_display[0] * design.objective, 5)}
    if math.isfinite(design.least_transmission):
        cells["least transmission angle"] = fixed(math.degrees(design.least_transmission), 1)
    if related is not None:
        cells["same curve as"] = f"cognate of {related + 1}"
    for name, quantity in design.task.quantities.items():
        if not quantity.fixed:
            cells[name] = significant(design.values[name] * quantity.display[0])
    return cells | {f"assembly {joint}".rstrip(): mode for joint, mode in modes(design).items()}


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


def _reached(outcome: SynthesisResult) -> str:
    """Return how many starts reached the best value; nothing if its optimality is proven, or without a search."""
    evidence = outcome.evidence
    if evidence is None or not outcome.designs or certified(outcome.certificate):
        return ""
    return f"{evidence.hits} of {outcome.starts} starts reached the best value; {evidence.chance}"


def _times(outcome: SynthesisResult) -> Paragraph:
    then = f", then {outcome.backend}" * (outcome.backend != LEAST_SQUARES)
    method = f"batch of least squares{then}" if outcome.starts else ""
    return Paragraph(quiet("; ".join(filter(None, (_reached(outcome), method, times(outcome.seconds))))), appendix=True)


# --- comparison of designs ---------------------------------------------------------------------------------------------------


def exact_places(design: LinkageDesign) -> bool:
    """Return whether every point, or every output of a function, is met to rounding."""
    return bool((design.measured.distances <= LEVEL * design.task.whole).all())


def exact_angles(design: LinkageDesign) -> bool:
    """Return whether all pose angles are met to rounding; true if there are none."""
    turned = design.measured.turned
    return turned is None or bool((abs(turned) <= LEVEL).all())


def exact(design: LinkageDesign) -> bool:
    """Return whether all prescribed values are met to rounding; false for transmission synthesis, which prescribes none."""
    return bool(design.task.unit) and exact_places(design) and exact_angles(design)


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
