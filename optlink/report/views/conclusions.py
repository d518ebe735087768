"""Conclusion of every kind of result: verdict, main figures with their limits, and what limits them, in one or two sentences."""

import math
import re
from collections.abc import Iterable

import numpy as np

from optlink.linkage.vector2d import TURN
from optlink.report.causes import why_invalid
from optlink.report.format import figure, joined, pretty, si
from optlink.report.views import study_tables
from optlink.report.views.certificate_view import clause
from optlink.report.views.design_words import sentence
from optlink.solvers.solution import LimitState
from optlink.studies.pareto.epsilon_constraint import Pareto
from optlink.studies.sensitivity import Sensitivities
from optlink.studies.sweep import Sweep
from optlink.studies.tolerance.analysis import Tolerance
from optlink.tasks.analyze import Analysis
from optlink.tasks.results.balance import Balance
from optlink.tasks.results.clearance import ClearanceSimulation
from optlink.tasks.results.control_comparison import Comparison
from optlink.tasks.results.design import LinkageDesign, SynthesisResult, TermFigure
from optlink.tasks.simulate import Simulation
from optlink.units import percent

NO_BREAK = "\N{NO-BREAK SPACE}"
ROUNDING = 1e-9  # share of the initial value below which the remainder is rounding error


# --- designs -----------------------------------------------------------------------------------------------------------------


def design(outcome: SynthesisResult, limits: Iterable[LimitState]) -> str:
    """Return the conclusion of a synthesis or of the validation of a given design; `limits` have the shadow prices."""
    best, certified = outcome.best, clause(outcome.certificate)
    if best is None or outcome.conflict:
        return _sentences(shown(outcome.refuted) or "No design was found.", certified)
    achieved = _compared(best) if best.whole.of_cycle else _sentences(_optimised(best), sentence(best))
    if outcome.valid:
        return _sentences(achieved, _limiting(limits), certified)
    return f"Not valid: {why_invalid(best.validation.checks, best.status.text)}. {achieved}"


def shown(text: str) -> str:
    """Write the units and relations in a sentence with their signs, as the values of a page have them."""
    return re.sub(r"(?<=\d) deg\b", "°", pretty(text))


def _sentences(*sentences: str) -> str:
    return " ".join(filter(None, sentences))


def _optimised(outcome: LinkageDesign) -> str:
    """Return what is minimised or maximised beside targets; empty if only their deviations are."""
    words = [f"{goal.words} {figure(goal.result, goal.unit)}" for goal in _goals(outcome)]
    text = joined(words)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _goals(outcome: LinkageDesign) -> list[TermFigure]:
    return [goal for goal in outcome.figures if goal.limit in ("minimised", "maximised")]


def _compared(outcome: LinkageDesign) -> str:
    """Return the objective of a machine, compared with that of the initial one, and what is required of it."""
    stroke, initial = [bound.name for bound in outcome.whole.required], outcome.initial
    goals = _goals(outcome) or outcome.figures[:1]
    words, feasible = [], initial is not None and initial.valid
    for goal in goals:
        compared = goal.initial and math.isfinite(goal.initial) and (not stroke or feasible)
        change = goal.result / goal.initial - 1.0 if compared else math.nan
        before = f" instead of {figure(goal.initial, goal.unit)} ({100.0 * change:+z.1f} %)" if math.isfinite(change) else ""
        words.append(f"{goal.words} {figure(goal.result, goal.unit)}{before.replace('-', '−')}")
    words += [f"{goal.words} {figure(goal.result, goal.unit)}" for goal in outcome.figures if goal.name in stroke]
    text = joined(words)
    unfair = "" if stroke or feasible else "; the initial design does not meet the limits"
    return f"{text[:1].upper()}{text[1:]}{unfair}."


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


def sensitivities(result: Sensitivities) -> str:
    """Return the conclusion of a sensitivity analysis."""
    if not result.displayed.moving:
        return "No prescribed value has an effect on this optimum, to first order."
    first = result.displayed.moving[0]
    base, factor, *_ = result.problem.model.shown_objective(result.solution.objective)
    step = study_tables.step(first).replace(" deg", "°")
    change = percent(factor * first.effect / base, 2, signed=True) if base else figure(first.effect, result.unit)
    return f"The optimum reacts most to {first.parameter.name}: {step} more changes the objective by {change.replace('-', '−')}."


# --- machines ----------------------------------------------------------------------------------------------------------------


def analysis(outcome: Analysis) -> str:
    """Return the conclusion of an analysis: drive torque, largest reaction, strokes."""
    extremes, words = outcome.extremes, []
    torque = extremes.get("input.torque_Nm")
    if torque is not None and max(abs(torque.least), abs(torque.largest)) > 0.0:
        low = abs(torque.least) > abs(torque.largest)
        value, at = (torque.least, torque.least_at) if low else (torque.largest, torque.largest_at)
        words.append(f"the drive needs up to {si(abs(value), 'N m')} (at a crank angle of {figure(math.degrees(at), 'deg')})")
    pins = extremes.select(name for name in extremes if name.endswith(".f_N"))
    forces = {name.removesuffix(".f_N"): extreme.largest for name, extreme in pins.items()}
    if max(forces.values(), default=0.0) > 0.0 and not outcome.unbounded:
        pin = max(forces, key=lambda name: forces[name])
        words.append(f"the largest joint reaction is {si(forces[pin], 'N')} at {pin.replace('.', ' on ')}")
    if not words:
        word, unit, travels = ("stroke", "m", outcome.strokes) if outcome.strokes else ("swing", "rad", outcome.swings)
        words = [f"the {word} of {name} is {si(travel.span, unit)}" for name, travel in list(travels.items())[:2]]
    text = joined(words) if words else "the motion was computed"
    if not outcome.sound:
        text = f"not every position has finite reactions ({outcome.status}); {text}"
    turn = "" if outcome.full else " The crank cannot turn fully."
    return f"{text[:1].upper()}{text[1:]}.{turn}"


def simulation(result: Simulation) -> str:
    """Return the conclusion of a simulation in time."""
    figures = result.figures
    speed, time = figures["end.speed_rad_s"] * 30.0 / math.pi, figures["end.time_s"]
    turns = figures["end.crank_angle_rad"] / TURN
    text = f"After {figure(time, 's')} the crank turns at {figure(speed, 'rpm')}, "
    text += f"{figure(turns)} revolutions from its zero position"
    if "last_turn.fluctuation" in figures:
        last = "cycle" if "last_turn.revolutions" in figures else "revolution"
        text += f"; its speed fluctuates by {100.0 * figures['last_turn.fluctuation']:z.2f} % in the last {last}"
    if "input.work_J" in figures:
        text += f"; the drive has done {si(figures['input.work_J'], 'J')} of work"
    return f"{text}." if result.finished else f"Not finished: {result.ending.text}. {text}."


def clearance(result: ClearanceSimulation) -> str:
    """Return the conclusion of a simulation with joint clearance."""
    if not result.revolutions:
        return f"No complete revolution was simulated: {result.message}."
    unit, figures = result.output.unit, result.figures
    text = f"Joint clearance makes the {result.output.name} deviate by {si(figures[f'rms_{unit}'], unit)} (root mean square), "
    text += f"at most {si(figures[f'peak_{unit}'], unit)}"
    counted = int(figures["settled_revolutions"])
    last = {gap.point: np.max(result.per_revolution[f"{gap.point}.normal_max_N"][-counted:]) for gap in result.gaps}
    point = max(last, key=lambda name: last[name])
    first = max(figures[f"{gap.point}.normal_max_N"] for gap in result.gaps)
    text += f"; the contact force reaches {si(last[point], 'N')} at {point}"
    text += f" ({si(first, 'N')} while it runs in)." if first > last[point] else "."
    return text if result.finished else f"Not finished: {result.message}. {text}"


def comparison(result: Comparison) -> str:
    """Return the conclusion of a control comparison: the best control, and its gain."""
    finished = {name: trials for name, trials in result.trials.items() if trials.finished}
    if not finished:
        return "No controller completed its runs."
    best = min(finished, key=lambda name: finished[name].mean)
    tail = "" if len(finished) == len(result.trials) else " Not every run was completed."
    if best == "none":
        rms = si(finished[best].mean, result.unit)
        return f"Best without control: root mean square deviation {rms}; every controller that completed increases it.{tail}"
    less = ""
    if "none" in finished:
        less = f", {100.0 * (1.0 - finished[best].mean / finished['none'].mean):z.1f} % less than without control"
    rms, peak = (si(value, result.unit) for value in (finished[best].mean, np.max(finished[best].peak)))
    return f"The best control is {best}: root mean square deviation {rms}{less}; peak {peak}.{tail}"


def balance(result: Balance) -> str:
    """Return the conclusion of a balancing: change of the objective, and active limits."""
    if result.conflict:
        return shown(result.refuted)
    if not result.rows:
        return "No balancing was found."
    left = result.objective if abs(result.objective) > ROUNDING * abs(result.before) else 0.0
    mass = sum(counterweight.mass for counterweight in result.added)
    text = f"The {result.measure} decreases by {100.0 * result.reduction:.4g} % to {figure(left, result.unit or '')}"
    text = text.rstrip() + f" with {figure(mass, 'kg')} of counterweights"
    active = [limit.name for limit in result.limits if limit.active]
    limiting = f" Active limits: {joined(active[:3])}." if active else ""
    return f"{text}.{limiting}" if result.valid else f"Not valid. {text}.{limiting}"


# --- studies -----------------------------------------------------------------------------------------------------------------


def sweep(result: Sweep) -> str:
    """Return the conclusion of a sweep: number of valid points, and the best of them."""
    total = result.grid.count
    if result.evaluated or result.best is None:
        done = result.statuses.get("analysed", result.valid) if result.evaluated else result.valid
        tail = "" if result.evaluated else " No point has a valid design: relax the limits or change the range."
        return f"{done:,} of {total:,} points have valid results.{tail}"
    name = next(column for column in result.best if column.startswith("objective"))
    _, _, unit = name.partition("_")
    where = [f"{axis.key} = {figure(float(result.best[axis.column]), axis.unit)}" for axis in result.grid.axes]
    value = figure(float(result.best[name]), unit.replace("2", "²"))
    extreme = "largest" if result.problem.model.objective_display[0] < 0.0 else "least"
    verified = f"{result.valid:,} of {total:,} points have a verified design"
    active = str(result.best.get("active", ""))
    limits = f" Active limits of the best: {active}." if active else ""
    return f"The objective is {extreme}, {value}, at {joined(where)}; {verified}.{limits}"


def pareto(result: Pareto) -> str:
    """Return the conclusion of a Pareto front: ranges of the objectives, and the knee."""
    if not result.points:
        return "No point of the front has a verified design: relax the limits or widen the ranges of the objectives."
    if result.single_point:
        return f"{result.single_point}."
    spans = []
    for k, objective in enumerate(result.objectives):
        values = [point.values[k] for point in result.points]
        spans.append(f"{objective.name} {figure(min(values))} ... {figure(max(values), objective.unit)}")
    text = f"{len(result.points)} verified designs trade {' against '.join(spans)}."
    if result.knee is not None:
        at = result.points[result.knee[0]].values
        knee = joined(
            [f"{objective.name} {figure(value, objective.unit)}" for objective, value in zip(result.objectives, at, strict=True)]
        )
        text += f" The knee of the front is point {result.knee[0] + 1}: {knee}."
    return text if result.complete else f"{text} Not every point is verified."


def tolerance(result: Tolerance) -> str:
    """Return the conclusion of a tolerance analysis: yield or worst case, and the tolerance with the largest share."""
    k, unit, sampled, shares = (
        result.scale,
        result.display_unit,
        result.monte_carlo,
        100.0 * result.contributions[:, result.where],
    )
    part = int(np.argmax(shares))
    most = f"{result.deviations[part].name} contributes {shares[part]:.3g} % of the variance"
    if sampled is not None and result.limit is not None:
        low, high = sampled.interval
        text = f"{100.0 * sampled.share:.4g} % of the linkages stay within the limit of ±{figure(k * result.limit, unit)} "
        text += f"(95 % confidence: {100.0 * low:.4g} ... {100.0 * high:.4g} %)"
    else:
        worst = float(np.max(np.abs(result.worst)))
        text = f"The tolerances change {result.nominal.name} by at most ±{figure(k * worst, unit)} in the worst case"
    if result.allocation is not None and not result.allocation.achieved:
        text = f"The allocated tolerances do not keep the yield of {100.0 * result.allocation.target_yield:.4g} %. {text}"
    return f"{text}; {most}."
