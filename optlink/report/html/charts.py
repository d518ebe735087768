"""Plotly charts of a design report: requirement and result, motion, torque, reactions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.columns import MotionColumns, slider_names
from optlink.io import finite
from optlink.report.chart_spec import ChartSpec
from optlink.report.html import chart_plotly
from optlink.report.html.chart_plotly import Chart
from optlink.report.html.moving_linkage import Readout
from optlink.report.report_model import ReportModel
from optlink.report.style import scale
from optlink.report.views import analysis_charts, analysis_forces, cycle, function, path
from optlink.report.views.analysis_curves import Course
from optlink.tasks.function import FunctionResult
from optlink.tasks.results.analysis import Analysis
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import PathResult

Array = NDArray[np.float64]


def charts(subject: ReportModel) -> list[Chart]:
    """Return the applicable charts of a report model."""
    outcome = subject.outcome
    course = None if subject.cycle is None else Course(subject.cycle)
    specs: list[ChartSpec] = []
    if isinstance(outcome, FunctionResult) and course is not None:
        specs += function.charts(outcome)
    if isinstance(outcome, PathResult):
        specs += path.charts(outcome)
    if isinstance(outcome, CycleResult):
        specs += cycle.charts(outcome)
    if course is not None:
        given = Course(outcome.given) if isinstance(outcome, CycleResult) and outcome.given is not None else None
        if not isinstance(outcome, FunctionResult | PathResult) or subject.forces:
            specs += analysis_charts.motion(course, given)
        if not isinstance(outcome, FunctionResult | PathResult) or (
            isinstance(outcome, PathResult) and outcome.best is not None and outcome.best.task.pointed
        ):
            specs += analysis_charts.transmission(course)
        if subject.forces:
            specs += analysis_forces.forces(course, given)
    return chart_plotly.charts(specs)


# --- quantities beside the moving linkage ------------------------------------------------------------------------------------


def readouts(cycle: Analysis, angles: Array, *, forces: bool) -> list[Readout]:
    """Return the quantities shown beside the moving linkage: slides, transmission angles, and driving torque.

    Parameters
    ----------
    cycle : Analysis
    angles : array (positions,) [deg]
        Crank angles.
    forces : bool
        Include the driving torque.
    """
    machine = cycle.machine
    record = MotionColumns(machine.moving(np.radians(angles), cycle.speed))
    sliders = [f"{name}.s_m" for name in slider_names(machine).values()]
    asked = [(name, f"slide of {name.removesuffix('.s_m')}", "m") for name in sliders]
    if not asked:
        last = machine.mechanism.links[-1].body
        asked.append((f"{last}.angle_rad", f"angle of {last}", "deg"))
    for name in record.columns:
        if name.endswith(".transmission_rad"):
            asked.append((name, f"transmission angle at {name.partition('.')[0]}", "deg"))
    if forces:
        asked.append(("input.torque_Nm", "driving torque", "N m"))
    found = []
    for column, words, unit in asked:
        values = record[column]
        shown = scale(float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values))), unit)
        found.append(Readout(words, shown.unit, finite(np.round(values * shown.factor, 4))))
    return found
