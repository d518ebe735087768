"""Tables, charts, conclusion and page of a simulation with joint clearance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.clearance.control import Control
from optlink.dynamics.columns import MotionColumns
from optlink.linkage.vector2d import TURN
from optlink.presentation.chart_spec import (
    BODIES,
    CRANK,
    LIMIT,
    MUTED,
    RESULT,
    ROCKER,
    SHADE,
    TARGET,
    TIME,
    Array,
    Axis,
    ChartSpec,
    Curve,
    Dash,
    Panel,
    Span,
    max_abs,
)
from optlink.presentation.format import Scale, fixed, number, scale, si
from optlink.presentation.shapes import even
from optlink.presentation.table_spec import Line, Paragraph, Summary, TableSpec, noted, quiet, summary, table, verdict
from optlink.presentation.view import PageSection, SomeDrawing, StoredStudy, View
from optlink.presentation.views import clearance_joints
from optlink.presentation.views.revolutions import (
    FULL,
    TORQUE,
    WINDOW,
    RevolutionCurves,
    from_zero,
    padded_limits,
    revolution_axis,
    rough,
)
from optlink.presentation.views.simulation import largest
from optlink.tasks.results.clearance import ClearanceSimulation
from optlink.units import DISPLAYED, percent

if TYPE_CHECKING:
    from optlink.presentation.html.moving_linkage import Moving


MAX_MARKERS = 60  # number of revolutions up to which each has a marker
ENLARGE_RATIO = 4.0  # ratio to the ideal torque beyond which a second panel enlarges the latter


def charts(result: ClearanceSimulation) -> list[ChartSpec]:
    """Return the charts of a simulation with clearance, as computed or as stored; none if it ended in its first revolution."""
    turns = RevolutionCurves(result)
    if not turns:
        return []
    joints = clearance_joints.charts(turns)
    return [*displacement(turns), *measured(turns), *error(turns), *joints, *torque(turns), *energy(turns)]


# --- output --------------------------------------------------------------------------------------------------------------


def displacement(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot the output with and without clearance and its deviation over the last revolutions, over time and crank angle."""
    out, value, deviation, rows, advance = turns.result.output, turns.output, turns.error, turns.rows(WINDOW), turns.advance
    unit = turns.shares(max_abs(value))
    small = turns.shares(max_abs(deviation[turns.rows(turns.shown)]))
    time, ideal = turns.time[rows], value - deviation
    motions = [
        Curve(time, value[rows] * unit.factor, "with clearance", ROCKER, 1.7, gid="output"),
        Curve(time, ideal[rows] * unit.factor, "ideal machine", TARGET, 1.1, "dash", gid="ideal"),
    ]
    deviation_curve = Curve(time, deviation[rows] * small.factor, f"deviation of {out.name}", LIMIT, 1.3, gid="error")
    if advance:  # over the crank angle, a fully rotating output is shown within one turn
        lowest = np.nanmin(turns.fold(value, turns.rows(1), advance)[1])
        value, ideal = (part - TURN * math.floor(lowest / TURN + 1e-6) for part in (value, ideal))
    x, y = turns.fold(ideal * unit.factor, turns.rows(1), advance * unit.factor)
    folded = turns.overlay(value, unit, "with clearance", ROCKER, advance)
    folded.append(Curve(x, y, "ideal machine", TARGET, 1.1, "dash", gid="ideal"))
    moved = Axis(f"{out.name}: {'slide' if out.guide else 'angle'} [{unit.unit}]")
    lost = Axis(f"deviation [{small.unit}]", padded_limits(deviation[turns.rows(max(turns.shown, WINDOW))] * small.factor))
    heading = turns.title(f"motion of {out.name}")
    over_time = [Panel(moved, motions, 1.35), Panel(lost, [deviation_curve])]
    over_angle = [Panel(moved, folded, 1.35), Panel(lost, turns.overlay(deviation, small, f"deviation of {out.name}", LIMIT))]
    over_time_title, last = f"Motion of {out.name} over time, {turns.span(WINDOW)}", f"Motion of {out.name}, {turns.overlaid}"
    return [
        ChartSpec("displacement", over_time_title, over_time, Axis(TIME), heading, lines=turns.ends(rows), width=5.8),
        ChartSpec("displacement", last, over_angle, turns.crank_axis, cursor=False, width=5.2),
        _forces_over_time(turns, rows),
    ]


def measured(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot a measured series beside the simulated output, and the difference, over its last revolutions."""
    rows, out = turns.result.measured, turns.result.output
    if not rows:
        return []
    time = rows["time_s"]
    last = time > time[-1] - WINDOW * turns.period
    time, values, simulated, ideal, lost = (
        rows[name][last]
        for name in ("time_s", f"measured_{out.unit}", f"simulated_{out.unit}", f"ideal_{out.unit}", f"difference_{out.unit}")
    )
    unit, without = turns.shares(max_abs(simulated)), np.asarray(out.difference(values, ideal))
    small = turns.shares(max(max_abs(part) for part in (lost, without)))
    sparse = len(time) <= MAX_MARKERS * WINDOW
    points = partial(Curve, time, mode="lines+markers" if sparse else "lines", size=3.0)
    look: dict[str, Any] = {"mode": "markers", "size": 3.5} if sparse else {"width": 1.1, "dash": "dash"}
    motions = [
        Curve(time, simulated * unit.factor, "simulated", ROCKER, 1.7, gid="simulated"),
        Curve(time, values * unit.factor, "measured", TARGET, gid="measured", **look),
    ]
    differences = [
        points(without * small.factor, "measured minus ideal machine", MUTED, 1.1, gid="from ideal"),
        points(lost * small.factor, "measured minus simulated", LIMIT, 1.4, gid="difference"),
    ]
    panels = [
        Panel(Axis(f"{out.name}: {'slide' if out.guide else 'angle'} [{unit.unit}]"), motions, 1.35),
        Panel(Axis(f"difference [{small.unit}]"), differences),
    ]
    rms = turns.result.figures[f"measured.rms_{out.unit}"]
    caption = f"RMS of measured minus simulated {rms * small.factor:.4g} {small.unit}"
    title, heading = f"Measured and simulated {out.name}", turns.title("measured and simulated")
    return [ChartSpec("measured", title, panels, Axis(TIME), heading, caption)]


def _forces_over_time(turns: RevolutionCurves, rows: slice) -> ChartSpec:
    """Plot contact forces and driving torque over time."""
    names = [f"{gap.point}.normal_N" for gap in turns.result.gaps]
    force = scale(max(turns.peak(name, WINDOW) for name in names), "N")
    drive = scale(turns.peak(TORQUE, WINDOW), "N m")
    time = turns.time[rows]
    forces = [
        Curve(time, turns.result[name][rows] * force.factor, f"contact force at {gap.point}", BODIES[k % len(BODIES)], 1.2)
        for k, (gap, name) in enumerate(zip(turns.result.gaps, names, strict=True))
    ]
    torque_curve = Curve(time, turns.result[TORQUE][rows] * drive.factor, "driving torque", CRANK, 1.2)
    panels = [Panel(Axis(f"contact force [{force.unit}]"), forces, 1.3), Panel(Axis(f"torque [{drive.unit}]"), [torque_curve])]
    return ChartSpec("", f"Forces and torque over time, {turns.span(WINDOW)}", panels, Axis(TIME), lines=turns.ends(rows))


def error(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot deviation and largest contact forces of every revolution, and the RMS over all revolutions after the running-in."""
    result, out = turns.result, turns.result.output
    unit, numbers = out.unit, result.per_revolution.get("revolution")
    if numbers is None or not len(numbers):
        return []
    rms, peak = result.per_revolution[f"rms_{unit}"], result.per_revolution[f"peak_{unit}"]
    shown = turns.shares(np.max(peak))
    plotted = partial(Curve, numbers, mode="lines+markers" if len(numbers) <= MAX_MARKERS else "lines", size=3.5)
    low, high = numbers[0] - 0.5, numbers[-1] + 0.5
    ends = np.array([max(turns.begin - 0.5, low), high])
    deviations = [
        plotted(peak * shown.factor, "peak", CRANK, 1.1, gid="peak"),
        plotted(rms * shown.factor, "root mean square", RESULT, 1.5, gid="rms"),
        Curve(ends, np.full(2, turns.rms * shown.factor), f"RMS over {turns.counted}", TARGET, 1.1, "dash", gid="whole"),
    ]
    largest = [result.per_revolution[f"{gap.point}.normal_max_N"] for gap in result.gaps]
    force = scale(np.max(largest), "N")
    forces = [
        plotted(values * force.factor, f"force at {gap.point}", BODIES[k % len(BODIES)], 1.3)
        for k, (gap, values) in enumerate(zip(result.gaps, largest, strict=True))
    ]
    top = from_zero(np.max(peak) * shown.factor), from_zero(np.max(largest) * force.factor)
    panels = [
        Panel(Axis(f"deviation of {out.name} [{shown.unit}]", top[0]), deviations, 1.5),
        Panel(Axis(f"largest contact force [{force.unit}]", top[1]), forces),
    ]
    spans = [Span(low, turns.begin - 0.5, "running-in, left out", SHADE)] if turns.begin - 0.5 > low else []
    counted, si = numbers >= turns.begin, "m" if unit == "m" else "deg"
    caption = f"RMS {rough(turns.rms, si)}, peak {rough(np.max(peak[counted]), si)}"
    if int(np.sum(counted)) > 1:
        caption += f", RMS of single revolutions ±{np.std(rms[counted], ddof=1) * shown.factor:.2g}"
        caption += "°" if si == "deg" else f" {shown.unit}"
    heading = turns.title(f"deviation of {out.name}", turns.counted)
    x = revolution_axis(numbers)
    return [ChartSpec("error", "Revolution by revolution", panels, x, heading, caption, spans=spans, cursor=False)]


# --- drive ---------------------------------------------------------------------------------------------------------------


def _ideal_torque(turns: RevolutionCurves) -> tuple[Array, Array] | None:
    """Return crank angles [deg] and the driving torque [N m] of the machine without clearance at constant speed."""
    if turns.free:
        return None
    angles = np.linspace(0.0, FULL, 721)
    values = MotionColumns(turns.result.machine.moving(np.radians(angles), turns.result.speed))[TORQUE]
    return angles, np.broadcast_to(np.asarray(values, dtype=float), angles.shape)


def torque(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot the driving torque of the last revolution with and without clearance; a small ideal torque is enlarged below."""
    values, ideal = turns.result[TORQUE], _ideal_torque(turns)
    last, largest = values[turns.rows(1)], turns.peak(TORQUE, 1)
    rms = math.sqrt(np.mean(last[-turns.points :] ** 2))
    near = 0.0 if ideal is None else np.nanmax(np.abs(ideal[1]), initial=0.0)
    crank = turns.result.machine.mechanism.crank.body
    panels, views = [], (False, True) if 0.0 < ENLARGE_RATIO * near < largest else (False,)
    for close in views:
        unit = scale(near if close else max(largest, near), "N m")
        x, y = turns.fold(values * unit.factor, turns.rows(1))
        name = f"with clearance: RMS {rough(rms, 'N m')}, largest {rough(largest, 'N m')}"
        curves = [Curve(x, y, name, CRANK, 1.4, legend=not close, gid="last revolution")]
        if ideal is not None:
            even = math.sqrt(np.mean(ideal[1] ** 2))
            name = f"ideal machine: RMS {rough(even, 'N m')}, largest {rough(near, 'N m')}"
            curves.append(Curve(ideal[0], ideal[1] * unit.factor, name, TARGET, 1.4, "dash", legend=not close, gid="ideal"))
        limits = (-1.6 * near * unit.factor, 1.6 * near * unit.factor) if close else None
        if np.ptp(last) < 1e-6 * largest:  # constant torque: start at zero instead of showing rounding errors
            ends = sorted((0.0, 1.15 * last[0] * unit.factor))
            limits = ends[0], ends[1]
        note = "near the ideal machine's torque, cut off" if close else ""
        panels.append(Panel(Axis(f"torque on {crank} [{unit.unit}]", limits), curves, 2.0 / len(views), note=note))
    heading = turns.title("driving torque", turns.span(1))
    return [ChartSpec("torque", f"Driving torque, {turns.span(1)}", panels, turns.crank_axis, heading, cursor=False)]


# --- energy --------------------------------------------------------------------------------------------------------------


def _works(turns: RevolutionCurves) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the work of drive and loads, and the energy lost at the joints, since the first stored row [J]."""
    names = [name.removesuffix(".work_J") for name in turns.result.figures if name.endswith(".work_J")]
    points = {gap.point for gap in turns.result.gaps}
    supplied: dict[str, Array] = {}
    lost: dict[str, Array] = {}
    for name in names:
        work = turns.result[f"work.{name}_J"]
        point, _, kind = name.rpartition(".")
        into = lost if point in points and kind in ("impact", "friction") else supplied
        into[name] = work - work[0]
    return supplied, lost


def energy(turns: RevolutionCurves) -> list[ChartSpec]:
    """Plot the work of drive and loads, the energy gained, the losses at each joint, and the imbalance of the energy account."""
    result, time = turns.result, turns.time
    largest = result.figures["largest_energy_J"]
    if largest <= 0.0:
        return []
    stored = result["energy.kinetic_J"] + result["energy.potential_J"] + result["energy.contact_J"]
    gained = stored - stored[0]
    supplied, lost = _works(turns)
    unit = scale(max(max_abs(work) for work in (*supplied.values(), gained)), "J")
    above = []
    for k, (name, work) in enumerate(supplied.items()):
        words, colour = ("drive", CRANK) if name == "drive" else (name, BODIES[(k + 1) % len(BODIES)])
        above.append(Curve(time, work * unit.factor, f"work of {words}", colour, 1.3, gid=f"work {name}"))
    above.append(Curve(time, gained * unit.factor, "energy gained", TARGET, 1.0, "dash", gid="gained"))
    total = sum(supplied.values()) - gained
    most = max([max_abs(total), *(max_abs(work) for work in lost.values())])
    small, below = scale(most, "J"), []
    points = [gap.point for gap in result.gaps]
    for name, work in lost.items():
        point, _, kind = name.rpartition(".")
        if max_abs(work) > 1e-9 * most or kind == "impact":
            words = "by friction" if kind == "friction" else "in contact"
            dash: Dash = "solid" if kind == "friction" else "dashdot"
            colour = BODIES[points.index(point) % len(BODIES)]
            below.append(Curve(time, work * small.factor, f"lost at {point} {words}", colour, 1.5, dash, gid=f"lost {name}"))
    below.append(Curve(time, total * small.factor, "works minus energy gained", TARGET, 1.4, "dot", gid="total"))
    missing = np.abs(total - sum(lost.values())) / largest
    low = 10.0 ** math.floor(math.log10(max(np.percentile(missing[1:], 5.0), 1e-16)) - 1.0)
    share = Curve(time, np.maximum(missing, 1e-17), "imbalance", MUTED, 1.0, legend=False, gid="imbalance")
    limits = low, max(1e-8, 10.0 * np.max(missing))
    panels = [
        Panel(Axis(f"energy [{unit.unit}]"), above, 1.5),
        Panel(Axis(f"losses [{small.unit}]"), below, 1.3),
        Panel(Axis("imbalance / largest", limits, "log"), [share], 0.9),
    ]
    caption = f"imbalance at most {result.figures['imbalance_J'] / largest:.1e} of the largest energy, {rough(largest, 'J')}"
    heading = turns.title("energy account", turns.span(turns.kept))
    return [ChartSpec("energy", "Energy account", panels, Axis(TIME), heading, caption)]


# --- the page ----------------------------------------------------------------------------------------------------------------


def page(result: ClearanceSimulation) -> StoredStudy:
    """Return the page of a simulation with clearance."""
    shown = overview(result)
    curves = charts(result) if result.revolutions else ()
    control = "" if result.control is Control.NONE else f"; control: {result.control}"
    return StoredStudy(
        problem=result.problem,
        kind="simulation with clearance",
        verdict="Finished" if result.valid else f"Not finished: {result.ending.value}",
        valid=result.valid,
        conclusion=conclusion(result),
        status=shown.status.lines,
        sections=[PageSection("Figures", (shown.parts,)), PageSection("Curves", curves)],
        moving=partial(_moving, result) if result.revolutions else None,
        by=f"event-driven integration of all bodies, tolerance {result.tolerance:g}{control}",
        drawn="Its last revolutions, drawn without the clearance, which is too small to be seen; journal orbits are below.",
    )


def _moving(result: ClearanceSimulation, steps: int) -> Moving | None:
    """Animate the machine without clearance over the last revolutions."""
    from optlink.presentation.html.study_page import in_time

    turns = RevolutionCurves(result)
    span = turns.rows(WINDOW)
    rows = span.start + even(span.stop - span.start, steps + 1)
    crank = result["crank_angle_deg"][rows]
    shown = [("crank angle", Scale(1.0, "deg"), np.mod(crank, 360.0))]
    shown.append((f"deviation of {result.output.name}", turns.shares(turns.rms), turns.error[rows]))
    unit = scale(largest(result.columns, [TORQUE]), "N m")
    shown.append(("driving torque", unit, result[TORQUE][rows]))
    names = {gap.point: f"{gap.point}.normal_N" for gap in result.gaps}
    force = scale(largest(result.columns, names.values()), "N")
    shown += [(f"contact force at {point}", force, result[name][rows]) for point, name in names.items()]
    return in_time(result.problem, result.machine.sizes, result["time_s"][rows], crank, shown)


def overview(outcome: ClearanceSimulation) -> Summary:
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
    yield verdict(outcome.ending.value, outcome.valid), f", {outcome.message}; {drive} {abs(rpm):.6g} rpm{sense}"
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


def conclusion(result: ClearanceSimulation) -> str:
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
    return text if result.valid else f"Not finished: {result.message}. {text}"


VIEW = View(
    overview,
    charts=charts,
    drawings={"mechanism": SomeDrawing(RevolutionCurves, clearance_joints.mechanism)},
    tables=lambda result: {"play": result.columns} if result.columns else {},
    page=page,
)
