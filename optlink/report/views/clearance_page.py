"""HTML sections of a simulation with joint clearance and of a control comparison."""

from __future__ import annotations

import math
from collections.abc import Callable
from html import escape

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.controller import Control
from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.clearance.output import outputs
from optlink.clearance.statistics import Prediction
from optlink.dynamics.forward import Ending
from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import fixed_design
from optlink.problem.mechanism import sizes_of
from optlink.report.html.chart_plotly import Chart, Panel, Trace, axis, line, sheet, short, stacked, thinned
from optlink.report.html.moving_linkage import Moving, Readout, Stops, decimals_of, even
from optlink.report.html.shell import Section
from optlink.report.scene import through
from optlink.report.stored.reader import Record
from optlink.report.stored.stored_study import Studied, figures_of, still
from optlink.report.style import BODIES, CRANK, FOUND, GROUND, LIMIT, QUIET, Scale, scale
from optlink.report.views import clearance_tables
from optlink.report.views.revolutions import WINDOW, Turns
from optlink.report.views.simulation_page import TIME, largest, timed
from optlink.tasks.analyze import analyze
from optlink.tasks.control_comparison import SCHEMA as COMPARISON
from optlink.tasks.control_comparison import Comparison, Trials
from optlink.tasks.machine import machine_of
from optlink.tasks.results.clearance import SCHEMA, ClearanceSimulation

__all__ = ["COMPARISON", "SCHEMA", "compared", "studied"]

Array = NDArray[np.float64]
PEAKS = ("normal_max_N", "penetration_max_m")
CIRCLE = np.linspace(0.0, 2.0 * math.pi, 181)


# --- reading -----------------------------------------------------------------------------------------------------------------


def read(record: Record, file: ProblemFile) -> ClearanceSimulation:
    """Read a stored simulation with clearance.

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
    machine = machine_of(file)
    known = outputs(machine)
    if record.text("output") not in known:
        raise record.fault("output", "the problem has no such output", record.text("output"))
    gaps = tuple(_gap(one) for one in record.records("gaps"))
    try:
        control, ending = Control(record.text("control")), Ending(record.text("status"))
    except ValueError as error:
        raise record.fault("status", f"{error}") from None
    predicted = record.record("prediction") if record.has("prediction") else None
    found = ClearanceSimulation(
        problem=file,
        machine=machine,
        gaps=gaps,
        output=known[record.text("output")],
        control=control,
        speed=record.number("speed_rad_s"),
        start=record.number("start_rad"),
        sample_time=record.number("sample_time_s") if record.has("sample_time_s") else None,
        columns=record.columns("columns"),
        meanings={},
        turns=record.columns("turns"),
        impacts=tuple(_impact(one, gaps) for one in record.records("impacts")),
        section=record.columns("section"),
        figures=record.figures("figures"),
        prediction=None if predicted is None else _prediction(predicted),
        ending=ending,
        stopped=record.maybe("stopped_s"),
        message=record.text("message"),
        notes=record.texts("notes"),
        tolerance=record.number("tolerance"),
    )
    _whole(record, found)
    return found


def _gap(record: Record) -> Gap:
    texts = {name: record.text(name) for name in ("point", "journal", "bearing", "law")}
    numbers = ("clearance", "radius", "stiffness", "restitution", "friction", "slip_speed", "damping")
    return Gap(**texts, **{name: record.number(name) for name in numbers})  # type: ignore[arg-type]


def _impact(record: Record, gaps: tuple[Gap, ...]) -> Impact:
    names = [gap.point for gap in gaps]
    if record.text("gap") not in names:
        raise record.fault("gap", "no joint of that name has a clearance", record.text("gap"))
    return Impact(names.index(record.text("gap")), *(record.maybe(name) for name in Impact._fields[1:]))


def _prediction(record: Record) -> Prediction:
    parted = record.number("parted_revolutions") if record.has("parted_revolutions") else None
    return Prediction(parted, record.whole("watched"), math.nan)


def _whole(record: Record, found: ClearanceSimulation) -> None:
    """Check that the record contains everything that the report needs."""
    unit = found.output.unit
    for name in ("revolutions", "settled_revolutions"):
        record.record("figures").number(name)
    if not found.revolutions:
        return
    points = [gap.point for gap in found.gaps]
    asked = {
        "figures": [
            f"rms_{unit}",
            f"mean_square_{unit}2",
            f"peak_{unit}",
            "torque_rms_Nm",
            "torque_max_Nm",
            "correction_max_rad",
            *(f"{name}.{what}" for name in points for what in PEAKS),
        ],
        "turns": [
            *(f"rms_{unit}", "torque_max_Nm"),
            *(f"{name}.{what}" for name in points for what in ("contact_share", *PEAKS)),
        ],
        "section": ["revolution", f"{found.output.name}.error_{unit}"],
        "columns": [
            *(
                "time_s",
                "crank_angle_deg",
                "input.torque_Nm",
                f"{found.output.name}.error_{unit}",
                f"{found.output.name}.ideal_{unit}",
            ),
            *(f"{name}.{what}" for name in points for what in ("ex_m", "ey_m", "contact", "penetration_m", "normal_N")),
        ],
    }
    asked["figures"] += ["correction_rms_rad", "imbalance_J", "largest_energy_J"]
    for table, names in asked.items():
        held = getattr(found, table)
        for name in names:
            if name not in held or (table == "figures" and math.isnan(held[name])):
                peak = "_max_" in name and table == "turns"
                message = "an earlier version wrote this result, without the largest values between rows"
                raise record.fault(f"{table}.{name}", "this is missing") if not peak else record.old(f"{table}.{name}", message)
    if len(found.columns["time_s"]) < 2 or not np.all(np.diff(found.columns["time_s"]) > 0.0):
        raise record.fault("columns.time_s", "its times do not rise")


# --- the page ----------------------------------------------------------------------------------------------------------------


def studied(record: Record, file: ProblemFile) -> Studied:
    """Build the report of a stored simulation with clearance.

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
    found = read(record, file)
    shown = clearance_tables.simulation(found)
    sections = list(figures_of(shown.parts))
    if found.revolutions:
        turns = Turns(found)
        sections.append(Section("Orbits in the gaps", [_orbit(turns, gap) for gap in found.gaps]))
        sections.append(Section("Curves", [*_time(turns), *_turns(turns), *_impacts(turns), *_section(turns)]))
    control = "" if found.control is Control.NONE else f"; control: {found.control}"
    return Studied(
        problem=file,
        kind="simulation with clearance",
        verdict="Finished" if found.finished else f"Not finished: {found.ending.value}",
        valid=found.finished,
        status=shown.status.lines,
        sections=sections,
        moving=_moving(found),
        by=f"event-driven integration of all bodies, tolerance {found.tolerance:g}{control}",
        drawn="Its last revolutions, drawn without the clearance, which is too small to be seen; the gaps are drawn below.",
    )


def _rows(turns: Turns) -> slice:
    """Return the rows of the last revolutions, which are drawn."""
    return turns.rows(WINDOW)


def _orbit(turns: Turns, gap: Gap) -> Chart:
    """Plot the orbit of the journal centre in its bearing over the last revolutions, with equal scales."""
    found, rows = turns.result, _rows(turns)
    unit = scale(gap.clearance, "m")
    x, y = (found[f"{gap.point}.e{way}_m"][rows] * unit.factor for way in "xy")
    touching = found[f"{gap.point}.contact"][rows] > 0.5
    round_ = gap.clearance * unit.factor
    curves = [line(round_ * np.cos(CIRCLE), round_ * np.sin(CIRCLE), "clearance", GROUND, width=1.2)]
    for mask, words, colour in ((~touching, "apart", FOUND), (touching, "in contact", LIMIT)):
        if mask.any():
            own = mask | np.roll(mask, 1)  # extend to the next row, so that the path has no gaps
            curves.append(line(np.where(own, x, np.nan), np.where(own, y, np.nan), words, colour, width=1.3))
    layout = sheet(460) | {"hovermode": "closest"}
    layout["xaxis"] = axis(f"x [{unit.unit}]") | {"constrain": "domain"}
    layout["yaxis"] = axis(f"y [{unit.unit}]") | {"scaleanchor": "x", "constrain": "domain"}
    deepest = turns.peak(f"{gap.point}.penetration_m", WINDOW)
    remark = f"Centre of {gap.journal} from that of {gap.bearing}, {turns.span(WINDOW)}; penetration at most "
    remark += f"{deepest * 1e6:.3g} µm, {deepest / gap.clearance:.2%} of the clearance."
    return Chart(
        f"Joint {gap.point}: the journal's centre in its bearing", {"data": curves, "layout": layout}, False, remark=remark
    )


def _error(turns: Turns) -> Scale:
    unit = turns.result.output.unit
    return scale(turns.rms, "m") if unit == "m" else Scale(math.degrees(1.0), "deg", 4)


def _time(turns: Turns) -> list[Chart]:
    """Plot deviation, contact forces and driving torque over the last revolutions."""
    found, rows = turns.result, _rows(turns)
    columns = {name: values[rows] for name, values in found.columns.items()}
    shown, name = _error(turns), f"{found.output.name}.error_{found.output.unit}"
    panels = [Panel(f"deviation [{shown.unit}]", [timed(columns, name, shown, f"deviation of {found.output.name}", LIMIT)])]
    forces = [f"{gap.point}.normal_N" for gap in found.gaps]
    force = scale(largest(columns, forces), "N")
    curves = [
        timed(columns, one, force, f"contact force at {one.partition('.')[0]}", BODIES[k % len(BODIES)], width=1.2)
        for k, one in enumerate(forces)
    ]
    panels.append(Panel(f"contact force [{force.unit}]", curves, 1.3))
    torque = scale(largest(columns, ["input.torque_Nm"]), "N m")
    panels.append(
        Panel(f"torque [{torque.unit}]", [timed(columns, "input.torque_Nm", torque, "driving torque", CRANK, width=1.2)])
    )
    return [Chart(f"Over time, {turns.span(WINDOW)}", stacked(panels, TIME))]


def _turns(turns: Turns) -> list[Chart]:
    """Plot the deviation and the largest contact forces of every revolution."""
    found, unit = turns.result, turns.result.output.unit
    numbers = found.turns.get("revolution", np.arange(1.0, len(found.turns[f"rms_{unit}"]) + 1.0))
    if len(numbers) < 3:
        return []
    shown = _error(turns)
    mode = "lines+markers" if len(numbers) < 100 else "lines"
    rms = [line(*thinned(numbers, found.turns[f"rms_{unit}"] * shown.factor), "deviation, rms", LIMIT, mode=mode)]
    names = {gap.point: f"{gap.point}.normal_max_N" for gap in found.gaps}
    force = scale(largest(found.turns, names.values()), "N")
    forces = [
        line(*thinned(numbers, found.turns[name] * force.factor), f"largest force at {point}", BODIES[k % len(BODIES)], mode=mode)
        for k, (point, name) in enumerate(names.items())
    ]
    panels = [Panel(f"deviation [{shown.unit}]", rms), Panel(f"force [{force.unit}]", forces, 1.2)]
    return [Chart("Revolution by revolution", stacked(panels, "revolution"), cranked=False)]


def _impacts(turns: Turns) -> list[Chart]:
    """Plot crank angle and approach speed of the impacts."""
    found, curves = turns.result, []
    for k, gap in enumerate(found.gaps):
        own = [one for one in found.impacts if one.gap == k and math.isfinite(one.approach)][-2000:]
        if own:
            angle = np.mod(np.degrees([one.crank_angle for one in own]), 360.0)
            speed = np.array([one.approach for one in own]) * 1e3
            curves.append(line(angle, speed, f"at {gap.point}", BODIES[k % len(BODIES)], width=5.0, mode="markers"))
    if not curves:
        return []
    figure = stacked([Panel("approach speed [mm/s]", curves, 1.3)])
    figure["layout"]["xaxis"] |= {"range": [0.0, 360.0], "dtick": 60}
    return [
        Chart(
            "Impacts: where contacts begin, and how fast", figure | {"layout": figure["layout"] | {"hovermode": "closest"}}, False
        )
    ]


def _section(turns: Turns) -> list[Chart]:
    """Plot the deviation at the end of every revolution (Poincaré section); it is constant for a periodic motion."""
    found = turns.result
    values = found.section[f"{found.output.name}.error_{found.output.unit}"]
    if len(values) < 3:
        return []
    shown = _error(turns)
    points = line(
        *thinned(found.section["revolution"], values * shown.factor),
        "at the end of a revolution",
        FOUND,
        width=5.0,
        mode="markers",
    )
    figure = stacked([Panel(f"deviation [{shown.unit}]", [points])], "revolution")
    return [Chart("Deviation at the ends of the revolutions", figure, cranked=False)]


def _moving(found: ClearanceSimulation) -> Callable[[int], Moving | None]:
    """Return a function that animates the machine without clearance over the last revolutions."""
    file = found.problem

    def made(steps: int) -> Moving | None:
        if not found.revolutions:
            return None
        try:
            cycle = analyze(fixed_design(file, sizes_of(file.model.mechanism.quantities)))
        except InputError:
            return None
        turns = Turns(found)
        span = _rows(turns)
        rows = span.start + even(span.stop - span.start, steps + 1)
        time, crank = found["time_s"][rows], found["crank_angle_deg"][rows]
        unit = _error(turns)
        torque = scale(largest(found.columns, ["input.torque_Nm"]), "N m")
        names = [
            ("crank angle", "deg", np.mod(crank, 360.0)),
            (f"deviation of {found.output.name}", unit.unit, turns.error[rows] * unit.factor),
        ]
        names.append(("driving torque", torque.unit, found["input.torque_Nm"][rows] * torque.factor))
        force = scale(largest(found.columns, [f"{gap.point}.normal_N" for gap in found.gaps]), "N")
        names += [
            (f"contact force at {gap.point}", force.unit, found[f"{gap.point}.normal_N"][rows] * force.factor)
            for gap in found.gaps
        ]
        listed = [Readout(words, unit_, [round(float(v), 5) for v in values]) for words, unit_, values in names]
        return Moving(through(cycle, np.radians(crank)), Stops("time", " s", time, decimals_of(time)), listed)

    return made


# --- control comparison ------------------------------------------------------------------------------------------------------


def compared(record: Record, file: ProblemFile) -> Studied:
    """Build the report of a stored control comparison.

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
    starts, below = record.numbers("starts_rad"), record.record("trials")
    trials = {name: _trials(below.record(name), len(starts)) for name in below.document}
    if not trials:
        raise record.fault("trials", "there are none")
    unit = record.text("unit")
    if unit not in clearance_tables.TO_DISPLAY:
        raise record.fault("unit", "no output has that", unit)
    found = Comparison(file, trials, starts, record.whole("seed"), record.whole("revolutions"), {}, unit)
    shown = clearance_tables.comparison(found)
    return Studied(
        problem=file,
        kind="comparison of control",
        verdict="Finished" if found.finished else "Not every run was finished",
        valid=found.finished,
        status=shown.status.lines,
        sections=[*figures_of(shown.parts), Section("Chart", [_bars(found)])],
        moving=still,
        by=f"event-driven integration from {len(starts)} crank angles, seed {found.seed}",
    )


def _trials(record: Record, count: int) -> Trials:
    rms, peak, correction, torque = (record.numbers(name, count) for name in ("rms", "peak", "correction", "torque"))
    return Trials(rms, peak, correction, torque, record.flag("finished"))


def _bars(found: Comparison) -> Chart:
    """Plot the RMS deviation of each kind of control with its scatter, and the largest deviation."""
    factor, unit = clearance_tables.TO_DISPLAY[found.unit]
    names = [escape(name) for name in found.trials]
    rms = np.array([one.mean for one in found.trials.values()]) * factor
    scatter = np.array([one.scatter for one in found.trials.values()]) * factor
    peak = np.array([float(np.max(one.peak)) for one in found.trials.values()]) * factor
    bars: list[Trace] = [
        {"type": "bar", "name": "root mean square", "x": names, "y": short(rms), "marker": {"color": FOUND}}
        | {"error_y": {"type": "data", "array": short(scatter), "color": GROUND}},
        {"type": "bar", "name": "largest of all starts", "x": names, "y": short(peak), "marker": {"color": QUIET}},
    ]
    layout = sheet(360)
    layout["xaxis"], layout["yaxis"] = axis("control") | {"type": "category"}, axis(f"deviation of the output [{unit}]")
    return Chart("What control makes of the clearance", {"data": bars, "layout": layout}, cranked=False)
