"""Tables of simulations with joint clearance and of control comparisons."""

import math
from collections.abc import Iterator

import numpy as np

from optlink.report.format import fixed, number
from optlink.report.table_spec import Line, Paragraph, Row, Summary, TableSpec, bad, good, noted, quiet, summary, table, verdict
from optlink.tasks.results.clearance import ClearanceSimulation
from optlink.tasks.results.control_comparison import Comparison, Tuning
from optlink.units import DISPLAYED, percent


def simulation(outcome: ClearanceSimulation) -> Summary:
    """Summarise a simulation with clearance: deviation, contacts, drive, energy account and predictability."""
    title = outcome.problem.model.title
    if not outcome.revolutions:
        return summary(title, _status(outcome))
    remark = f"Tolerance {outcome.tolerance:g}{', compiled integrator' if outcome.integrator == 'compiled' else ''}"
    if outcome.sample_time is not None:
        remark += f", controller sampled every {outcome.sample_time * 1e3:.6g} ms"
    measured = _measured(outcome) if outcome.measured else None
    parts = _error(outcome), measured, _contacts(outcome), _account(outcome), Paragraph(quiet(remark), appendix=True)
    return summary(title, _status(outcome), *parts)


def _status(outcome: ClearanceSimulation) -> Iterator[Line]:
    rpm = outcome.speed * 30.0 / math.pi
    sense = "" if rpm > 0.0 else ", clockwise"
    free = outcome.problem.model.drive.torque is not None
    drive = "under a torque; a revolution counts as one of" if free else f"control: {outcome.control};"
    yield verdict(outcome.ending.value, outcome.finished), f", {outcome.message}; {drive} {abs(rpm):.6g} rpm{sense}"
    predicted = outcome.prediction
    if predicted is not None and not predicted.chaotic and predicted.watched:
        turns = "revolution" if predicted.watched == 1 else "revolutions"
        yield f"Predictable: runs at two tolerances agree over the {predicted.watched} {turns} compared"
    yield from noted(outcome.notes)


def _error(outcome: ClearanceSimulation) -> TableSpec:
    figures, unit = outcome.figures, outcome.output.unit
    factor, displayed = DISPLAYED[unit]
    last, counted = outcome.revolutions, int(figures["settled_revolutions"]) or outcome.revolutions
    first = last - counted + 1
    span = f"revolutions {first} ... {last}" if last > first else f"revolution {last}"
    rows = [
        ("root mean square", fixed(figures[f"rms_{unit}"] * factor, 6), displayed),
        ("mean square", number(figures[f"mean_square_{unit}2"] * factor * factor), f"{displayed}^2"),
        ("largest", fixed(figures[f"peak_{unit}"] * factor, 6), displayed),
    ]
    rms = outcome.per_revolution[f"rms_{unit}"][-counted:]
    if len(rms) > 1:
        rows.append(("scatter between revolutions", f"{np.std(rms) * factor:.2g}", displayed))
    return table(f"Deviation of {outcome.output.name} from the machine without clearance, {span}", "<><", rows)


def _measured(outcome: ClearanceSimulation) -> TableSpec:
    figures, unit = outcome.figures, outcome.output.unit
    factor, displayed = DISPLAYED[unit]
    rows = [
        (words, *(fixed(figures[f"{name}.{what}_{unit}"] * factor, 4) for what in ("rms", "peak", "mean")))
        for words, name in (("the simulation", "measured"), ("the machine without clearance", "measured.ideal"))
    ]
    title = f"Measured {outcome.output.name}, {int(figures['measured.rows'])} rows: difference from"
    return table(title, ["", f">rms\n[{displayed}]", ">largest", ">mean"], rows)


def _contacts(outcome: ClearanceSimulation) -> TableSpec:
    figures = outcome.figures
    rows = []
    for gap in outcome.gaps:
        count = str(int(figures[f"{gap.point}.contacts"]))
        share = percent(float(np.mean(outcome.per_revolution[f"{gap.point}.contact_share"])))
        most = number(figures[f"{gap.point}.normal_max_N"], 5), fixed(figures[f"{gap.point}.penetration_max_m"] * 1e6, 2)
        rows.append((gap.point, gap.journal, gap.bearing, number(gap.clearance * 1e3), count, share, *most))
    columns = ["joint", "journal", "bearing", ">gap\n[mm]", ">contacts", ">share", ">force\n[N]", ">depth\n[µm]"]
    return table("Contacts of all revolutions: share of the time, largest force and penetration", columns, rows)


def _account(outcome: ClearanceSimulation) -> TableSpec:
    figures = outcome.figures
    rows = [
        ("torque, root mean square", number(figures["torque_rms_Nm"]), "N m"),
        ("torque, largest", number(figures["torque_max_Nm"]), "N m"),
    ]
    if figures["correction_max_rad"] > 0.0:
        rms, most = (math.degrees(figures[name]) for name in ("correction_rms_rad", "correction_max_rad"))
        rows.append(("correction, root mean square", fixed(rms, 4), f"deg, largest {most:.4g} deg"))
    for name in [key for key in figures if key.endswith(".work_J")]:
        what, _, _ = name.rpartition(".")
        words = {"drive": "work of the drive"}.get(what, f"work of {what}")
        point, _, kind = what.rpartition(".")
        if point:
            words = f"lost at {point} {'in the contact' if kind == 'impact' else 'by friction'}"
        rows.append((words, number(figures[name]), "J"))
    share = figures["imbalance_J"] / figures["largest_energy_J"] if figures["largest_energy_J"] > 0.0 else 0.0
    rows.append(("largest imbalance during the run", f"{figures['imbalance_J']:.1e}", f"J, {share:.1e} of the largest energy"))
    return table("Drive and energy account", "<><", rows)


def comparison(outcome: Comparison) -> Summary:
    """Tabulate all kinds of control of a comparison."""
    factor, displayed = DISPLAYED[outcome.unit]
    count = len(outcome.starts)
    starts = "one crank angle at the start" if count == 1 else f"{count} crank angles at the start"
    status: list[Line] = [f"{outcome.revolutions} revolutions from each of {starts} (seed {outcome.seed})"]
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
    starts = "one crank angle" if outcome.starts == 1 else f"{outcome.starts} crank angles"
    runs = f"{outcome.revolutions} revolutions from each of {starts} at the start (seed {outcome.seed})"
    stopped = int(np.sum(~np.isfinite(outcome.costs)))
    tried = f"{len(outcome.costs)} parameter sets tried"
    tried += f", {stopped} of them stalled or stopped early as worse" if stopped else ""
    rows = [("parameters of the problem", fixed(outcome.before * factor, 4))]
    failed = bad("No result: with every parameter set, that of the problem too, a run stalled")
    lines = ["No parameter set is better than that of the problem, which is kept" if outcome.finished else failed]
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
