"""HTML sections of a simulation with joint clearance and of a control comparison."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.controller import Control
from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.clearance.output import outputs
from optlink.clearance.statistics import Prediction
from optlink.dynamics.forward import Ending
from optlink.problem.file import ProblemFile
from optlink.report.html import chart_plotly
from optlink.report.html.moving_linkage import Moving, even, in_time
from optlink.report.html.shell import Section
from optlink.report.scene import through
from optlink.report.stored.reader import Record
from optlink.report.stored.stored_study import Studied, cycle_of, figures_of, still
from optlink.report.style import Scale, scale
from optlink.report.views import clearance, clearance_tables, control_comparison
from optlink.report.views.revolutions import TORQUE, WINDOW, Turns
from optlink.report.views.simulation import largest
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
        sections.append(Section("Curves", chart_plotly.charts(clearance.charts(found))))
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
        drawn="Its last revolutions, drawn without the clearance, which is too small to be seen; journal orbits are below.",
    )


def _moving(found: ClearanceSimulation) -> Callable[[int], Moving | None]:
    """Return a function that animates the machine without clearance over the last revolutions."""

    def made(steps: int) -> Moving | None:
        cycle = cycle_of(found.problem, {}) if found.revolutions else None
        if cycle is None:
            return None
        turns = Turns(found)
        span = turns.rows(WINDOW)
        rows = span.start + even(span.stop - span.start, steps + 1)
        crank = found["crank_angle_deg"][rows]
        shown = [("crank angle", Scale(1.0, "deg"), np.mod(crank, 360.0))]
        shown.append((f"deviation of {found.output.name}", turns.shares(turns.rms), turns.error[rows]))
        unit = scale(largest(found.columns, [TORQUE]), "N m")
        shown.append(("driving torque", unit, found[TORQUE][rows]))
        names = {gap.point: f"{gap.point}.normal_N" for gap in found.gaps}
        force = scale(largest(found.columns, names.values()), "N")
        shown += [(f"contact force at {point}", force, found[name][rows]) for point, name in names.items()]
        return in_time(through(cycle, np.radians(crank)), found["time_s"][rows], shown)

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
        sections=[*figures_of(shown.parts), Section("Chart", chart_plotly.charts(control_comparison.charts(found)))],
        moving=still,
        by=f"event-driven integration from {len(starts)} crank angles, seed {found.seed}",
    )


def _trials(record: Record, count: int) -> Trials:
    rms, peak, correction, torque = (record.numbers(name, count) for name in ("rms", "peak", "correction", "torque"))
    return Trials(rms, peak, correction, torque, record.flag("finished"))
