"""HTML sections of a forward dynamics simulation: drive, output, reactions, energy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.ending import Ending
from optlink.problem.base_model import Contradiction
from optlink.problem.file import ProblemFile
from optlink.report.html import chart_plotly
from optlink.report.html.moving_linkage import Moving, even, in_time
from optlink.report.html.shell import PageSection
from optlink.report.scene import through
from optlink.report.stored.stored_study import StoredStudy, cycle_of, figures_of, still
from optlink.report.style import Scale, scale
from optlink.report.views import analysis_tables, conclusions
from optlink.report.views.simulation import History, charts, largest
from optlink.tasks.machine import machine_of
from optlink.tasks.simulate import SimulationRecord

Array = NDArray[np.float64]
Columns = Mapping[str, Array]
AGREES = 1e-6  # tolerance of stored positions, as a share of the size of the machine
VERDICTS = {Ending.FINISHED: "Finished", Ending.AT_REST: "Came to rest"}


def stored_study(record: SimulationRecord, file: ProblemFile, _: Path) -> StoredStudy:
    """Build the report of a stored forward dynamics simulation.

    Parameters
    ----------
    record : SimulationRecord
    file : ProblemFile
        The problem that was simulated.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    columns, figures, ending = record.columns, record.figures, record.status
    crank_body = machine_of(file).mechanism.crank.body
    run = History(file.model.title, machine_of(file), record.driven, ending.value, columns, figures)
    curves = chart_plotly.charts(charts(run))
    tables = analysis_tables.simulation_parts(figures, columns, record.steps, record.evaluations)
    return StoredStudy(
        problem=file,
        kind="simulation in time",
        verdict=VERDICTS.get(ending, f"Not finished: {ending.value}"),
        valid=record.finished,
        conclusion=conclusions.simulation(figures, record.finished, record.message),
        status=[f"{ending.value}, driven by {record.driven}; {record.message}", *record.notes],
        sections=[*figures_of(tables), *([PageSection("Over time", curves)] if curves else [])],
        moving=_moving(file, columns, crank_body, _sizes(record, file)) if curves else still,
        by=f"integration in time; driven by {record.driven}",
        drawn="As the crank turned in time: the slider goes from row to row of the simulation.",
    )


# --- animation ---------------------------------------------------------------------------------------------------------------


def _sizes(record: SimulationRecord, file: ProblemFile) -> dict[str, float]:
    """Return the dimensions [SI] of the simulated machine."""
    if missing := [name for name in file.model.mechanism.quantities if name not in record.sizes_SI]:
        raise Contradiction(f"sizes_SI.{missing[0]}", "this is missing")
    return record.sizes_SI


def _moving(file: ProblemFile, columns: Columns, body: str, sizes: Mapping[str, float]) -> Callable[[int], Moving | None]:
    """Return a function that animates the linkage at rows of the simulation, if the stored positions match its dimensions."""

    def made(steps: int) -> Moving | None:
        cycle = cycle_of(file, sizes)
        if cycle is None:
            return None
        rows = even(len(columns["time_s"]), steps + 1)
        drawn = through(cycle, np.radians(columns["crank_angle_deg"][rows]))
        for name, places in drawn.points.items():
            if {f"{name}.x_m", f"{name}.y_m"} <= columns.keys():
                own = np.stack([columns[f"{name}.x_m"][rows], -columns[f"{name}.y_m"][rows]], axis=1) * 1e3
                if np.nanmax(np.abs(own - places), initial=0.0) > AGREES * max(drawn.box[2:]):
                    return None  # the stored positions belong to a different machine
        shown = [("crank angle", Scale(1.0, "deg"), columns["crank_angle_deg"][rows])]
        for name, words, unit in ((f"{body}.omega_rad_s", "crank speed", "rad/s"), ("input.torque_Nm", "driving torque", "N m")):
            if name in columns:
                shown.append((words, scale(largest(columns, [name]), unit), columns[name][rows]))
        return in_time(drawn, columns["time_s"][rows], shown)

    return made
