"""HTML sections of a simulation with joint clearance and of a control comparison."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.controller import Control
from optlink.clearance.integration import Impact
from optlink.clearance.output import outputs
from optlink.clearance.statistics import Prediction
from optlink.problem.base_model import Contradiction
from optlink.problem.file import ProblemFile
from optlink.report.html import chart_plotly
from optlink.report.html.moving_linkage import Moving, even, in_time
from optlink.report.html.shell import PageSection
from optlink.report.scene import through
from optlink.report.stored.stored_study import StoredStudy, cycle_of, figures_of, still
from optlink.report.style import Scale, scale
from optlink.report.views import clearance, clearance_tables, conclusions, control_comparison
from optlink.report.views.revolutions import TORQUE, WINDOW, RevolutionCurves
from optlink.report.views.simulation import largest
from optlink.tasks.machine import machine_of
from optlink.tasks.results.clearance import ClearanceRecord, ClearanceSimulation
from optlink.tasks.results.control_comparison import Comparison, ComparisonRecord, Trials

Array = NDArray[np.float64]


class _Table(dict[str, Any]):
    """Table of a record whose missing entries are reported."""

    def __init__(self, name: str, entries: Mapping[str, Any]) -> None:
        super().__init__({key: value for key, value in entries.items() if isinstance(value, np.ndarray) or math.isfinite(value)})
        self.name = name

    def __missing__(self, key: str) -> Any:
        raise Contradiction(f"{self.name}.{key}", "this is missing")


# --- reading -----------------------------------------------------------------------------------------------------------------


def read(record: ClearanceRecord, file: ProblemFile) -> ClearanceSimulation:
    """Return a stored simulation with clearance.

    Parameters
    ----------
    record : ClearanceRecord
    file : ProblemFile
        The problem that was simulated.

    Raises
    ------
    Contradiction
        If the record is not that of the problem, or lacks what the report needs.
    """
    machine = machine_of(file)
    known, names = outputs(machine), [gap.point for gap in record.gaps]
    if record.output not in known:
        raise Contradiction("output", "the problem has no such output", record.output)
    for k, one in enumerate(record.impacts):
        if one.gap not in names:
            raise Contradiction(f"impacts[{k}].gap", "no joint of that name has a clearance", one.gap)
    impacts = [Impact(**dict(one) | {"gap": names.index(one.gap)}) for one in record.impacts]
    told = record.prediction
    predicted = None if told is None else Prediction(told.parted_revolutions, told.watched, math.nan)
    output = known[record.output]
    tables = {name: _Table(name, getattr(record, name)) for name in ("columns", "per_revolution", "poincare_map", "figures")}
    found = record.build(
        ClearanceSimulation, problem=file, machine=machine, output=output, impacts=tuple(impacts), prediction=predicted, **tables
    )
    _check_keys(found)
    return found


def _check_keys(found: ClearanceSimulation) -> None:
    """Check that the simulation can be divided into revolutions."""
    if found.figures["settled_revolutions"] > found.revolutions:
        raise Contradiction("figures.settled_revolutions", "these are more than all revolutions")
    if not found.revolutions:
        return
    if len(found.columns["time_s"]) < 2 or not np.all(np.diff(found.columns["time_s"]) > 0.0):
        raise Contradiction("columns.time_s", "its times do not rise")


# --- the page ----------------------------------------------------------------------------------------------------------------


def stored_study(record: ClearanceRecord, file: ProblemFile, _: Path) -> StoredStudy:
    """Build the report of a stored simulation with clearance.

    Parameters
    ----------
    record : ClearanceRecord
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
        sections.append(PageSection("Curves", chart_plotly.charts(clearance.charts(found))))
    control = "" if found.control is Control.NONE else f"; control: {found.control}"
    return StoredStudy(
        problem=file,
        kind="simulation with clearance",
        verdict="Finished" if found.finished else f"Not finished: {found.ending.value}",
        valid=found.finished,
        conclusion=conclusions.clearance(found),
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
        turns = RevolutionCurves(found)
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


def compared(record: ComparisonRecord, file: ProblemFile, _: Path) -> StoredStudy:
    """Build the report of a stored control comparison.

    Parameters
    ----------
    record : ComparisonRecord
    file : ProblemFile
        The problem that was simulated.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    trials = {name: one.build(Trials) for name, one in record.trials.items()}
    found = record.build(Comparison, problem=file, trials=trials, examples={})
    shown = clearance_tables.comparison(found)
    return StoredStudy(
        problem=file,
        kind="comparison of control",
        verdict="Finished" if found.finished else "Not every run was finished",
        valid=found.finished,
        conclusion=conclusions.comparison(found),
        status=shown.status.lines,
        sections=[*figures_of(shown.parts), PageSection("Chart", chart_plotly.charts(control_comparison.charts(found)))],
        moving=still,
        by=f"event-driven integration from {len(found.starts)} crank angles, seed {found.seed}",
    )
