"""Tables of a machine, its analysis and its forward dynamics simulation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from optlink.dynamics.machine import Machine
from optlink.dynamics.strokes import StrokeLoad, acting_loads, named_travels, travels_by_use, use_of, working_stroke
from optlink.linkage.elements import Drive, disc_cams
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.stroke import Travel, within_cycle
from optlink.linkage.vector2d import TURN
from optlink.presentation.format import dimension, fixed, number
from optlink.presentation.table_spec import (
    Column,
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
from optlink.problem.file import ProblemFile
from optlink.problem.machine.balance import BalanceSection
from optlink.problem.machine.bodies import DriveMotion
from optlink.problem.mechanism import DyadsSection
from optlink.units import percent, show

if TYPE_CHECKING:
    from optlink.tasks.analyze import Analysis
    from optlink.tasks.simulate import Simulation


def machine(file: ProblemFile) -> Iterator[TableSpec]:
    """List the bodies, joints, Assur groups, masses, loads and drive of a machine, and the directions of its joint reactions."""
    from optlink.tasks.analyze import reaction_conventions

    model = file.model
    built = model.machine(slow=model.slow_assumed)
    mechanism = built.mechanism
    dyads = isinstance(model.mechanism, DyadsSection)
    if dyads:
        yield table("[mechanism] dimensions", "<<", [(name, str(quantity)) for name, quantity in model.quantities.items()])
    order: list[Row] = [] if mechanism.drives else [("crank", mechanism.crank.body, f"pivot {mechanism.crank.start}", "")]
    order += [("driven length", drive.body, _named(drive.name), "") for drive in mechanism.drives if drive.size]
    order += _singles(mechanism, "")
    for group in mechanism.groups:
        bodies = ", ".join(link.body for link in group.links)
        order.append((group.kind, bodies, f"joint {group.joint}", quiet(file.mode(group.joint) if dyads else "")))
        order += _singles(mechanism, group.joint)
    yield table("Order of solution", "<<<<", order)
    if built.inertias:
        masses = []
        for name, inertia in built.inertias.items():
            place = f"({number(inertia.along * 1e3)}, {number(inertia.across * 1e3)})"
            masses.append((name, number(inertia.mass), place, number(inertia.moment)))
        yield table("[bodies]", ["body", ">mass [kg]", ">centroid [mm]", ">inertia [kg·m^2]"], masses)
    gravity = math.hypot(*built.gravity)
    lasts = f", for {model.drive.duration}" if model.drive.duration is not None else ""
    reach = "" if mechanism.limits is None else ", within {:.6g} to {:.6g} deg".format(*np.degrees(mechanism.limits))
    drive = [("drive", f"{mechanism.crank.body} at {model.drive.speed}, from {model.drive.start}{lasts}{reach}")]
    if mechanism.drives:
        drive = [_drive(one, built, model.drives.get(one.name, model.drive)) for one in mechanism.drives]
    for key in ("torque", "force"):
        if (effort := getattr(model.drive, key)) is not None:
            drive.append((key, f"{effort}, for simulate"))
    if (stops := model.drive.stops) is not None:
        drive.append(("end stops", f"{stops.stiffness or 'rigid'}, restitution {stops.restitution:g}"))
    drive.append(("gravity", f"({built.gravity[0]:g}, {built.gravity[1]:g}) m/s^2" if gravity else "none"))
    for name, section in model.loads.items():
        stroke = getattr(next(load for load in built.loads if load.name == name), "stroke", "both")
        drive.append((name, section.words + (f" (the {stroke} one)" if section.by_pace and not model.free else "")))
    drive += [(f"friction in {name}", number(coefficient)) for name, coefficient in built.friction.items()]
    yield table("[drive] and loads", "<<", drive)
    yield from _clearances(file, built)
    if model.balance is not None:
        yield balance_problem(model.balance)
    yield table("Reactions: force of which body on which", "<<", reaction_conventions(built).items())


def _singles(mechanism: Mechanism, after: str) -> list[Row]:
    """Return the rows of the bodies that drives and couplings place after a group."""
    rows: list[Row] = []
    for train in mechanism.placed_after.get(after, ()):
        for by in train.elements:
            kind, bodies = by.kind if by.bodies else f"driven {by.kind}", by.bodies or [one.link.body for one in train.singles]
            rows.append((kind, ", ".join(bodies), _named(by.name), ""))
    return rows


def _named(name: str) -> str:
    """Return the name of an element; nothing for an only drive, which the file does not name."""
    return "" if name == "input" else name


def _drive(drive: Drive, built: Machine, section: DriveMotion) -> tuple[str, str]:
    """Return the name of a drive, and how it moves its body."""
    kind, low = "angle" if drive.kind == "angle" else "length", _value(drive.begin, built)
    if drive.law is not None:
        least, _, largest, _ = drive.law.extremes()
        how = f"by a law of {drive.law.period:.6g} s, from {show(low + least, kind)} to {show(low + largest, kind)}"
    elif drive.end is not None:
        how = f"between {show(low, kind)} and {show(_value(drive.end, built), kind)} at {section.speed}"
    else:
        how = f"at {section.speed}, from {show(low, kind)}" if drive.rate else f"held at {show(low, kind)}"
    return f"drive {_named(drive.name)}".strip(), f"{drive.kind} of {drive.body} {how}"


def _value(size: str | float, built: Machine) -> float:
    return float(built.sizes[size] if isinstance(size, str) else size)


def _clearances(file: ProblemFile, built: Machine) -> Iterator[TableSpec]:
    """Yield the joints with clearance, the contact law and the controller."""
    gaps, model = file.model.gaps(built), file.model
    if not gaps:
        return
    rows = []
    for gap in gaps:
        sizes = [number(value) for value in (gap.clearance * 1e3, gap.radius * 1e3)]
        law = [f"{gap.stiffness:.4g}", number(gap.restitution), number(gap.friction)]
        rows.append((gap.point, gap.journal, gap.bearing, *sizes, *law))
    columns = ["joint", "journal", "bearing", ">gap\n[mm]", ">journal\n[mm]", ">stiffness\n[N/m^1.5]", ">restit.", ">friction"]
    yield table("Clearance, radius of the journal in mm, contact", columns, rows)
    control = [("law", ", ".join(sorted({gap.law for gap in gaps})))]
    if model.drive.servo is not None:
        control.append(("servo", f"{model.drive.servo.bandwidth}, damping {model.drive.servo.damping:g}"))
    for key in type(model.control).model_fields if model.control is not None else ():
        value = getattr(model.control, key)
        if value is not None:
            control.append((key, ", ".join(value) if isinstance(value, tuple) else str(value)))
    yield table("Contact law and [control]", "<<", control)


def balance_problem(section: BalanceSection) -> TableSpec:
    """List the settings of the `[balance]` section."""
    rows = [("minimise", section.words)]
    rows += [("limit", f"{term.words} at most {limit.max}") for term, limit in section.limited]
    if section.mass is not None:
        rows.append(("mass of all", str(section.mass)))
    rows.append(("positions", str(section.positions)))
    for weight in section.counterweights:
        settings = {key: getattr(weight, key) for key in type(weight).model_fields if key != "body"}
        rows.append((f"on {weight.body}", ", ".join(f"{key} {value}" for key, value in settings.items() if value is not None)))
    for spring in section.springs:
        rows.append((spring.name, f"spring {'-'.join(spring.between)}, stiffness {spring.stiffness or 'free'}"))
    return table("[balance]", "<<", rows)


def analysis(outcome: Analysis) -> Summary:
    """Summarise an analysis: status, strokes, extremes, work and flywheel."""
    turn, driving = "the crank turns fully" if outcome.full else "the crank cannot turn fully", outcome.problem.model.driving
    prescribed = driving.ends is None and outcome.machine.mechanism.drives
    moved = "" if prescribed else f", {driving.reach or turn}"
    ended = verdict(outcome.status, outcome.valid), f"{moved}; {_speed(outcome)}"
    title, status = outcome.problem.model.title, [ended, *noted(outcome.notes)]
    if outcome.ranges.singular:
        return summary(title, status)
    loaded = outcome.machine.inertias or outcome.machine.loads
    return summary(title, status, *_travels(outcome), *_cams(outcome), _extremes(outcome), _work(outcome) if loaded else None)


def _cams(outcome: Analysis) -> Iterator[TableSpec]:
    """Tabulate base radius, lift, pressure angle and curvature of every disc cam, at angles of its law."""
    pose = outcome.machine.motion(outcome.positions[:1]).pose
    for cam, disc in disc_cams(pose).items():
        lift, pressure, (radius, sharp), undercut = disc.figures
        phase = float(pose.size(cam.phase))
        slides = cam.follower in (guide.slider for guide in outcome.machine.mechanism.guides)

        def at(angle: float, phase: float = phase) -> Span:
            return quiet(f"at cam angle {math.degrees(within_cycle(angle - phase)):z.2f} deg")

        rows = [
            ("base radius", f"{dimension(1e3 * disc.base_radius)} mm", ""),
            ("lift", f"{dimension(1e3 * lift)} mm" if slides else f"{dimension(math.degrees(lift))} deg", ""),
            ("largest pressure angle", f"{math.degrees(pressure[0]):z.2f} deg", at(pressure[1])),
            ("least radius of curvature", f"{dimension(1e3 * radius)} mm", at(sharp)),
            ("undercut", bad("yes"), at(undercut)) if math.isfinite(undercut) else ("undercut", good("no"), ""),
        ]
        yield table(f"Profile of the cam {cam.name}", "<><", rows)


def _speed(outcome: Analysis) -> str:
    speed, ends = outcome.speed, outcome.problem.model.driving.ends
    if outcome.static:
        return "static"
    if ends is None and outcome.machine.mechanism.drives:
        return f"the drives take {2.0 * math.pi / abs(speed):.6g} s for a cycle"
    if ends is not None:
        return f"{1e3 * speed * (ends[1] - ends[0]) / math.pi:.6g} mm/s"
    sense = "" if speed > 0.0 else ", clockwise"
    return f"crank speed {abs(speed):.6g} rad/s ({abs(speed) * 30.0 / math.pi:.6g} rpm){sense}"


def _travels(outcome: Analysis) -> Iterator[Part | None]:
    if not outcome.strokes and not outcome.swings:
        yield Paragraph("No body swings and no slider moves to and fro")
        return
    outputs, others = travels_by_use(outcome.machine, outcome.swings, outcome.strokes)
    rows, driving = [], outcome.problem.model.driving
    for name, travel in (outputs | others).items():
        factor, unit = (1e3, "mm") if name.endswith(" slides") else (math.degrees(1.0), "deg")
        centres = "\n".join(f"{driving.shown(at):z.3f}" for at in travel.dead_centres)
        ends = (dimension(value * factor) for value in (travel.low, travel.high, travel.span))
        rows.append((strong(name) if name in outputs else name, *ends, unit, centres, fixed(travel.time_ratio, 5)))
    columns = ["", ">from", ">to", ">span", "", f">reverses\n[{driving.unit}]", ">time ratio"]
    yield table("Strokes of sliders, swings of bodies", columns, rows)
    yield stroke_table(outputs, outcome.speed, outcome.acting)


def machine_strokes(machine: Machine, speed: float) -> TableSpec | None:
    """Tabulate the forward and return strokes of the outputs of a machine whose crank turns fully; None if there are none."""
    return stroke_table(named_travels(machine)[0], speed, acting_loads(machine, speed))


def stroke_table(travels: Mapping[str, Travel], speed: float, acting: tuple[StrokeLoad, ...]) -> TableSpec | None:
    """Tabulate the forward and return strokes of outputs with their crank ranges; None if no output has two dead centres.

    The sign of the crank speed gives the direction; `acting` are loads that act in one stroke only.
    """
    rows: list[tuple[str, ...]] = []
    for name, travel in travels.items():
        working, loads = working_stroke(travel, speed, acting)
        for stroke in travel.strokes(speed):
            use = use_of(stroke, working) + (f": {', '.join(loads)}" if loads and stroke.name == working else "")
            begin, end, rotation = (f"{math.degrees(angle):z.3f}" for angle in (stroke.begin, stroke.end, stroke.rotation))
            rows.append((name, stroke.name, f"{begin} to {end}", rotation, stroke.pace, use))
    first = Column(unbroken=all(len(name) <= LONGEST for name in travels))
    columns: list[str | Column] = [first, "stroke", ">crank range [deg]", ">rotation [deg]", "pace", "use"]
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    return table("Working and return strokes", columns, rows, unbroken=True) if rows else None


WORTH = {
    ".v_m_s": ("velocity", "m/s"),
    ".a_m_s2": ("acceleration", "m/s^2"),
    ".transmission_rad": ("transmission angle", "deg"),
    ".f_N": ("force", "N"),
    ".normal_N": ("normal force", "N"),
    ".moment_Nm": ("moment", "N m"),
    ".length_m": ("length", "m"),
    ".force_N": ("force of the drive", "N"),
    "input.torque_Nm": ("torque", "N m"),
    ".power_W": ("power", "W"),
    "frame.shaking_fx_N": ("shaking force x", "N"),
    "frame.shaking_fy_N": ("shaking force y", "N"),
    "frame.shaking_moment_Nm": ("shaking moment", "N m"),
}
"""Endings of the columns whose extremes are worth a line, with their names and display units."""

RATES = (".v_m_s", ".a_m_s2", ".power_W")
"""Endings of the columns that have no meaning where a drive is so slow that inertia has no effect."""

SHORT = 1e-3
"""Lever [m] of a force whose moment is worth showing."""

LONGEST = 24
"""Letters up to which the name of an output stays on one line."""

ROUNDING = 1e-10
"""Share of the largest amount of a column below which one of its extremes is shown as zero."""

UNITS = ("s", "s2", "rad", "N", "Nm", "W")
"""Last parts of the names of columns that share a scale."""


def _extremes(outcome: Analysis) -> TableSpec:
    still = RATES if outcome.static else ()
    worth = {
        name: shown
        for name in outcome.extremes
        for ending, shown in WORTH.items()
        if name.endswith(ending) and not name.endswith(still)
    }
    amounts, driving = outcome.extremes.amounts, outcome.problem.model.driving
    scale = {unit: max((size for name, size in amounts.items() if name.endswith(f"_{unit}")), default=0.0) for unit in UNITS}
    scale["Nm"] = max(scale["Nm"], SHORT * scale["N"])
    rows = []
    for name, extreme in outcome.extremes.select(worth).items():
        (word, unit), size = worth[name], max(abs(extreme.least), abs(extreme.largest))
        if not size > 1e-9 * scale.get(name.rpartition("_")[2], 0.0) or not math.isfinite(extreme.least):  # else rounding
            continue
        factor = math.degrees(1.0) if unit == "deg" else 1.0
        ends = ((extreme.least, extreme.least_at), (extreme.largest, extreme.largest_at))
        cells = [
            (number(factor * (0.0 if abs(value) <= ROUNDING * size else value), 7), fixed(driving.shown(at), 4) + ", back" * back)
            for (value, at), back in zip(ends, outcome.extremes.on_way_back(name), strict=True)
        ]
        rows.append((f"{name.rpartition('.')[0]}: {word}", *cells[0], *cells[1], quiet(unit)))
    columns = ["", ">least", f">at [{driving.unit}]", ">largest", f">at [{driving.unit}]", ""]
    where = "crank angles" if driving.coordinate == "crank angle" else f"positions: {driving.coordinate}"
    return table(f"Extremes over the motion, at their exact {where}", columns, rows)


def _work(outcome: Analysis) -> TableSpec:
    scale = max((abs(v) for v in outcome.extremes.get("input.work_J", (0.0,))), default=0.0)
    work = 0.0 if abs(outcome.work) <= 1e-12 * scale else outcome.work  # rounding error of cancelling terms
    rows, driving = [(outcome.extent, number(work, 9), "J")], outcome.problem.model.driving
    if outcome.full and math.isfinite(work):
        torque, power = (mean if work else 0.0 for mean in (outcome.mean_torque, outcome.mean_power))
        rows += [
            ("mean torque", number(torque), "N m"),
            ("rms torque", number(outcome.rms_torque), "N m"),
            ("mean power", number(power), "W"),
        ]
    if "input.work_J" in outcome.extremes:
        extreme = outcome.extremes["input.work_J"]
        for word, amount, at in (("least", *extreme[:2]), ("largest", *extreme[2:])):
            shown = 0.0 if abs(amount) <= 1e-12 * scale else amount
            rows.append((f"{word} since the start", number(shown, 9), f"J at {driving.shown(at):z.4f} {driving.unit}"))
    wheel = outcome.flywheel
    if wheel:
        alone = "of the mean speed under it, without a flywheel"
        rows += [
            ("mean speed", number(wheel.mean_speed), "rad/s, mean over crank angle, not time"),
            ("fluctuation", number(wheel.fluctuation), alone if wheel.fluctuation > 0.0 else "without a flywheel: it would stop"),
            ("flywheel", number(wheel.inertia), f"kg·m^2, added to the crank: fluctuation {wheel.allowed:g}"),
        ]
    return table("Work of the drive", "<><", rows)


def simulation(outcome: Simulation) -> Summary:
    """Summarise a simulation in time: final state, energy balance, drift and speed fluctuation."""
    figures = outcome.figures
    end = [("time", number(figures["end.time_s"]), "s")]
    if "end.speed_rad_s" in figures:
        speed, turns = figures["end.speed_rad_s"], figures["end.crank_angle_rad"] / TURN
        end.append(("crank angle", number(figures["end.crank_angle_rad"]), f"rad ({turns:z.4f} turns)"))
        end.append(("crank speed", number(speed), f"rad/s ({speed * 30.0 / math.pi:.6g} rpm)"))
    elif "end.speed_m_s" in figures:
        end.append((outcome.problem.model.driving.coordinate, number(1e3 * figures["end.position_m"]), "mm"))
        end.append(("speed of the drive", number(1e3 * figures["end.speed_m_s"]), "mm/s"))
    if "last_turn.mean_speed_rad_s" in figures:
        mean, share = figures["last_turn.mean_speed_rad_s"], figures["last_turn.fluctuation"]
        last = "cycle" if "last_turn.revolutions" in figures else "turn"
        end.append((f"last {last}: mean speed", number(mean), f"rad/s, mean over time; fluctuation {percent(share, 4)}"))
    works = {name.removesuffix(".work_J"): work for name, work in figures.items() if name.endswith(".work_J")}
    account = [("work of the drive" if name == "input" else f"work of {name}", number(work), "J") for name, work in works.items()]
    share = figures["imbalance_J"] / figures["turnover_J"] if figures["turnover_J"] > 0.0 else 0.0
    account += [
        ("gain of kinetic and potential energy", number(outcome["energy.gained_J"][-1]), "J"),
        ("largest imbalance during the run", f"{figures['imbalance_J']:.1e}", f"J, {share:.1e} of the largest amount"),
    ]
    drift = f"{figures['drift_m']:.1e} m, {figures['drift_rad']:.1e} rad"
    tail = Paragraph(
        quiet(f"Drift of the twice integrated positions from the closed loops: at most {drift}"),
        quiet(f"{outcome.steps} steps, {outcome.evaluations} evaluations"),
    )
    ended = verdict(outcome.ending.value, outcome.valid), f", driven by {outcome.driven}{unnoted(outcome)}"
    status = [ended, *noted(outcome.notes)]
    tables = table("At the end", "<><", end), table("Energy account", "<><", account)
    return summary(outcome.problem.model.title, status, *tables, tail)


def unnoted(outcome: Simulation) -> str:
    """Return why a simulation ended, where no note says so."""
    text = outcome.ending.text
    return "" if any(note.startswith(text) for note in outcome.notes) else f"; {text}"
