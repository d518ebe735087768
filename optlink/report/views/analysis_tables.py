"""Terminal tables of a machine, its analysis and its forward dynamics simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from optlink.dynamics.machine import Machine
from optlink.dynamics.strokes import StrokeLoad, acting_loads, travels_by_use, use_of, working_stroke
from optlink.linkage.stroke import Travel
from optlink.problem.file import ProblemFile
from optlink.problem.mechanism import DyadsSection
from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, fixed, grid, number
from optlink.tasks.results.analysis import Analysis, named_travels, reaction_conventions
from optlink.tasks.simulate import Simulation

COLUMN = tuple[str, str]


def machine(file: ProblemFile) -> list[RenderableType]:
    """List the bodies, joints, Assur groups, masses, loads and drive of a machine, and the directions of its joint reactions."""
    model = file.model
    built = model.machine(slow=model.slow_assumed)
    mechanism = built.mechanism
    parts: list[RenderableType] = []
    if isinstance(model.mechanism, DyadsSection):
        sizes = grid("\n[mechanism] sizes", [("", "left"), ("", "left")])
        for name, quantity in model.quantities.items():
            sizes.add_row(name, str(quantity))
        parts.append(sizes)
    order = grid("\nOrder of solution", [("", "left"), ("", "left"), ("", "left"), ("", "left")])
    order.add_row("crank", mechanism.crank.body, f"pivot {mechanism.crank.start}", "")
    for group in mechanism.groups:
        mode = model.mechanism.assembly.get(group.joint, "") if isinstance(model.mechanism, DyadsSection) else ""
        order.add_row(group.kind, ", ".join(link.body for link in group.links), f"joint {group.joint}", Text(mode, style=QUIET))
    parts.append(order)
    if built.inertias:
        masses = grid(
            "\n[bodies]",
            [("body", "left"), ("mass kg", "right"), ("centroid mm", "right"), ("inertia kg m^2", "right")],
            header=True,
        )
        for name, inertia in built.inertias.items():
            place = f"({number(inertia.along * 1e3)}, {number(inertia.across * 1e3)})"
            masses.add_row(name, number(inertia.mass), place, number(inertia.moment))
        parts.append(masses)
    gravity = math.hypot(*built.gravity)
    drive = grid("\n[drive] and loads", [("", "left"), ("", "left")])
    drive.add_row("drive", f"{mechanism.crank.body} at {model.drive.speed}, from {model.drive.start}")
    if model.drive.torque is not None:
        drive.add_row("torque", f"{model.drive.torque}, for simulate")
    drive.add_row("gravity", f"({built.gravity[0]:g}, {built.gravity[1]:g}) m/s^2" if gravity else "none")
    for name, section in model.loads.items():
        stated = {key: getattr(section, key) for key in type(section).model_fields if key in section.model_fields_set}
        words = ", ".join(f"{key} {'-'.join(value) if isinstance(value, tuple) else value}" for key, value in stated.items())
        stroke = getattr(next(load for load in built.loads if load.name == name), "stroke", "both")
        drive.add_row(name, words + (f" (the {stroke} one)" if section.by_pace and not model.free else ""))
    for name, coefficient in built.friction.items():
        drive.add_row(f"friction in {name}", number(coefficient))
    parts.append(drive)
    parts += _loose(file, built)
    if model.balance is not None:
        from optlink.report.views.balance_tables import asked

        parts += asked(model.balance)
    told = grid("\nReactions: force of which body on which", [("", "left"), ("", "left")])
    for joint, words in reaction_conventions(built).items():
        told.add_row(joint, words)
    parts.append(told)
    return parts


def _loose(file: ProblemFile, built: Machine) -> list[RenderableType]:
    """List the joints with clearance, the contact law and the controller."""
    gaps, model = file.model.gaps(built), file.model
    if not gaps:
        return []
    columns: list[COLUMN] = [
        ("joint", "left"),
        ("journal", "left"),
        ("bearing", "left"),
        ("gap mm", "right"),
        ("journal mm", "right"),
    ]
    columns += [("N/m^1.5", "right"), ("restit.", "right"), ("friction", "right")]
    table = grid("\nClearance, radius of the journal in mm, contact", columns, header=True)
    for gap in gaps:
        sizes = [number(value) for value in (gap.clearance * 1e3, gap.radius * 1e3)]
        law = [f"{gap.stiffness:.4g}", number(gap.restitution), number(gap.friction)]
        table.add_row(gap.point, gap.journal, gap.bearing, *sizes, *law)
    found: list[RenderableType] = [table]
    rows = [("law", ", ".join(sorted({gap.law for gap in gaps})))]
    if model.drive.servo is not None:
        rows.append(("servo", f"{model.drive.servo.bandwidth}, damping {model.drive.servo.damping:g}"))
    if model.control is not None:
        stated = {key: getattr(model.control, key) for key in type(model.control).model_fields}
        rows += [
            (key, ", ".join(value) if isinstance(value, tuple) else str(value))
            for key, value in stated.items()
            if value is not None
        ]
    control = grid("\nContact law and [control]", [("", "left"), ("", "left")])
    for row in rows:
        control.add_row(*row)
    return [*found, control]


def analysis(outcome: Analysis) -> RenderableType:
    """Summarise an analysis: status, strokes, extremes, work and flywheel."""
    model = outcome.problem.model
    title = Text(model.title, style=HEAD)
    turn = "the crank turns fully" if outcome.full else "the crank cannot turn fully"
    title.append(f"\n{outcome.status}", style=GOOD if outcome.sound else BAD)
    title.append(f", {turn}; {_speed(outcome.speed)}")
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    if outcome.ranges.singular:
        return title
    parts: list[RenderableType] = [title, Text(), _travels(outcome), Text(), _extremes(outcome)]
    if outcome.machine.inertias or outcome.machine.loads:
        parts += [Text(), _work(outcome)]
    return Group(*parts)


def _speed(speed: float) -> str:
    sense = "" if speed > 0.0 else ", clockwise"
    return f"{abs(speed):.6g} rad/s = {abs(speed) * 30.0 / math.pi:.6g} rpm{sense}"


def _travels(outcome: Analysis) -> RenderableType:
    if not outcome.strokes and not outcome.swings:
        return Text("No body swings and no slider moves to and fro")
    columns: list[COLUMN] = [("", "left"), ("from", "right"), ("to", "right"), ("span", "right"), ("", "left")]
    columns += [("reverses deg", "right"), ("time ratio", "right")]
    table = grid("Strokes of sliders, swings of bodies", columns, header=True)
    outputs, others = travels_by_use(outcome.machine, outcome.swings, outcome.strokes)
    for name, travel in (outputs | others).items():
        factor, unit = (1e3, "mm") if name.endswith(" slides") else (math.degrees(1.0), "deg")
        centres = [f"{math.degrees(at) + 0.0:.3f}" for at in travel.dead_centres]
        low, high, span = (fixed(value * factor) for value in (travel.low, travel.high, travel.span))
        table.add_row(
            Text(name, style=HEAD if name in outputs else ""),
            low,
            high,
            span,
            unit,
            "\n".join(centres),
            fixed(travel.time_ratio, 5),
        )
    strokes = stroke_table(outputs, outcome.speed, outcome.acting)
    return table if strokes is None else Group(table, Text(), strokes)


def machine_strokes(machine: Machine, speed: float, acting: tuple[StrokeLoad, ...] | None = None) -> Table | None:
    """Tabulate the forward and return strokes of the outputs of a machine whose crank turns fully; None if there are none.

    Parameters
    ----------
    machine : Machine
    speed : float [rad/s]
        Crank speed; only its sign matters.
    acting : tuple of StrokeLoad or None, optional
        Loads that act in one stroke only; default: those of the machine.
    """
    return stroke_table(named_travels(machine)[0], speed, acting_loads(machine, speed) if acting is None else acting)


def stroke_table(named: Mapping[str, Travel], speed: float, acting: tuple[StrokeLoad, ...]) -> Table | None:
    """Tabulate the forward and return strokes of outputs with their crank ranges; None if no output has two dead centres.

    Parameters
    ----------
    named : mapping of str to Travel
        Strokes or swings by name of the output.
    speed : float [rad/s]
        Crank speed; only its sign matters.
    acting : tuple of StrokeLoad
        Loads that act in one stroke only.
    """
    columns: list[COLUMN] = [("", "left"), ("stroke", "left"), ("crank range deg", "right"), ("turns deg", "right")]
    columns += [("pace", "left"), ("use", "left")]
    table = grid("Working and return strokes", columns, header=True)
    table.columns[0].no_wrap = all(len(name) <= LONGEST for name in named)
    table.columns[2].no_wrap = True
    for name, travel in named.items():
        working, loads = working_stroke(travel, speed, acting)
        for stroke in travel.strokes(speed):
            use = use_of(stroke, working) + (f": {', '.join(loads)}" if loads and stroke.name == working else "")
            begin, end, rotation = (f"{math.degrees(angle):.3f}" for angle in (stroke.begin, stroke.end, stroke.rotation))
            table.add_row(name, stroke.name, f"{begin} to {end}", rotation, stroke.pace, use)
    return table if table.row_count else None


WORTH = {
    ".v_m_s": "m/s",
    ".a_m_s2": "m/s^2",
    ".transmission_rad": "deg",
    ".f_N": "N",
    ".normal_N": "N",
    ".moment_Nm": "N m",
    "input.torque_Nm": "N m",
    "input.power_W": "W",
    "frame.shaking_fx_N": "N",
    "frame.shaking_fy_N": "N",
    "frame.shaking_moment_Nm": "N m",
}
"""Endings of the columns whose extremes are worth a line, and their display units."""

LONGEST = 24
"""Letters up to which the name of an output stays on one line."""

ROUNDING = 1e-10
"""Share of the largest amount of a column below which one of its extremes is shown as zero."""

UNITS = ("s", "s2", "rad", "N", "Nm", "W")
"""Last parts of the names of columns that share a scale."""

WORDS = {
    "v_m_s": "velocity",
    "a_m_s2": "acceleration",
    "transmission_rad": "transmission angle",
    "f_N": "force",
    "normal_N": "normal force",
    "moment_Nm": "moment",
    "torque_Nm": "torque",
    "power_W": "power",
    "shaking_fx_N": "shaking force x",
    "shaking_fy_N": "shaking force y",
    "shaking_moment_Nm": "shaking moment",
    "omega_rad_s": "angular velocity",
    "alpha_rad_s2": "angular acceleration",
}


def _extremes(outcome: Analysis) -> Table:
    columns: list[COLUMN] = [("", "left"), ("least", "right"), ("at deg", "right"), ("largest", "right"), ("at deg", "right")]
    table = grid("Extremes over the motion, at their exact crank angles", [*columns, ("", "left")], header=True)
    sizes = {name: max(abs(extreme.least), abs(extreme.largest)) for name, extreme in outcome.extremes.items()}
    scale = {u: max((s for name, s in sizes.items() if name.endswith(f"_{u}") and math.isfinite(s)), default=0.0) for u in UNITS}
    moving = {name for name, size in sizes.items() if size > 1e-9 * scale.get(name.rpartition("_")[2], 0.0)}  # else rounding
    for name, extreme in outcome.extremes.items():
        unit = next((unit for ending, unit in WORTH.items() if name.endswith(ending)), None)
        if unit is None or name not in moving or not math.isfinite(extreme.least):
            continue
        factor = math.degrees(1.0) if unit == "deg" else 1.0
        owner, _, what = name.rpartition(".")
        least, largest = (0.0 if abs(v) <= ROUNDING * sizes[name] else v for v in (extreme.least, extreme.largest))
        table.add_row(
            f"{owner}: {WORDS.get(what, what)}",
            number(least * factor, 7),
            fixed(math.degrees(extreme.least_at), 4),
            number(largest * factor, 7),
            fixed(math.degrees(extreme.largest_at), 4),
            Text(unit, style=QUIET),
        )
    return table


def _work(outcome: Analysis) -> Table:
    table = grid("Work of the drive", [("", "left"), ("", "right"), ("", "left")])
    scale = max((abs(v) for v in outcome.extremes.get("input.work_J", (0.0,))), default=0.0)
    work = 0.0 if abs(outcome.work) <= 1e-12 * scale else outcome.work  # rounding error of cancelling terms
    table.add_row(outcome.extent, number(work, 9), "J")
    if "input.work_J" in outcome.extremes:
        extreme = outcome.extremes["input.work_J"]
        for word, amount, at in (("least", *extreme[:2]), ("largest", *extreme[2:])):
            last = abs(amount - outcome.work) <= ROUNDING * scale < abs(amount)  # the end shares its crank angle with the start
            where = "the end" if last else f"{math.degrees(at):.4f} deg"
            table.add_row(f"{word} since the start", number(amount, 9), f"J at {where}")
    wheel = outcome.flywheel
    if wheel:
        table.add_row("mean torque", number(wheel.mean_torque), "N m")
        table.add_row("mean speed", number(wheel.mean_speed), "rad/s, mean over crank angle, not time")
        alone = "of the mean speed under it, without a flywheel"
        table.add_row(
            "fluctuation", number(wheel.fluctuation), alone if wheel.fluctuation > 0.0 else "without a flywheel: it would stop"
        )
        table.add_row("flywheel", number(wheel.inertia), f"kg m^2 at the crank keeps it at {wheel.allowed:g}")
    return table


def simulation(outcome: Simulation) -> RenderableType:
    """Summarise a forward dynamics simulation: final state, energy balance, drift and speed fluctuation."""
    found, course = outcome.figures, outcome.run
    title = Text(outcome.problem.model.title, style=HEAD)
    title.append(f"\n{course.ending.value}", style=GOOD if outcome.finished else BAD)
    title.append(f", driven by {outcome.driven}; {course.ending.text}")
    for note in outcome.notes:
        title.append(f"\nNote: {note}")
    end = grid("At the end", [("", "left"), ("", "right"), ("", "left")])
    end.add_row("time", number(found["end.time_s"], 9), "s")
    turns = found["end.crank_angle_rad"] / (2.0 * math.pi)
    end.add_row("crank angle", number(found["end.crank_angle_rad"], 10), f"rad ({turns:.4f} turns)")
    speed = found["end.speed_rad_s"]
    end.add_row("crank speed", number(speed, 10), f"rad/s ({speed * 30.0 / math.pi:.6g} rpm)")
    if "last_turn.mean_speed_rad_s" in found:
        mean, share = found["last_turn.mean_speed_rad_s"], found["last_turn.fluctuation"]
        end.add_row("last turn: mean speed", number(mean), f"rad/s, mean over time; fluctuation {share:.4%}")
    works = grid("Energy account", [("", "left"), ("", "right"), ("", "left")])
    for name, work in course.works.items():
        works.add_row("work of the drive" if name == "input" else f"work of {name}", number(float(work[-1]), 9), "J")
    works.add_row("kinetic and gravity's energy gained", number(float(course.energy[-1] - course.energy[0]), 9), "J")
    share = course.imbalance / course.turnover if course.turnover > 0.0 else 0.0
    works.add_row("largest imbalance on the way", f"{course.imbalance:.1e}", f"J, {share:.1e} of the largest amount")
    check = f"{course.drift:.1e} m, {course.drift_angle:.1e} rad"
    words = f"Drift of the twice integrated positions from the closed loops: at most {check}"
    tail = Text(f"{words}\n{course.steps} steps, {course.evaluations} evaluations", style=QUIET)
    return Group(title, Text(), end, Text(), works, Text(), tail)
