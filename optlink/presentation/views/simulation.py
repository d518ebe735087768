"""Charts and page of a simulation in time: speed and torque, output, bodies, reactions, energy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.dynamics.columns import efforts
from optlink.dynamics.forward import Ending
from optlink.dynamics.freedoms import freed
from optlink.dynamics.machine import slider_names
from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import TURN
from optlink.presentation.chart_spec import (
    BODIES,
    CRANK,
    MUTED,
    RESULT,
    TARGET,
    TIME,
    Array,
    Axis,
    ChartSpec,
    Curve,
    Panel,
    max_abs,
)
from optlink.presentation.format import Scale, figure, scale, si
from optlink.presentation.scene import colours_of
from optlink.presentation.shapes import even
from optlink.presentation.view import PageSection, StoredStudy, View
from optlink.presentation.views import analysis_tables
from optlink.presentation.views.analysis_charts import MAX_BODIES, ROUNDING, look, together
from optlink.tasks.analyze import reaction_conventions
from optlink.tasks.simulate import Simulation, freedoms_of
from optlink.units import percent

if TYPE_CHECKING:
    from optlink.presentation.html.moving_linkage import Moving


RPM = 30.0 / math.pi
MAX_REACTIONS = 10  # largest number of joint reactions
MAX_FRAME_JOINTS = 4  # largest number of joints of the frame whose forces are shown by components


def _curve(run: Simulation, name: str, factor: float, words: str, colour: str, **style: Any) -> Curve:
    """Return a column times a factor, the display unit per SI unit, over time as a curve."""
    return Curve(run["time_s"], run[name] * factor, words, colour, gid=name, **style)


def largest(columns: Mapping[str, Array], names: Iterable[str]) -> float:
    """Return the largest absolute finite value in columns [SI]."""
    return max((max_abs(columns[name]) for name in names), default=0.0)


def charts(run: Simulation) -> list[ChartSpec]:
    """Return the charts of a simulation in time; none if the machine did not move."""
    return [*drive(run), *output(run), *bodies(run), *reactions(run), *energy(run)] if len(run["time_s"]) > 1 else []


def drive(run: Simulation) -> list[ChartSpec]:
    """Plot crank speed and driving torque, and the mean speed of the last revolution if it was completed."""
    panels, (speed, words, unit, factor) = [], _speed(run)
    if speed in run.columns:
        values = run.columns[speed] * factor
        curves, note = [_curve(run, speed, factor, words, CRANK, legend=False)], ""
        if "last_turn.mean_speed_rad_s" in run.figures:
            mean_speed, share = run.figures["last_turn.mean_speed_rad_s"], run.figures.get("last_turn.fluctuation", math.nan)
            mean, crank = math.copysign(mean_speed, values[-1]) * RPM, run.position
            revolutions = run.figures.get("last_turn.revolutions", 1.0)
            turned = np.abs(crank - crank[-1]) <= 360.0 * revolutions * (1.0 + 1e-12)
            over = run["time_s"][turned]
            curves.append(Curve(over, np.full(len(over), mean), "mean", TARGET, 1.2, "dash", legend=False, gid="mean"))
            note = (
                f"last {'turn' if revolutions == 1.0 else 'cycle'}: mean over time {mean_speed:.4g} rad/s "
                f"({mean_speed * RPM:.4g} rpm), fluctuation {percent(share, 2)}"
            )
        rise, most = np.ptp(values), np.max(np.abs(values))
        room = 0.16 * rise if rise > ROUNDING * most else 0.1 * most or 1.0
        limits = np.min(values) - room, np.max(values) + 0.4 * room
        panels.append(Panel(Axis(f"{words} [{unit}]", limits), curves, 1.4, note=note))
    for k, effort in enumerate(efforts(run.machine.mechanism)):
        torque, most = run[effort.column], largest(run.columns, [effort.column])
        shown = scale(most, effort.unit)
        limits_ = None
        if np.ptp(torque) < 1e-6 * most:  # constant torque: start at zero instead of showing rounding errors
            low, high = sorted((0.0, 1.15 * torque[0] * shown.factor))
            limits_ = low, high
        curve = _curve(run, effort.column, shown.factor, effort.words, BODIES[k % len(BODIES)], legend=False)
        panels.append(Panel(Axis(f"{effort.words} [{shown.unit}]", limits_), [curve]))
    heading = f"{run.problem.model.title}: driven by {run.driven}, {run.ending.value}"
    return [ChartSpec("drive", "Drive", panels, Axis(TIME), heading)] if panels else []


def _speed(run: Simulation) -> tuple[str, str, str, float]:
    """Return the column of the speed of the (first) drive, its words, its display unit, and that per SI unit."""
    mechanism = run.machine.mechanism
    body = mechanism.crank.body
    if mechanism.drives and mechanism.drives[0].kind != "angle":
        return f"{body}.v_m_s", "speed of the drive", "mm/s", 1e3
    return f"{body}.omega_rad_s", "crank speed", "rpm", RPM


def output(run: Simulation) -> list[ChartSpec]:
    """Plot position, velocity and acceleration of the last slider, otherwise of the last body."""
    sliders = list(slider_names(run.machine).values())
    name = sliders[-1] if sliders else run.machine.mechanism.links[-1].body
    rows = [("position", ".s_m", "m"), ("velocity", ".v_m_s", "m/s"), ("acceleration", ".a_m_s2", "m/s²")]
    if not sliders:
        rows = [("angle", ".angle_rad", "deg"), ("angular velocity", ".omega_rad_s", "rad/s")]
        rows.append(("angular acceleration", ".alpha_rad_s2", "rad/s²"))
    panels: list[Panel] = []
    for word, ending, unit in rows:
        if name + ending in run.columns:
            values = np.unwrap(run[name + ending]) if unit == "deg" else run[name + ending]
            shown = scale(largest(run.columns, [name + ending]), unit)
            curve = Curve(run["time_s"], values * shown.factor, word, BODIES[1], legend=False, gid=name + ending)
            panels.append(Panel(Axis(f"{word} [{shown.unit}]"), [curve]))
    return [ChartSpec("output", f"Motion of {name}", panels, Axis(TIME), f"{run.problem.model.title}: {name}")] if panels else []


def bodies(run: Simulation) -> list[ChartSpec]:
    """Plot the angular velocities of the bodies that turn, but that of the crank, which `drive` shows."""
    bodies, crank = colours_of(run.machine.mechanism), run.machine.mechanism.crank.body
    colours = {f"{body}.omega_rad_s": colour for body, colour in bodies.items()}
    names = {body: f"{body}.omega_rad_s" for body in bodies if body != crank}
    floor = 1e-8 * largest(run.columns, colours.keys() & run.columns.keys())
    turning = {body: name for body, name in names.items() if name in run.columns and largest(run.columns, [name]) > floor}
    shown = dict(list(together(run.columns, turning).items())[:MAX_BODIES])
    curves = []
    for k, (label, name) in enumerate(shown.items()):
        width, dash = look(k, len(shown))
        curves.append(_curve(run, name, 1.0, label, colours[name], width=width, dash=dash))
    panels, heading = [Panel(Axis("angular velocity [rad/s]"), curves, 1.6)], f"{run.problem.model.title}: rotation of the bodies"
    return [ChartSpec("bodies", "Rotation of the bodies", panels, Axis(TIME), heading)] if curves else []


def reactions(run: Simulation) -> list[ChartSpec]:
    """Plot the forces of the frame at its pins and guides, and the magnitudes of all joint reactions."""
    mechanism, columns, conventions = run.machine.mechanism, run.columns, reaction_conventions(run.machine)
    guides = {guide.name: guide for guide in mechanism.guides}
    parts = {name: [f"{name}.normal_N"] if name in guides else [f"{name}.fx_N", f"{name}.fy_N"] for name in conventions}
    amounts = {name: np.linalg.norm([columns[one] for one in pair], axis=0) for name, pair in parts.items() if pair[0] in columns}
    names = [name for name in amounts if largest(amounts, [name]) > 0.0][:MAX_REACTIONS]
    if not names:
        return []
    panels: list[Panel] = []
    for name in names:
        joint = name.partition(".")[0]
        of_frame = guides[joint].on == FRAME if joint in guides else FRAME in mechanism.pins[joint]
        if of_frame and len(panels) < MAX_FRAME_JOINTS:
            unit = scale(largest(run.columns, parts[name]), "N")
            x, *y = parts[name]
            pair = [_curve(run, x, unit.factor, "in x" if y else "", RESULT)]
            pair += [_curve(run, one, unit.factor, "in y", CRANK, dash="dash") for one in y]
            panels.append(Panel(Axis(f"{name} [{unit.unit}]\n{conventions[name].partition(',')[0]}"), pair, 0.9))
    unit = scale(largest(amounts, names), "N")
    curves = []
    for k, name in enumerate(names):
        width, dash = look(k, len(names))
        curves.append(Curve(columns["time_s"], amounts[name] * unit.factor, name, BODIES[k % len(BODIES)], width, dash))
    panels.append(Panel(Axis(f"amount of force [{unit.unit}]"), curves, 1.6))
    return [ChartSpec("reactions", "Joint reactions", panels, Axis(TIME), f"{run.problem.model.title}: joint reactions")]


def energy(run: Simulation) -> list[ChartSpec]:
    """Plot the work of drive, loads and friction, the energies, and the imbalance of the energy account."""
    columns, turnover = run.columns, run.figures.get("turnover_J", 0.0)
    works = [name for name in columns if name.endswith(".work_J")]
    stored = [name for name in ("energy.kinetic_J", "energy.potential_J") if name in columns]
    if turnover <= 0.0 or not works:
        return []
    shown = scale(turnover, "J")
    above = []
    for k, name in enumerate(works):
        colour = CRANK if name == "input.work_J" else BODIES[(k - 1) % len(BODIES)]
        what = "drive" if name == "input.work_J" else name.removesuffix(".work_J")
        above.append(_curve(run, name, shown.factor, f"work of {what}", colour))
    for name, words, colour in zip(stored, ("kinetic energy", "potential energy"), BODIES[3:], strict=False):
        if largest(run.columns, [name]) > 0.0:
            above.append(_curve(run, name, shown.factor, words, colour, width=1.2, dash="dashdot"))
    panels = [Panel(Axis(f"energy [{shown.unit}]"), above, 2.0)]
    if all(name in columns for name in run.figures if name.endswith(".work_J")):
        above.append(
            _curve(run, "energy.gained_J", shown.factor, "gain of kinetic and potential energy", TARGET, width=1.4, dash="dash")
        )
        missing = np.abs(columns["energy.gained_J"] - sum(columns[name] for name in works)) / turnover
        share = Curve(columns["time_s"], np.maximum(missing, 1e-17), "imbalance", MUTED, 1.2, legend=False, gid="imbalance")
        limits = 1e-17, max(1e-8, 10.0 * np.max(missing))
        panels.append(Panel(Axis("imbalance / largest", limits, "log"), [share]))
    return [ChartSpec("energy", "Energy", panels, Axis(TIME), f"{run.problem.model.title}: energy account")]


VERDICTS = {Ending.FINISHED: "Finished", Ending.AT_REST: "Came to rest", Ending.AT_STOP: "Came to rest at its end stop"}


def page(run: Simulation) -> StoredStudy:
    """Return the page of a simulation in time."""
    curves = charts(run)
    return StoredStudy(
        problem=run.problem,
        kind="simulation in time",
        verdict=VERDICTS.get(run.ending, f"Not finished: {run.ending.value}"),
        valid=run.valid,
        conclusion=conclusion(run),
        status=[f"{run.ending.value}, driven by {run.driven}{analysis_tables.unnoted(run)}", *run.notes],
        sections=[PageSection("Figures", (analysis_tables.simulation(run).parts,)), PageSection("Over time", curves)],
        moving=partial(_moving, run) if curves else None,
        by=f"integration in time; driven by {run.driven}",
        drawn="As the machine moved in time: the slider goes from row to row of the simulation.",
    )


def _moving(run: Simulation, steps: int) -> Moving | None:
    """Animate the linkage at rows of the simulation."""
    from optlink.presentation.html.study_page import in_time

    (speed, what, _, _), rows = _speed(run), even(len(run["time_s"]), steps + 1)
    crank = run.position[rows]
    drives = run.machine.mechanism.drives
    shown = [] if drives else [("crank angle", Scale(1.0, "deg"), crank)]
    every = [(effort.column, effort.words, effort.unit) for effort in efforts(run.machine.mechanism)]
    angles = [(f"{drive.body}.angle_rad", f"angle of {drive.body}", "deg") for drive in drives if drive.kind == "angle"]
    own = [(speed, what, "m/s" if speed.endswith("m_s") else "rad/s")] if len(drives) < 2 else []
    for name, words, unit in (*angles, *own, *every):
        if name in run.columns:
            shown.append((words, scale(largest(run.columns, [name]), unit), run[name][rows]))
    machine, free = run.machine, _free_coordinates(run)
    if free:
        machine = freed(machine, freedoms_of(run.problem, machine))
        machine = machine.with_(sizes={**machine.sizes, **{name: values[rows] for name, values in free.items()}})
    return in_time(run.problem, run.sizes, run["time_s"][rows], crank, shown, machine if free else None)


def _free_coordinates(run: Simulation) -> dict[str, Array]:
    """Return the coordinates [rad, m] of drives that moved freely, by their names among the sizes of the freed machine."""
    found = {}
    for freedom in freedoms_of(run.problem, run.machine) if run.free else ():
        drive = freedom.drive
        if drive.kind == "angle":
            along = run[f"{drive.body}.angle_rad"]
            found[freedom.size] = along if drive.against == FRAME else along - run[f"{drive.against}.angle_rad"]
        else:
            guides = [guide.name for guide in run.machine.mechanism.guides if guide.slider == drive.body]
            name = f"{drive.body}.length_m" if drive.size else f"{slider_names(run.machine)[guides[0]]}.s_m"
            found[freedom.size] = run[name]
    return found


def conclusion(result: Simulation) -> str:
    """Return the conclusion of a simulation in time."""
    figures = result.figures
    text = f"After {figure(figures['end.time_s'], 's')} "
    if "end.speed_rad_s" in figures:
        text += f"the crank turns at {figure(figures['end.speed_rad_s'] * RPM, 'rpm')}, "
        text += f"{figure(figures['end.crank_angle_rad'] / TURN)} revolutions from its zero position"
    elif "end.speed_m_s" in figures:
        text += f"the {result.problem.model.driving.coordinate} is {figure(1e3 * figures['end.position_m'], 'mm')}, "
        text += f"its speed {figure(1e3 * figures['end.speed_m_s'], 'mm/s')}"
    else:
        text += "the motion ends"
    if "last_turn.fluctuation" in figures:
        last = "cycle" if "last_turn.revolutions" in figures else "revolution"
        text += f"; its speed fluctuates by {100.0 * figures['last_turn.fluctuation']:z.2f} % in the last {last}"
    if "input.work_J" in figures:
        text += f"; the drive has done {si(figures['input.work_J'], 'J')} of work"
    return f"{text}." if result.valid else f"Not finished: {result.ending.text}. {text}."


VIEW = View(analysis_tables.simulation, charts=charts, tables=lambda run: {"course": run.columns}, page=page)
