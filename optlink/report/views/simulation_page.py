"""HTML sections of a forward dynamics simulation: drive, output, reactions, energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.columns import slider_names
from optlink.dynamics.forward import Ending
from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import fixed_design
from optlink.report.format import number
from optlink.report.html.chart_plotly import Chart, Panel, Trace, line, stacked, thinned
from optlink.report.html.moving_linkage import Moving, Readout, Stops, decimals_of, even
from optlink.report.html.shell import Section
from optlink.report.scene import through
from optlink.report.stored.reader import Record
from optlink.report.stored.stored_study import Studied, figures_of, still
from optlink.report.style import BODIES, CRANK, Scale, scale
from optlink.report.table_spec import Paragraph, Part, TableSpec, quiet, table
from optlink.tasks.analyze import analyze
from optlink.tasks.machine import machine_of
from optlink.tasks.simulate import SCHEMA

__all__ = ["SCHEMA", "studied"]

Array = NDArray[np.float64]
Columns = Mapping[str, Array]
TIME = "time [s]"
AGREES = 1e-6  # tolerance of stored positions, as a share of the size of the machine
LINES = 10  # largest number of joint reactions
VERDICTS = {Ending.FINISHED: "Finished", Ending.AT_REST: "Came to rest"}


def studied(record: Record, file: ProblemFile) -> Studied:
    """Build the report of a stored forward dynamics simulation.

    Parameters
    ----------
    record : Record
    file : ProblemFile
        The problem that was simulated.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    columns, figures = record.columns("columns"), record.figures("figures")
    time, crank = record.column(columns, "time_s"), record.column(columns, "crank_angle_deg")
    if not len(time) or not np.all(np.diff(time) > 0.0) or not np.all(np.isfinite(crank)):
        raise record.fault("columns", "its times do not rise, or its crank angles are not known")
    if missing := [name for name in ("end.time_s", "end.speed_rad_s", "imbalance_J", "turnover_J") if name not in figures]:
        raise record.fault(f"figures.{missing[0]}", "this is missing")
    try:
        ending = Ending(record.text("status"))
    except ValueError:
        raise record.fault("status", "no simulation ends so", record.text("status")) from None
    mechanism = machine_of(file).mechanism
    sliders = list(slider_names(machine_of(file)).values())
    effort = f"{record.whole('steps'):,} steps, {record.whole('evaluations'):,} evaluations"
    curves = [
        *_drive(columns, mechanism.crank.body),
        *_output(columns, sliders[-1] if sliders else "", mechanism.links[-1].body),
        *_reactions(columns, {*mechanism.pins, *(guide.name for guide in mechanism.guides)}),
        *_work(columns),
    ]
    tables: list[Part] = [_end(figures, crank), _account(figures), Paragraph(quiet(f"{_drift(figures)}; {effort}"))]
    return Studied(
        problem=file,
        kind="simulation in time",
        verdict=VERDICTS.get(ending, f"Not finished: {ending.value}"),
        valid=record.flag("finished"),
        status=[f"{ending.value}, driven by {record.text('driven')}; {record.text('message')}", *record.texts("notes")],
        sections=[*figures_of(tables), *([Section("Over time", curves)] if len(time) > 1 else [])],
        moving=_moving(file, columns, mechanism.crank.body, _sizes(record, file)) if len(time) > 1 else still,
        by=f"integration in time; driven by {record.text('driven')}",
        drawn="As the crank turned in time: the slider goes from row to row of the simulation.",
    )


# --- tables ------------------------------------------------------------------------------------------------------------------


def _end(figures: Mapping[str, float], crank: Array) -> TableSpec:
    speed = figures["end.speed_rad_s"]
    rows = [
        ("time", number(figures["end.time_s"], 9), "s"),
        ("crank angle", number(float(crank[-1]), 9), f"deg, {abs(crank[-1] - crank[0]) / 360.0:.4f} turns from the start"),
        ("crank speed", number(speed, 9), f"rad/s, {speed * 30.0 / math.pi:.6g} rpm"),
    ]
    if "last_turn.mean_speed_rad_s" in figures:
        share = f"rad/s, mean over time; fluctuation {figures.get('last_turn.fluctuation', math.nan):.4%}"
        rows.append(("last turn: mean speed", number(figures["last_turn.mean_speed_rad_s"]), share))
    return table("At the end", "<><", rows)


def _account(figures: Mapping[str, float]) -> TableSpec:
    works = {name.removesuffix(".work_J"): work for name, work in figures.items() if name.endswith(".work_J")}
    rows = [("work of the drive" if name == "input" else f"work of {name}", number(work, 9), "J") for name, work in works.items()]
    largest = figures["turnover_J"]
    share = figures["imbalance_J"] / largest if largest > 0.0 else 0.0
    rows += [
        ("their sum: energy gained", number(sum(works.values()), 9), "J, kinetic and of gravity"),
        ("largest imbalance on the way", f"{figures['imbalance_J']:.1e}", f"J, {share:.1e} of the largest amount"),
    ]
    return table("Energy account", "<><", rows)


def _drift(figures: Mapping[str, float]) -> str:
    drift = f"{figures.get('drift_m', math.nan):.1e} m, {figures.get('drift_rad', math.nan):.1e} rad"
    return f"Drift of the twice integrated positions from the closed loops: at most {drift}"


# --- curves ------------------------------------------------------------------------------------------------------------------


def largest(columns: Columns, names: Iterable[str]) -> float:
    """Return the largest absolute finite value in columns [SI].

    Parameters
    ----------
    columns : mapping of str to array (n,)
    names : iterable of str
        Columns to consider.
    """
    every = [np.abs(columns[name]) for name in names]
    return max((float(np.max(one, initial=0.0, where=np.isfinite(one))) for one in every), default=0.0)


def timed(
    columns: Columns, name: str, shown: Scale | float, words: str, colour: str, dash: str = "solid", width: float = 2.0
) -> Trace:
    """Return a column over time as a trace.

    Parameters
    ----------
    columns : mapping of str to array (n,) [SI]
        Contains "time_s".
    name : str
        Column name.
    shown : Scale or float
        Display unit, or factor from SI to it.
    words : str
        Entry in the legend.
    colour : str
    dash : str, optional
        Line style of plotly.
    width : float [pixel], optional
    """
    factor = shown.factor if isinstance(shown, Scale) else shown
    x, y = thinned(columns["time_s"], columns[name] * factor)
    return line(x, y, words, colour, width=width, dash=dash)


def _quiet(traces: list[Trace]) -> list[Trace]:
    """Return the traces without legend entries."""
    return [trace | {"showlegend": False} for trace in traces]


def _drive(columns: Columns, body: str) -> list[Chart]:
    """Plot crank speed and driving torque."""
    panels = []
    if f"{body}.omega_rad_s" in columns:
        rpm = 30.0 / math.pi
        panels.append(Panel("crank speed [rpm]", _quiet([timed(columns, f"{body}.omega_rad_s", rpm, "crank speed", CRANK)])))
    if "input.torque_Nm" in columns:
        shown = scale(largest(columns, ["input.torque_Nm"]), "N m")
        torque = _quiet([timed(columns, "input.torque_Nm", shown, "driving torque", BODIES[0])])
        panels.append(Panel(f"driving torque [{shown.unit}]", torque))
    return [Chart("Drive", stacked(panels, TIME))] if panels else []


def _output(columns: Columns, slider: str, body: str) -> list[Chart]:
    """Plot position, velocity and acceleration of the last slider, otherwise of the last body."""
    words = ("position", "velocity", "acceleration") if slider else ("angle", "angular velocity", "angular acceleration")
    endings = (".s_m", ".v_m_s", ".a_m_s2") if slider else (".angle_rad", ".omega_rad_s", ".alpha_rad_s2")
    units = ("m", "m/s", "m/s²") if slider else ("deg", "rad/s", "rad/s²")
    name, panels = slider or body, []
    for word, ending, unit in zip(words, endings, units, strict=True):
        if name + ending in columns:
            unwrapped = {**columns, name + ending: np.unwrap(columns[name + ending])} if unit == "deg" else columns
            shown = scale(largest(columns, [name + ending]), unit)
            panels.append(Panel(f"{word} [{shown.unit}]", _quiet([timed(unwrapped, name + ending, shown, word, BODIES[1])])))
    return [Chart(f"Motion of {name}", stacked(panels, TIME))] if panels else []


def _reactions(columns: Columns, joints: Container[str]) -> list[Chart]:
    """Plot the magnitudes of the joint reactions; a pin of three bodies has two."""
    forces = {name: values for name, values in columns.items() if name.partition(".")[0] in joints}
    for name in [name for name in forces if name.endswith(".fx_N") and name.replace(".fx_N", ".fy_N") in forces]:
        forces[name.replace(".fx_N", ".f_N")] = np.hypot(forces[name], forces[name.replace(".fx_N", ".fy_N")])
    names = [name for name in forces if name.endswith((".f_N", ".normal_N")) and largest(forces, [name]) > 0.0][:LINES]
    forces["time_s"] = columns["time_s"]
    if not names:
        return []
    shown = scale(largest(forces, names), "N")
    curves = [
        timed(
            forces,
            name,
            shown,
            name.rpartition(".")[0],
            BODIES[k % len(BODIES)],
            dash="solid" if name.endswith(".f_N") else "dash",
        )
        for k, name in enumerate(names)
    ]
    return [Chart("Joint reactions", stacked([Panel(f"force [{shown.unit}]", curves, 1.6)], TIME))]


def _work(columns: Columns) -> list[Chart]:
    """Plot the work of the drive and the kinetic and potential energy."""
    names = {"input.work_J": ("work of the drive", CRANK), "energy.kinetic_J": ("kinetic energy", BODIES[0])}
    names["energy.potential_J"] = ("potential energy", BODIES[2])
    known = [name for name in names if name in columns and largest(columns, [name]) > 0.0]
    if not known:
        return []
    shown = scale(largest(columns, known), "J")
    curves = [timed(columns, name, shown, *names[name]) for name in known]
    return [Chart("Energy", stacked([Panel(f"energy [{shown.unit}]", curves, 1.4)], TIME))]


# --- animation ---------------------------------------------------------------------------------------------------------------


def _sizes(record: Record, file: ProblemFile) -> dict[str, float]:
    """Return the dimensions [SI] of the simulated machine; those of the problem if none were stored."""
    machine, names = machine_of(file), file.model.mechanism.quantities
    if not record.has("sizes_SI"):
        return {name: float(np.asarray(machine.sizes[name])) for name in names}
    recorded = record.figures("sizes_SI")
    if missing := [name for name in names if name not in recorded]:
        raise record.fault(f"sizes_SI.{missing[0]}", "this is missing")
    return recorded


def _moving(file: ProblemFile, columns: Columns, body: str, sizes: Mapping[str, float]) -> Callable[[int], Moving | None]:
    """Return a function that animates the linkage at rows of the simulation, if the stored positions match its dimensions."""

    def made(steps: int) -> Moving | None:
        try:
            cycle = analyze(fixed_design(file, sizes))
        except InputError:
            return None
        rows = even(len(columns["time_s"]), steps + 1)
        drawn = through(cycle, np.radians(columns["crank_angle_deg"][rows]))
        for name, places in drawn.points.items():
            if {f"{name}.x_m", f"{name}.y_m"} <= columns.keys():
                own = np.stack([columns[f"{name}.x_m"][rows], -columns[f"{name}.y_m"][rows]], axis=1) * 1e3
                if np.nanmax(np.abs(own - places), initial=0.0) > AGREES * max(drawn.box[2:]):
                    return None  # the stored positions belong to a different machine
        time = columns["time_s"][rows]
        listed = [Readout("crank angle", "deg", [round(float(value), 4) for value in columns["crank_angle_deg"][rows]])]
        for name, words, unit in ((f"{body}.omega_rad_s", "crank speed", "rad/s"), ("input.torque_Nm", "driving torque", "N m")):
            if name in columns:
                shown = scale(largest(columns, [name]), unit)
                values = [None if math.isnan(v) else round(float(v) * shown.factor, 4) for v in columns[name][rows]]
                listed.append(Readout(words, shown.unit, values))
        return Moving(drawn, Stops("time", " s", time, decimals_of(time)), listed)

    return made
