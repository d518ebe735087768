"""Tables, charts and page of a control comparison: deviation under each control, several starts."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from optlink.presentation.chart_spec import (
    BODIES,
    COUPLER,
    CRANK,
    MUTED,
    RESULT,
    ROCKER,
    TARGET,
    Array,
    Axis,
    Band,
    ChartSpec,
    Curve,
    Line,
    Panel,
    max_abs,
)
from optlink.presentation.format import fixed, scale, si
from optlink.presentation.table_spec import Inline, Paragraph, Row, Summary, bad, good, summary, table
from optlink.presentation.view import PageSection, StoredStudy, View
from optlink.presentation.views.revolutions import FULL, RevolutionCurves, fold
from optlink.tasks.results.clearance import ClearanceSimulation, Comparison, Tuning
from optlink.units import DISPLAYED, count_noun, percent


def charts(comparison: Comparison) -> list[ChartSpec]:
    """Return the charts of a control comparison, of the kinds whose runs finished; those of single runs where these are known."""
    finished = {name: runs for name, runs in comparison.trials.items() if runs.finished}
    examples = {name: run for name, run in comparison.examples.items() if name in finished}
    return [*compensation(examples), *([trials(replace(comparison, trials=finished))] if finished else [])]


def _mean_revolution(turns: RevolutionCurves, values: Array) -> tuple[Array, Array, Array, Array]:
    """Return crank angles [deg] and the mean, least and largest values over the revolutions after the running-in."""
    count = max(1, min(turns.whole // turns.points, turns.last - turns.begin + 1))
    rows = slice(turns.whole - count * turns.points, turns.whole)
    table = values[rows].reshape(count, turns.points)
    numbers = np.arange(turns.last - count, turns.last)[:, None]
    angles = np.mean(turns.angle[rows].reshape(count, turns.points) - turns.direction * FULL * numbers, axis=0)
    before = angles[-1] - turns.direction * FULL
    mean, least, largest = (of(np.column_stack([table[:, -1], table]), axis=0) for of in (np.mean, np.min, np.max))
    return np.concatenate([[before], angles]), mean, least, largest


def _standstills(turns: RevolutionCurves) -> list[float]:
    """Return the crank angles [deg] at which the ideal output reverses, where crank corrections have no effect."""
    angles, ideal, _, _ = _mean_revolution(turns, turns.output - turns.error)
    if turns.advance:
        return []
    slope, at = np.diff(ideal), 0.5 * (angles[1:] + angles[:-1])
    turned = np.flatnonzero(slope[:-1] * slope[1:] < 0.0)
    places = at[turned] + (at[turned + 1] - at[turned]) * slope[turned] / (slope[turned] - slope[turned + 1])
    return sorted(float(place) % FULL for place in places)


def compensation(results: Mapping[str, ClearanceSimulation]) -> list[ChartSpec]:
    """Plot the deviation over the crank angle under several kinds of control, and the corrections of the crank command."""
    every = {name: RevolutionCurves(result) for name, result in results.items()}
    every = {name: turns for name, turns in every.items() if turns and turns.last}
    if not every:
        return []
    first = next(iter(every.values()))
    means = {name: _mean_revolution(turns, turns.error) for name, turns in every.items()}
    shown = first.shares(max(max_abs(np.array(mean[1:])) for mean in means.values()))
    colours = dict(zip(every, (MUTED, COUPLER, BODIES[2], ROCKER, *BODIES[3:]), strict=False)) | {"none": TARGET}
    before = every["none"].rms if "none" in every else None
    deviations: list[Curve | Band] = []
    corrections: list[Curve | Band] = []
    for name, turns in every.items():
        gain = "" if name == "none" or not before else f" ({percent(turns.rms / before - 1.0, 0, signed=True)})".replace("-", "−")
        label = f"{_kind(name)}: RMS {turns.rms * shown.factor:.4g} {shown.unit}{gain}"
        deviations += _mean_with_range(means[name], shown.factor, label, colours[name], f"mean {name}")
        if turns.result.figures["correction_max_rad"] > 0.0:
            correction = _mean_revolution(turns, turns.result["command.correction_rad"])
            corrections += _mean_with_range(correction, math.degrees(1.0), "", colours[name], f"correction {name}")
    panels = [Panel(Axis(f"deviation of {first.result.output.name} [{shown.unit}]"), deviations, 1.5)]
    if corrections:
        panels.append(Panel(Axis("correction of the\ncrank's command [deg]"), corrections))
    lines = [
        Line(at, "" if k else "the output reverses", MUTED, 1.0, gid="standstill") for k, at in enumerate(_standstills(first))
    ]
    rpm = f"{abs(first.result.speed) * 30.0 / math.pi:.5g} rpm{'' if first.direction > 0.0 else ' clockwise'}"
    heading = f"{first.result.problem.model.title}: kinds of control\n{rpm}, means of {first.counted}"
    heading += ", shaded from least to largest" if first.shown > 1 else ""
    title = "Compensation of the clearance"
    return [ChartSpec("compensation", title, panels, first.crank_axis, heading, lines=lines, cursor=False, width=8.4)]


def _kind(name: str) -> str:
    return "no control" if name == "none" else name


def _mean_with_range(
    statistics: tuple[Array, Array, Array, Array], factor: float, name: str, colour: str, gid: str
) -> list[Curve | Band]:
    """Return the mean over the revolutions as a curve on the band from the least to the largest value."""
    angles, *values = statistics
    x, mean = fold(angles, values[0] * factor)
    low, high = (fold(angles, row * factor)[1] for row in values[1:])
    return [Band(x, low, high, "", colour, 0.12), Curve(x, mean, name, colour, 1.6, legend=bool(name), gid=gid)]


def trials(comparison: Comparison) -> ChartSpec:
    """Plot the RMS and peak deviation of every start under each kind of control, and their means."""
    kinds = list(comparison.trials)
    shown = scale(float(max(np.max(runs.peak) for runs in comparison.trials.values())), "m" if comparison.unit == "m" else "deg")
    curves = []
    for k, (name, runs) in enumerate(comparison.trials.items(), 1):
        for values, colour, word, off in ((runs.rms, RESULT, "root mean square", -0.12), (runs.peak, CRANK, "peak", 0.12)):
            dots = partial(Curve, mode="markers", size=5.0, opacity=0.55, text=[_kind(name)] * len(values), gid=word)
            curves.append(dots(values * shown.factor, np.full(len(values), k + off), word, colour, legend=k == 1))
        ends = np.array([k - 0.34, k + 0.1])
        curves.append(Curve(np.full(2, runs.mean * shown.factor), ends, "mean", TARGET, legend=k == 1, gid="mean"))
    y = Axis("", (0.4, len(kinds) + 0.6), reversed=True, ticks=[(float(k), _kind(name)) for k, name in enumerate(kinds, 1)])
    furthest = max(np.max(curve.x) for curve in curves)
    x = Axis(f"deviation [{shown.unit}]", (0.0, 1.05 * furthest))
    count = f"{_revolutions(comparison)} from each of {count_noun(len(comparison.starts), 'start')}"
    heading = f"{comparison.problem.model.title}: kinds of control\n{count}"
    panel = Panel(y, curves, 0.27 * len(kinds) + 0.3)
    return ChartSpec("trials", f"Deviation under each kind of control, {count}", [panel], x, heading, cursor=False)


# --- the page ---------------------------------------------------------------------------------------------------------------


def page(comparison: Comparison) -> StoredStudy:
    """Return the page of a control comparison."""
    shown = overview(comparison)
    return StoredStudy(
        problem=comparison.problem,
        kind="comparison of control",
        verdict="Finished" if comparison.valid else "Not every run was finished",
        valid=comparison.valid,
        conclusion=conclusion(comparison),
        status=shown.status.lines,
        sections=[PageSection("Figures", (shown.parts,)), PageSection("Charts", charts(comparison))],
        by=f"event-driven integration from {len(comparison.starts)} crank angles, seed {comparison.seed}",
    )


def _revolutions(outcome: Comparison | Tuning) -> str:
    return count_noun(outcome.revolutions, "revolution")


def overview(outcome: Comparison) -> Summary:
    """Tabulate all kinds of control of a comparison."""
    factor, displayed = DISPLAYED[outcome.unit]
    count = len(outcome.starts)
    starts = "one crank angle at the start" if count == 1 else f"each of {count} crank angles at the start"
    status: list[Inline] = [f"{_revolutions(outcome)} from {starts} (seed {outcome.seed})"]
    rows: list[Row] = []
    for kind, trials in outcome.trials.items():
        gain = math.nan if kind == "none" or "none" not in outcome.trials else outcome.gain(kind)
        effort, torque = math.degrees(np.mean(trials.correction)), float(np.mean(trials.torque))
        sizes = [fixed(value * factor, 4) for value in (trials.mean, trials.scatter, np.max(trials.peak))]
        row = [kind, *sizes, percent(gain) if math.isfinite(gain) else "", fixed(effort, 3), fixed(torque, 3)]
        rows.append([*row] if trials.finished else [bad(cell) for cell in row])
        if trials.stalled:
            status.append(bad(f"Stalled: {trials.stalled} of {count} runs with control {kind}, which therefore has no mean"))
    columns = ["control", f">rms\n[{displayed}]", ">scatter", ">peak", ">gain", ">crank\n[deg]", ">torque\n[N m]"]
    title = "Deviation of the output, and effort of the control: rms of correction and torque"
    return summary(outcome.problem.model.title, status, table(title, columns, rows))


def tuning(outcome: Tuning) -> Summary:
    """Summarise a search for controller parameters and its best set."""
    factor, displayed = DISPLAYED[outcome.unit]
    starts = "one crank angle" if outcome.starts == 1 else f"each of {outcome.starts} crank angles"
    runs = f"{_revolutions(outcome)} from {starts} at the start (seed {outcome.seed})"
    stopped = int(np.sum(~np.isfinite(outcome.costs)))
    tried = f"{len(outcome.costs)} parameter sets tried"
    tried += f", {stopped} of them stalled or stopped early as worse" if stopped else ""
    rows = [("parameters of the problem", fixed(outcome.before * factor, 4))]
    failed = bad("No result: with every parameter set, that of the problem too, a run stalled")
    lines = ["No parameter set is better than that of the problem, which is kept" if outcome.valid else failed]
    if outcome.best:
        rows.append(("best parameters", fixed(outcome.cost * factor, 4)))
        rows.append(("scatter between starts", fixed(outcome.scatter * factor, 4)))
        lines = [good("Use them: " + " ".join(f'--set control.{name}="{value}"' for name, value in outcome.best.items()))]
        if outcome.check is not None:
            before, best = outcome.check
            rows.append(("from other starts: parameters of the problem", fixed(before.mean * factor, 4)))
            rows.append(("from other starts: best parameters", fixed(best.mean * factor, 4)))
            rows.append(("from other starts: scatter", fixed(best.scatter * factor, 4)))
            if not (best.mean < before.mean or math.isnan(before.mean)):
                lines = [bad("The best parameters are not better from other starts: the gain is an accident of these starts")]
            elif before.mean - best.mean < 2.0 * best.scatter:
                lines.append(bad("Note: the gain from other starts is less than twice the scatter; check it with more starts"))
    costs = table("Mean root mean square of the deviation", ["", f">{displayed}"], rows)
    return summary(outcome.problem.model.title, [f"{outcome.control}: {runs}", tried], costs, Paragraph(*lines))


def conclusion(result: Comparison) -> str:
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


VIEW = View(overview, charts=charts, page=page)
TUNING = View(tuning, no_page="Read the best parameters in it, under best")
