"""Tables of a synthesis result of any linkage: design, figures, limits, alternatives, cognates."""

import math
import re
from collections.abc import Sequence

import numpy as np

from optlink.errors import Status
from optlink.linkage.dyads import transmitting
from optlink.linkage.roberts import Cognate, CouplerLinkage
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.format import change, dimension, figure, fixed, number, precise, pretty, si, significant
from optlink.presentation.table_spec import Line, Row, Summary, TableSpec, bad, good, noted, quiet, strong, summary, table
from optlink.presentation.views.search_tables import (
    NEAREST_DESIGN,
    allowed,
    certificate_lines,
    certificate_table,
    certified,
    conflict,
    dimension_rows,
    effort,
    exact_solutions,
    optima,
    refuted_first,
    search_summary,
)
from optlink.problem.requirements.base import pose_angles
from optlink.tasks.results.design import NO_SEARCH, LinkageDesign, SynthesisResult
from optlink.tasks.results.fit import PathFit
from optlink.units import DISPLAYED

# Words of a synthesised design by kind of requirement: its figures, the table and the file of its positions, its conclusion.

MIN_LENGTH = 1e-8  # m, least length that is shown
WORSE = 1e-6  # deg by which a transmission angle must be nearer to 180 deg than another one to 0 to be the worse
FINEST = 1e-5  # deviation from points, as a share of their extent, below which a sentence has no figures
MAX_POINTS = 12  # largest number of points listed on a terminal; result.json and points.csv contain all


class Words:
    """Words of designs, common to all kinds of requirement; see `words_of`."""

    spot, deviation = "position", "error"  # names of a target and of the deviation from it

    def figures(self, design: LinkageDesign) -> list[str]:
        """Return the deviations from the targets, as texts."""
        distances = design.measured.distances
        if design.exact:
            return [f"{f'all {len(distances)}' if len(distances) > 2 else 'both'} {self.spot}s met exactly, to rounding"]
        factor, unit = DISPLAYED[design.task.unit]
        rms, largest = (number(factor * value, 4) for value in (rms_of(distances), np.max(distances)))
        return [f"{self.deviation}: rms {rms}, largest {largest} {unit}".rstrip()]

    def rows(self, design: LinkageDesign, outcome: SynthesisResult) -> list[Row]:
        """Return the rows of the table of figures, the measure of the deviations first."""
        (value, unit), tolerance, texts = measured(design), design.task.tolerance, self.figures(design)
        if tolerance is not None:
            texts.append(f"at most {DISPLAYED[design.task.unit][0] * tolerance:.6g} {unit}".rstrip())
        shown = (number if design.exact else precise)(value, 6)
        return [(measure(design) + design.task.suffix, strong(shown), unit, quiet("; ".join(texts)))]

    def captions(self, design: LinkageDesign) -> list[str]:
        """Return the captions of a picture: the measure of the deviations, and these."""
        stated = design.exact or measure(design) in ("rms", f"largest {self.deviation}")
        return [*([] if stated else [f"{measure(design)} {figure(*measured(design))}"]), *self.figures(design)]

    def targets(self, design: LinkageDesign) -> TableSpec | None:
        """Return the table of the targets in the terminal, if there is one."""
        return None

    def columns(self, design: LinkageDesign) -> dict[str, Array]:
        """Return the prescribed and generated values at every target, by column name with SI unit."""
        return {"point": np.arange(1.0, len(design.crank_angles) + 1.0)}

    def achieved(self, design: LinkageDesign) -> str:
        """Return what an inexact design achieves, as a clause of its conclusion."""
        return ""


class _Law(Words):
    def figures(self, design: LinkageDesign) -> list[str]:
        texts, between = super().figures(design), design.largest_between
        if design.task.robust is not None:
            texts = [text.replace("error:", "error at nominal dimensions:") for text in texts]
        if between is None:
            return texts
        factor, unit = DISPLAYED[design.task.unit]
        return [f"{texts[0]}{'' if design.exact else ' at the positions'}, {number(factor * between, 4)} {unit} between them"]

    def rows(self, design: LinkageDesign, outcome: SynthesisResult) -> list[Row]:
        rows, step, task = super().rows(design, outcome), outcome.first_step, design.task
        if task.everywhere and task.tolerance is None:
            remark = "times that the largest error occurs in the range, with alternating sign"
            rows.append(("equal extremes of the error", str(design.alternations), "", quiet(remark)))
        if step is not None:
            from optlink.synthesis.freudenstein import WIDER

            error, bound = (number(math.degrees(value), 4) for value in (step.error, step.bound))
            proof = f"; {bound} deg is a lower bound at its start angles" if step.proven else ""
            limited = task.limits.transmission_at() is not None
            relaxed = f"; searched with the transmission-angle limits relaxed by {math.degrees(WIDER):g} deg" * limited
            remark = f"a starting point, with its error at the design positions alone{relaxed}{proof}"
            rows.append(("convex first step", error, "deg", quiet(remark)))
        return rows

    def columns(self, design: LinkageDesign) -> dict[str, Array]:
        unit, measured, law = design.task.unit, design.measured, design.task.law
        target = law.curve(law.offsets, design.rotation[0], design.own.get(design.task.base_name, 0.0))
        values = {f"target_{unit}": target, f"generated_{unit}": measured.generated[:, 0], f"distance_{unit}": measured.distances}
        return {**super().columns(design), **values, "crank_angle_rad": design.crank_angles}

    def achieved(self, design: LinkageDesign) -> str:
        unit, distances, between = design.task.unit, design.measured.distances, design.largest_between
        where = "" if between is None else f" at the design positions, {si(between, unit)} between them"
        rms = si(rms_of(distances), unit)
        return (
            f"the output follows the required motion within {si(float(np.max(distances)), unit)}{where} (root mean square {rms})"
        )


class _Points(Words):
    spot, deviation = "point", "distance"

    def figures(self, design: LinkageDesign) -> list[str]:
        texts, between, tolerances = super().figures(design), design.largest_between, design.task.data.tolerances
        if between is not None and between > MIN_LENGTH:
            texts.append(f"between the points up to {number(1e3 * between, 3)} mm")
        if np.any(np.isfinite(tolerances)) and not design.exact:
            used = float(np.nanmax(design.measured.distances / tolerances))
            texts.append(f"at most {f'{100.0 * used:.3g} % of' if used < 10.0 else f'{used:.3g} times'} the tolerance")
        return texts

    def captions(self, design: LinkageDesign) -> list[str]:
        within = _within(design.measured.distances, design.task.size)
        return super().captions(design) if design.exact or "(" in within else [f"distance: at most {within}"]

    def targets(self, design: LinkageDesign) -> TableSpec:
        measured, targets, between = design.measured, design.task.data.columns, design.between
        step = max(1, math.ceil(len(targets) / MAX_POINTS))
        digits = decimals(1e3 * abs(targets[:, :2]).max())
        rows = []
        for i in range(0, len(targets), step):
            places = (*targets[i, :2], *measured.generated[i])
            row = [str(i + 1), *(fixed(1e3 * place, digits) for place in places), number(1e3 * measured.distances[i], 3)]
            row.append(fixed(math.degrees(design.crank_angles[i]), 2))
            if between is not None:
                after = between[i : i + step]
                row.append(number(1e3 * np.nanmax(after), 3) if np.any(np.isfinite(after)) else "")
            if measured.turned is not None:
                row.append(number(math.degrees(measured.turned[i]), 3) if design.task.target_points.posed[i] else "")
            rows.append(row)
        columns = [">", ">target x", ">y", ">generated x", ">y", ">error", ">crank angle"]
        columns += [">between"] * (between is not None) + [">turned by"] * (measured.turned is not None)
        notes = [quiet(f"{len(rows)} of {len(targets)} points; all of them with --out or --json")] if step > 1 else []
        if between is not None:
            note = "between: distance of the curve from the line to the next point, beyond the arc that the points suggest"
            notes.append(quiet(note))
        return table("Points [mm, deg]", columns, rows, notes=notes, unbroken=True)

    def columns(self, design: LinkageDesign) -> dict[str, Array]:
        task, data, measured, columns = design.task, design.task.data, design.measured, super().columns(design)
        for name, places in (("target", data.columns), ("generated", measured.generated)):
            columns |= {f"{name}.{axis}_m": places[:, k] for k, axis in enumerate("xy")}
        columns |= {"distance_m": measured.distances, "crank_angle_rad": design.crank_angles}
        columns |= {"tolerance_m": data.tolerances} if np.any(np.isfinite(data.tolerances)) else {}
        return columns if task.target_points.weights is None else columns | {"weight": data.roots**2}

    def achieved(self, design: LinkageDesign) -> str:
        distances = design.measured.distances
        rest = f"; {pretty(design.way_back.text)}" if design.way_back is not None else ""
        spots = f"{self.spot}s of the path" if design.task.target_points.sampled else f"prescribed {self.spot}s"
        within = _within(distances, design.task.size)
        return f"point {design.task.point} passes the {len(distances)} {spots} within {within}{rest}"


def _within(distances: Array, size: float) -> str:
    """Return the largest of some distances [m] and their root mean square; nearer than anyone can make it, a bound of both."""
    finest, most = 10.0 ** math.ceil(math.log10(FINEST * size)), float(np.max(distances))
    stated = f"{figure(1e3 * most, 'mm')} (root mean square {figure(1e3 * rms_of(distances), 'mm')})"
    return figure(1e3 * finest, "mm") if most < finest else stated


class _Poses(_Points):
    spot = "pose"

    def figures(self, design: LinkageDesign) -> list[str]:
        largest = number(math.degrees(_most_turned(design)), 4)
        return [*super().figures(design), *([] if design.exact else [f"angle: largest {largest} deg"])]

    def columns(self, design: LinkageDesign) -> dict[str, Array]:
        target, turned = pose_angles(design.task.data.columns), design.measured.turned
        assert turned is not None
        angles = {"target.angle_rad": target, "generated.angle_rad": target + turned, "turned_rad": turned}
        return {**super().columns(design), **angles}

    def achieved(self, design: LinkageDesign) -> str:
        return f"{super().achieved(design)} and {si(_most_turned(design), 'rad')}"


def _most_turned(design: LinkageDesign) -> float:
    assert design.measured.turned is not None
    return float(np.max(np.abs(design.measured.turned)))


class _Transmission(Words):
    deviation = "cosine"

    def rows(self, design: LinkageDesign, outcome: SynthesisResult) -> list[Row]:
        least = math.degrees(design.least_transmission)
        if not design.task.requirement.by_angle or not math.isfinite(least):
            return super().rows(design, outcome)
        remark = f"{number(90.0 - least, 4)} deg from ideal, over the revolution"
        return [("worst transmission angle", strong(fixed(least, 2)), "deg", quiet(remark))]

    def captions(self, design: LinkageDesign) -> list[str]:
        return [] if design.task.requirement.by_angle else super().captions(design)

    def columns(self, design: LinkageDesign) -> dict[str, Array]:
        joints = [group.joint for group in transmitting(design.task.linkage)]
        angles = {f"{joint}.transmission_rad": design.measured.generated[:, k] for k, joint in enumerate(joints)}
        return {**super().columns(design), "crank_angle_rad": design.crank_angles, **angles}


class _Position(Words):
    def figures(self, design: LinkageDesign) -> list[str]:
        name, value, unit = self._output(design)
        return [f"{name}: {value} {unit}"]

    def rows(self, design: LinkageDesign, outcome: SynthesisResult) -> list[Row]:
        name, value, unit = self._output(design)
        return [(name + design.task.suffix, strong(value), unit, quiet(str(design.task.requirement.value)))]

    def captions(self, design: LinkageDesign) -> list[str]:
        return self.figures(design)

    def columns(self, design: LinkageDesign) -> dict[str, Array]:
        output = {f"generated_{design.task.unit}": design.measured.generated[:, 0]}
        return {**super().columns(design), "crank_angle_rad": design.crank_angles, **output}

    @staticmethod
    def _output(design: LinkageDesign) -> tuple[str, str, str]:
        factor, unit = DISPLAYED[design.task.unit]
        at = math.degrees(design.task.requirement.at.value)
        return f"{design.task.output} at {at:g} deg", number(factor * design.measured.generated[0, 0], 6), unit


WORDS: dict[str, Words] = {
    **{"function": _Law(), "path": _Points(), "motion": _Poses()},
    **{"position": _Position(), "transmission": _Transmission()},
}
"""Words by kind of requirement."""


def words_of(design: LinkageDesign) -> Words:
    """Return the words of the requirement of a design."""
    return WORDS[design.task.requirement.family]


def captions(design: LinkageDesign) -> list[str]:
    """Return the captions of a picture of one requirement of a design, and its worst transmission angle."""
    return [pretty(text) for text in (*words_of(design).captions(design), transmission(design)) if text]


def sentence(design: LinkageDesign) -> str:
    """Return the conclusion of a design: what it achieves of every requirement, with its transmission angle."""
    exact = "the linkage meets every prescribed position exactly"
    clauses = [exact] if design.exact else [words_of(part).achieved(part) for part in design.parts]
    if isinstance(design.fit, PathFit) and design.fit.grade != design.fit.at_points:
        segment = design.fit.segment.replace("-", "−")
        clauses[0] += f", but deviates by up to {figure(1e3 * design.fit.excursion, 'mm')} on the way between {segment}"
    clauses = [*filter(None, clauses)]
    least = transmission(design)
    alone = clauses or [f"the {least.replace('angle', 'angle is')}"] * bool(least)
    text = "; ".join([*clauses, least] if least and clauses else alone)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def measured(design: LinkageDesign) -> tuple[float, str]:
    """Return the measure of the deviations from the targets in its display unit, and that unit."""
    if not design.whole.composed:
        shown = design.task.shown_objective(design.objective)
        return shown.value, shown.unit
    (factor, unit), squared = DISPLAYED[design.task.unit], design.task.measure == "sum of squares"
    return float(design.measured.objective) * (factor**2 if squared else factor), f"{unit}^2" if squared and unit else unit


def measure(design: LinkageDesign) -> str:
    """Return the name of the measure of the deviations, with a note if it is weighted."""
    name = re.sub("^max", f"largest {words_of(design).deviation}", design.measure)
    return name + (", weighted" if design.task.target_points.weights is not None else "")


def transmission(design: LinkageDesign) -> str:
    """Format the worst transmission angle; empty if there is none."""
    low, high = np.degrees(design.transmission_range)
    if not math.isfinite(low):
        return ""
    flat = from_flat(low, high)
    return f"{'largest' if flat else 'smallest'} transmission angle {figure(high if flat else low, 'deg')}{flat}"


def from_flat(low: float, high: float) -> str:
    """Return how far the larger of two transmission angles [deg] is from 180 deg; nothing if the smaller one is the worse."""
    return f", {figure(180.0 - high, 'deg')} from 180°" if low + high > 180.0 + WORSE else ""


def modes(design: LinkageDesign) -> dict[str, str]:
    """Return the assembly modes, by "assembly" and the joint; a four-bar has one mode without a joint."""
    mode = design.assembly
    return {f"assembly {joint}": str(one) for joint, one in mode.items()} if isinstance(mode, dict) else {"assembly": str(mode)}


def rms_of(deviations: Array) -> float:
    """Return the root mean square."""
    return math.sqrt(np.mean(deviations**2))


def decimals(largest: float) -> int:
    """Return the number of decimals for coordinates up to `largest`."""
    size = math.floor(math.log10(largest)) if largest > 0.0 else 0
    return max(0, 7 - size) if size > 4 else min(8, 3 - min(size, 0))


LINKAGE_TOLERANCE = 1e-3  # relative tolerance for equal four-bars


def design_result(outcome: SynthesisResult) -> Summary:
    """Summarise a synthesis result: best design, deviations, active constraints, validation, alternatives, cognates."""
    from optlink.presentation.views.analysis_tables import machine_strokes

    model, best, count = outcome.problem.model, outcome.best, len(outcome.designs)
    if outcome.exact_solutions is not None and outcome.backend == NO_SEARCH:
        words = outcome.exact_solutions.sentence
        verdict = good(words) if outcome.designs else bad(words)
        return summary(model.title, [verdict], exact_solutions(outcome), None if best is None else _sizes(outcome, best))
    if best is None:
        proof = outcome.certificate
        certificate = None if proof is None else certificate_table(proof, model.shown_objective, outcome.seconds)
        remark = "no start could be assembled at all points within the bounds; widen them, or give more starts"
        reason: list[Line] = [*noted(outcome.notes)] or ([] if certified(proof) else [quiet(remark)])
        status: list[Line] = [*refuted_first(outcome), bad("no linkage found"), *reason, *certificate_lines(proof)]
        opposed = conflict(outcome.conflict, outcome.together) if outcome.conflict else None
        return summary(model.title, status, exact_solutions(outcome), opposed, certificate, effort(outcome))
    alone = best.whole.of_cycle
    strokes = None if best.turning is None else machine_strokes(best.turning, best.rotation[1])
    distinct = f"{count} distinct designs verified" if count > 1 else ""
    return search_summary(
        outcome,
        _compared_sizes(outcome, best) if alone else _sizes(outcome, best),
        None if alone or not math.isfinite(best.objective) else _figures(outcome, best),
        (_compared_figures(best) if alone else None, strokes, *(words_of(part).targets(part) for part in best.parts)),
        (
            exact_solutions(outcome),
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
    if design.swing is not None:
        ends = " ... ".join(fixed(math.degrees(end), 2) for end in design.swing)
        rows.append(("crank swings", ends, "deg", quiet("it need not turn fully")))
    unusable = outcome.exact_solutions is not None and not outcome.designs
    return table(NEAREST_DESIGN if unusable or design.status is Status.INFEASIBLE else "Design", "<><<", rows)


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
        rows.append(("least transmission angle", fixed(least, 2), "deg", quiet(remark)))
    figures = design.figures[len(whole.goals) - len(goals) :]
    rows += [(figure.words, number(figure.result, 6), figure.unit, quiet(figure.limit)) for figure in figures]
    return table("Objective", "<><<", rows)


def _compared_sizes(outcome: SynthesisResult, design: LinkageDesign) -> TableSpec:
    """Tabulate the design variables beside their initial values."""
    rows: list[Row] = []
    for name in (*design.whole.free, *design.whole.links):
        quantity = design.whole.quantities[name]
        size, unit = quantity.display
        within = allowed(quantity, design.values[name])
        bounds = quiet(within if quantity.free else ", ".join(filter(None, [quantity.status, within])))
        value, initial = (dimension(one * size) for one in (design.values[name], quantity.value))
        rows.append((name, strong(value), unit, initial, bounds))
    title = NEAREST_DESIGN if outcome.status is Status.INFEASIBLE else "Design"
    return table(title, ["", ">result", "", ">initial", ""], rows)


def _compared_figures(design: LinkageDesign) -> TableSpec:
    """Tabulate the quantities of the machine beside those of the initial one."""
    rows: list[Row] = []
    for one in design.figures:
        shown = change(one.result / one.initial - 1.0 if one.initial and math.isfinite(one.initial) else math.nan)
        values = number(one.initial), strong(number(one.result))
        rows.append((one.words, *values, one.unit, shown, quiet(one.limit)))
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
