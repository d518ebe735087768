"""Conclusion of a design or an analysis: verdict, main figures with their limits, and what limits them, in a sentence or two."""

import math
from collections.abc import Iterable

from optlink.dynamics.columns import efforts
from optlink.presentation.format import degrees, figure, joined, shown, si, why_invalid
from optlink.presentation.views.design_tables import sentence
from optlink.presentation.views.search_tables import clause
from optlink.problem.terms import BACK
from optlink.solvers.solution import LimitState
from optlink.tasks.analyze import Analysis
from optlink.tasks.results.design import LinkageDesign, SynthesisResult, TermFigure
from optlink.validation.check import Check, requirements

NO_BREAK = "\N{NO-BREAK SPACE}"


# --- designs -----------------------------------------------------------------------------------------------------------------


def design(outcome: SynthesisResult, limits: Iterable[LimitState]) -> str:
    """Return the conclusion of a synthesis or of the validation of a given design; `limits` have the shadow prices."""
    best, certified = outcome.best, clause(outcome.certificate)
    if best is None or outcome.conflict:
        return _sentences(achieved(outcome), certified)
    if outcome.valid:
        return _sentences(achieved(outcome, beside_initial=True), _limiting(limits), certified)
    return f"Not valid: {why_invalid(best.validation.checks, best.status.text)}. {achieved(outcome, beside_initial=True)}"


def achieved(outcome: SynthesisResult, *, beside_initial: bool = False) -> str:
    """Return what a design achieves, or why there is none; of a machine also `beside_initial`, the initial design."""
    best = outcome.best
    if best is None or outcome.conflict:
        return shown(outcome.refuted) or none_usable(outcome)
    grid = f"The sizes are on a grid of {outcome.rounding.text}." if outcome.rounding is not None and outcome.valid else ""
    told = _compared(best, beside_initial) if best.whole.of_cycle else _sentences(_optimised(best), sentence(best))
    return _sentences(told, grid)


def none_usable(outcome: SynthesisResult) -> str:
    """Return that no design was found, or that none of the exact ones is usable."""
    exact = outcome.exact_solutions
    if exact is None or not exact.solutions:
        return "No design was found."
    return f"None of the {len(exact.solutions)} {exact.linkage}s that meet the targets exactly is usable."


def _sentences(*sentences: str) -> str:
    return " ".join(filter(None, sentences))


def _optimised(outcome: LinkageDesign) -> str:
    """Return what is minimised or maximised beside targets; empty if only their deviations are."""
    words = [f"{goal.words} {figure(goal.result, goal.unit)}" for goal in _goals(outcome)]
    text = joined(words)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _goals(outcome: LinkageDesign) -> list[TermFigure]:
    return [goal for goal in outcome.figures if goal.limit in ("minimised", "maximised")]


def _compared(outcome: LinkageDesign, beside_initial: bool) -> str:
    """Return the objective of a machine, if asked compared with that of the initial one, and what is required of it."""
    stroke, initial = [bound.name for bound in outcome.whole.required], outcome.initial
    goals = _goals(outcome) or outcome.figures[:1]
    words, feasible = [], initial is not None and initial.valid
    for goal in goals:
        compared = beside_initial and goal.initial and math.isfinite(goal.initial) and (not stroke or feasible)
        change = goal.result / goal.initial - 1.0 if compared else math.nan
        before = f" instead of {figure(goal.initial, goal.unit)} ({100.0 * change:+z.1f} %)" if math.isfinite(change) else ""
        words.append(f"{goal.words} {figure(goal.result, goal.unit)}{before.replace('-', '−')}")
    words += [f"{goal.words} {figure(goal.result, goal.unit)}" for goal in outcome.figures if goal.name in stroke]
    text = joined(words)
    unfair = "" if stroke or feasible or not beside_initial else "; the initial design does not meet the limits"
    return f"{text[:1].upper()}{text[1:]}{unfair}."


def motions(checks: Iterable[Check]) -> list[str]:
    """Return the strokes and swings that a file requires, as a design has them."""
    required = (one for one in requirements(checks) if one.name.startswith(("stroke of ", "swing angle")))
    return [f"{one.name} {figure(one.value, one.unit)}" for one in required]


def _limiting(limits: Iterable[LimitState]) -> str:
    """Name the active constraint with the largest effect of one unit, and count the others."""
    active = [limit for limit in limits if limit.active]
    if not active:
        return ""
    first = max(active, key=lambda limit: limit.effect)
    bound = f"{first.sense} {figure(first.bound, first.unit)}".strip()
    others = len(active) - 1
    more = f"; {others} more limits are active" if others > 1 else "; one more limit is active" * others
    bound = bound.replace("<=", "≤").replace(">=", "≥").replace(" ", NO_BREAK)
    return f"Active limit: {first.name} ({bound}){more}."


BARS = {4: "four-bar", 5: "five-bar", 6: "six-bar", 8: "eight-bar"}


def machine(cycle: Analysis) -> str:
    """Return what a machine is: its links with the frame, its sliders, its drive."""
    mechanism, driving = cycle.machine.mechanism, cycle.problem.model.driving
    bars, slides = len(mechanism.bodies) + 1, len(mechanism.guides)
    sliders = "" if not slides else " with a slider" if slides == 1 else f" with {slides} sliders"
    drive = f"the {driving.coordinate}" if driving.ends is not None else "laws of its drives" if mechanism.drives else "its crank"
    limits = mechanism.limits
    moves = f"swings between {' and '.join(map(degrees, limits))}" if limits else "turns fully" * cycle.ranges.full
    turning = f", which {moves}" if moves and not mechanism.drives else ""
    plain = bars in BARS and not mechanism.cylinders
    kind = (
        f"{BARS[bars]} linkage"
        if plain
        else "linkage with one moving body"
        if bars == 2
        else f"linkage with {bars - 1} moving bodies"
    )
    text = f"{kind}{sliders}, driven by {drive}{turning}"
    return f"{text[0].upper()}{text[1:]}"


# --- machines ----------------------------------------------------------------------------------------------------------------


def analysis(outcome: Analysis) -> str:
    """Return the conclusion of an analysis: drive torque, largest reaction, strokes."""
    extremes, words, driving = outcome.extremes, [], outcome.problem.model.driving
    for effort in efforts(outcome.machine.mechanism):
        extreme = extremes.get(effort.column)
        if extreme is not None and max(abs(extreme.least), abs(extreme.largest)) > 0.0:
            low = abs(extreme.least) > abs(extreme.largest)
            value, at = (extreme.least, extreme.least_at) if low else (extreme.largest, extreme.largest_at)
            place = f"{driving.noun} of {figure(driving.shown(at), driving.unit)}"
            place += BACK * outcome.extremes.on_way_back(effort.column)[0 if low else 1]
            drive = f"the drive {effort.drive}" if effort.drive else "the drive"
            words.append(f"{drive} needs up to {si(abs(value), effort.unit)} (at a {place})")
    pins = extremes.select(name for name in extremes if name.endswith(".f_N"))
    forces = {name.removesuffix(".f_N"): extreme.largest for name, extreme in pins.items()}
    if max(forces.values(), default=0.0) > 0.0 and not outcome.unbounded:
        pin = max(forces, key=lambda name: forces[name])
        words.append(f"the largest joint reaction is {si(forces[pin], 'N')} at {pin.replace('.', ' on ')}")
    if not words:
        word, unit, travels = ("stroke", "m", outcome.strokes) if outcome.strokes else ("swing", "rad", outcome.swings)
        words = [f"the {word} of {name} is {si(travel.span, unit)}" for name, travel in list(travels.items())[:2]]
    text = joined(words) if words else "the motion was computed"
    if not outcome.valid:
        text = f"not every position has finite reactions ({outcome.status}); {text}"
    turn = "" if outcome.ranges.complete else " The crank cannot turn fully."
    return f"{text[:1].upper()}{text[1:]}.{turn}"


# --- studies -----------------------------------------------------------------------------------------------------------------
