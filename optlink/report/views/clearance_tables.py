"""Terminal tables of simulations with joint clearance and of control comparisons."""

from __future__ import annotations

import math

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, fixed, grid, number
from optlink.tasks.control_comparison import Comparison, Tuning
from optlink.tasks.results.clearance import ClearanceSimulation

TO_DISPLAY = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "deg")}


def simulation(outcome: ClearanceSimulation) -> RenderableType:
    """Summarise a simulation with clearance: deviation, contacts, drive, energy account and predictability."""
    title = Text(outcome.problem.model.title, style=HEAD)
    title.append(f"\n{outcome.ending.value}", style=GOOD if outcome.finished else BAD)
    rpm = outcome.speed * 30.0 / math.pi
    sense = "" if rpm > 0.0 else ", clockwise"
    free = outcome.problem.model.drive.torque is not None
    drive = "under a torque; a revolution counts as one of" if free else f"control: {outcome.control};"
    title.append(f", {outcome.message}; {drive} {abs(rpm):.6g} rpm{sense}")
    predicted = outcome.prediction
    if predicted is not None and not predicted.chaotic and predicted.watched:
        turns = "revolution" if predicted.watched == 1 else "revolutions"
        title.append(f"\nPredictable: runs at two tolerances keep together for the {predicted.watched} {turns} that were watched")
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    if not outcome.revolutions:
        return title
    return Group(title, Text(), _error(outcome), Text(), _contacts(outcome), Text(), _account(outcome), Text(), _tail(outcome))


def _error(outcome: ClearanceSimulation) -> Table:
    found, unit = outcome.figures, outcome.output.unit
    factor, displayed = TO_DISPLAY[unit]
    first, last = outcome.revolutions - int(found["settled_revolutions"]) + 1, outcome.revolutions
    span = f"revolutions {first} ... {last}" if last > first else f"revolution {last}"
    table = grid(
        f"Deviation of {outcome.output.name} from the machine without clearance, {span}",
        [("", "left"), ("", "right"), ("", "left")],
    )
    table.add_row("root mean square", fixed(found[f"rms_{unit}"] * factor, 6), displayed)
    table.add_row("mean square", number(found[f"mean_square_{unit}2"] * factor * factor), f"{displayed}^2")
    table.add_row("largest", fixed(found[f"peak_{unit}"] * factor, 6), displayed)
    rms = outcome.turns[f"rms_{unit}"][-int(found["settled_revolutions"]) :]
    if len(rms) > 1:
        table.add_row("scatter between revolutions", f"{float(np.std(rms)) * factor:.2g}", displayed)
    return table


def _contacts(outcome: ClearanceSimulation) -> Table:
    columns = [("joint", "left"), ("journal", "left"), ("bearing", "left"), ("gap mm", "right"), ("contacts", "right")]
    columns += [("share", "right"), ("force N", "right"), ("depth um", "right")]
    table = grid("Contacts: share of the time, largest force and penetration", columns, header=True)
    for k, gap in enumerate(outcome.gaps):
        own = [impact for impact in outcome.impacts if impact.gap == k]
        table.add_row(
            gap.point,
            gap.journal,
            gap.bearing,
            number(gap.clearance * 1e3),
            str(len(own)),
            f"{float(np.mean(outcome.turns[f'{gap.point}.contact_share'])):.1%}",
            number(outcome.figures[f"{gap.point}.normal_max_N"], 5),
            fixed(outcome.figures[f"{gap.point}.penetration_max_m"] * 1e6, 2),
        )
    return table


def _account(outcome: ClearanceSimulation) -> Table:
    found = outcome.figures
    table = grid("Drive and energy account", [("", "left"), ("", "right"), ("", "left")])
    table.add_row("torque, root mean square", number(found["torque_rms_Nm"]), "N m")
    table.add_row("torque, largest", number(found["torque_max_Nm"]), "N m")
    if found["correction_max_rad"] > 0.0:
        rms, most = (math.degrees(found[name]) for name in ("correction_rms_rad", "correction_max_rad"))
        table.add_row("correction, root mean square", fixed(rms, 4), f"deg, largest {most:.4g} deg")
    for name in [key for key in found if key.endswith(".work_J")]:
        what, _, _ = name.rpartition(".")
        words = {"drive": "work of the drive"}.get(what, f"work of {what}")
        point, _, kind = what.rpartition(".")
        if point:
            words = f"lost at {point} {'in the contact' if kind == 'impact' else 'by friction'}"
        table.add_row(words, number(found[name]), "J")
    share = found["imbalance_J"] / found["largest_energy_J"] if found["largest_energy_J"] > 0.0 else 0.0
    table.add_row("largest imbalance on the way", f"{found['imbalance_J']:.1e}", f"J, {share:.1e} of the largest energy")
    return table


def _tail(outcome: ClearanceSimulation) -> Text:
    words = f"Tolerance {outcome.tolerance:g}"
    if outcome.sample_time is not None:
        words += f", controller sampled every {outcome.sample_time * 1e3:.6g} ms"
    return Text(words, style=QUIET)


def comparison(outcome: Comparison) -> RenderableType:
    """Tabulate all kinds of control of a comparison."""
    factor, displayed = TO_DISPLAY[outcome.unit]
    title = Text(outcome.problem.model.title, style=HEAD)
    count = len(outcome.starts)
    starts = "one crank angle at the start" if count == 1 else f"{count} crank angles at the start"
    title.append(f"\n{outcome.revolutions} revolutions from each of {starts} (seed {outcome.seed})")
    columns = [("control", "left"), (f"rms {displayed}", "right"), ("scatter", "right"), ("peak", "right"), ("gain", "right")]
    columns += [("crank deg", "right"), ("torque Nm", "right")]
    table = grid("Deviation of the output, and what the control costs: rms of correction and torque", columns, header=True)
    for kind, trials in outcome.trials.items():
        gain = "" if kind == "none" or "none" not in outcome.trials else f"{outcome.gain(kind):.1%}"
        effort, torque = math.degrees(float(np.mean(trials.correction))), float(np.mean(trials.torque))
        sizes = [fixed(value * factor, 4) for value in (trials.mean, trials.scatter, float(np.max(trials.peak)))]
        table.add_row(kind, *sizes, gain, fixed(effort, 3), fixed(torque, 3), style="" if trials.finished else BAD)
    return Group(title, Text(), table)


def tuning(outcome: Tuning) -> RenderableType:
    """Summarise a search for controller parameters and its best set."""
    factor, displayed = TO_DISPLAY[outcome.unit]
    title = Text(outcome.problem.model.title, style=HEAD)
    starts = "one crank angle" if outcome.starts == 1 else f"{outcome.starts} crank angles"
    title.append(
        f"\n{outcome.control}: {outcome.revolutions} revolutions from each of {starts} at the start (seed {outcome.seed})"
    )
    stopped = int(np.sum(~np.isfinite(outcome.costs)))
    title.append(
        f"\n{len(outcome.costs)} parameter sets tried" + (f", {stopped} of them stopped early as worse" if stopped else "")
    )
    table = grid("Mean root mean square of the deviation", [("", "left"), (displayed, "right")], header=True)
    table.add_row("parameters of the problem", fixed(outcome.before * factor, 4))
    if outcome.best:
        table.add_row("best parameters", fixed(outcome.cost * factor, 4))
        table.add_row("scatter between starts", fixed(outcome.scatter * factor, 4))
        options = " ".join(f'--set control.{name}="{value}"' for name, value in outcome.best.items())
        words = Text(f"Use them: {options}", style=GOOD)
        if outcome.before - outcome.cost < 2.0 * outcome.scatter:
            words.append("\nNote: the gain is less than twice the scatter; check it with other seeds and more starts", style=BAD)
    else:
        words = Text("None is better than the parameters of the problem; these stay")
    return Group(title, Text(), table, Text(), words)
