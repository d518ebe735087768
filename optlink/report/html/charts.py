"""Plotly charts of a design report: requirement and result, motion, torque, reactions."""

from __future__ import annotations

import math
from html import escape

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.columns import MotionColumns, slider_names
from optlink.io import finite
from optlink.report.chart_spec import ChartSpec
from optlink.report.html import chart_plotly
from optlink.report.html.chart_plotly import Chart, Panel, Trace, axis, filled, line, sheet, short, stacked
from optlink.report.html.moving_linkage import Readout
from optlink.report.report_model import ReportModel
from optlink.report.style import BODIES, FOUND, LIMIT, WANTED, Scale, scale
from optlink.report.views import analysis_charts, analysis_forces, cycle
from optlink.report.views.analysis_curves import Course
from optlink.report.views.path_outputs import output
from optlink.report.views.path_tables import exact
from optlink.report.views.path_view import Track, best
from optlink.report.views.study_tables import step
from optlink.studies.sensitivity import Sensitivities
from optlink.tasks.function import FunctionResult
from optlink.tasks.results.analysis import Analysis
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import PathResult

Array = NDArray[np.float64]
BARS = 16  # largest number of bars of the tornado chart
PARTS = {"inertia": BODIES[0], "gravity": BODIES[1], "load": BODIES[2]}


def charts(subject: ReportModel) -> list[Chart]:
    """Return the applicable charts of a report model."""
    outcome = subject.outcome
    course = None if subject.cycle is None else Course(subject.cycle)
    found: list[Chart] = []
    specs: list[ChartSpec] = []
    if isinstance(outcome, FunctionResult) and course is not None:
        found += _law(outcome)
    if isinstance(outcome, PathResult):
        found += _generated(outcome)
    if isinstance(outcome, CycleResult):
        specs += cycle.charts(outcome)
    if course is not None:
        given = Course(outcome.given) if isinstance(outcome, CycleResult) and outcome.given is not None else None
        if not isinstance(outcome, FunctionResult | PathResult) or subject.forces:
            specs += analysis_charts.motion(course, given)
        if not (isinstance(outcome, PathResult) and not _pointed(outcome)):
            specs += analysis_charts.transmission(course)
        if subject.forces:
            specs += analysis_forces.forces(course, given)
    return [*found, *chart_plotly.charts(specs)]


# --- function synthesis of a four-bar ----------------------------------------------------------------------------------------


def _law(result: FunctionResult) -> list[Chart]:
    """Plot prescribed and generated rocker angle over the span, and the error."""
    task, design = result.problem.spec, result.design
    if not math.isfinite(design["phi0"]):
        return []
    offsets, at = task.span * np.linspace(0.0, 1.0, 361), task.law.offsets
    begin = math.degrees(design["phi0"])
    wanted, marks = (np.degrees(task.law.curve(places, design["phi0"], design["psi0"])) for places in (offsets, at))
    error, missed = np.degrees(result.error(offsets)), np.degrees(result.error())
    x, marked = begin + np.degrees(offsets), begin + np.degrees(at)
    above = [
        line(x, wanted - error, "generated", FOUND, width=2.4),
        line(x, wanted, "wanted", WANTED, width=1.6, dash="dash"),
        line(marked, marks, "design positions", WANTED, width=5.0, mode="markers"),
    ]
    below = [
        line(x, error, "error", LIMIT),
        line(marked, missed, "error at the design positions", LIMIT, width=5.0, mode="markers") | {"showlegend": False},
    ]
    panels = [Panel("rocker angle ψ [deg]", above, 1.5), Panel("wanted minus generated [deg]", below)]
    return [Chart("Motion law over the span", stacked(panels))]


# --- path, motion and function synthesis -------------------------------------------------------------------------------------


def _pointed(result: PathResult) -> bool:
    return result.best is not None and result.best.task.pointed


def _generated(result: PathResult) -> list[Chart]:
    track = best(result)
    if track is None:
        return []
    if not track.task.pointed:
        return [_output(track)]
    return [_path(track)] if exact(track.design) else [_path(track), _misses(track)]


def _path(track: Track) -> Chart:
    """Plot the coupler curve with precision points and generated points, with equal scales."""
    unit = track.sketch.scale
    curve = track.position(track.motion) * unit.factor
    wanted, met = track.wanted * unit.factor, track.generated * unit.factor
    curves = [
        line(curve[:, 0], curve[:, 1], f"curve of {track.task.requirement.point}", track.colour, width=2.2),
        line(wanted[:, 0], wanted[:, 1], "wanted", WANTED, width=9.0, mode="markers"),
        line(met[:, 0], met[:, 1], "generated", LIMIT, width=7.0, mode="markers"),
    ]
    curves[1]["marker"] |= {"symbol": "circle-open", "line": {"width": 1.6}}
    curves[2]["marker"] |= {"symbol": "cross-thin-open", "line": {"width": 1.8}}
    for trace in curves[1:]:
        trace["text"] = [f"point {k + 1}" for k in range(len(wanted))]
    layout = sheet(480) | {"hovermode": "closest"}
    layout["xaxis"] = axis(f"x [{unit.unit}]") | {"constrain": "domain"}
    layout["yaxis"] = axis(f"y [{unit.unit}]") | {"scaleanchor": "x", "constrain": "domain"}
    return Chart("Path", {"data": curves, "layout": layout}, cranked=False)


def _misses(track: Track) -> Chart:
    """Plot the distance from every point, and the angular deviation of every pose."""
    measured = track.design.measured
    shown = Scale(1e3, "mm") if track.exact else scale(float(np.nanmax(measured.distances)), "m")
    number = np.arange(1.0, len(measured.distances) + 1.0)
    bars: list[Trace] = [
        {"type": "bar", "name": "distance", "x": short(number), "y": short(measured.distances * shown.factor)} | filled(FOUND)
    ]
    if np.any(np.isfinite(track.tolerances)):
        mark = line(number, track.tolerances * shown.factor, "tolerance", LIMIT, width=9.0, mode="markers")
        mark["marker"]["symbol"] = "line-ew-open"
        bars.append(mark)
    panels = [Panel(f"distance [{shown.unit}]", bars)]
    if measured.turned is not None:
        turned = {"type": "bar", "name": "turned by", "x": short(number), "y": short(np.degrees(measured.turned))}
        panels.append(Panel("turned by [deg]", [turned | filled(BODIES[2])]))
    figure = stacked(panels, "point")
    figure["layout"]["xaxis"] |= {"dtick": max(1, len(number) // 20), "hoverformat": "d"}
    return Chart(f"How far the {'points' if measured.turned is None else 'poses'} are missed", figure, cranked=False)


def _output(track: Track) -> Chart:
    """Plot the output of a function against the prescribed one, or the transmission angles."""
    shown = output(track)
    curves = [line(shown.crank, shown.found[:, k], name, BODIES[k % len(BODIES)]) for k, name in enumerate(shown.curves)]
    panels = [Panel(shown.name, curves, 1.5)]
    if shown.wanted is not None:
        curves.append(line(shown.crank, shown.wanted, "wanted", WANTED, width=1.6, dash="dash"))
        error = line(shown.crank, shown.found[:, 0] - shown.wanted, "error", LIMIT)
        panels.append(Panel(f"generated minus wanted [{shown.name.rpartition('[')[2]}", [error]))
    title = "Transmission angle" if shown.wanted is None else "Output over the range"
    return Chart(title, stacked(panels, reversed_x=track.way < 0.0))


# --- sensitivities -----------------------------------------------------------------------------------------------------------


def tornado(found: Sensitivities) -> Chart:
    """Plot the change of the objective by one step of every parameter, largest effect on top."""
    rows = found.moving[:BARS][::-1]
    base = found.solution.objective
    factor, unit = (100.0 / base, "%") if base > 0.0 else (1.0, found.unit)
    names = [escape(f"{row.parameter.name}: {row.parameter.value:.5g} {row.parameter.unit}".rstrip()) for row in rows]
    effects = np.array([row.effect * factor for row in rows])
    steps = [f"{names[k]} + {step(row)}" for k, row in enumerate(rows)]
    bars = {"type": "bar", "orientation": "h", "name": "one step more", "y": names, "x": short(effects), "text": steps}
    colours = [LIMIT if effect > 0.0 else FOUND for effect in effects]
    bars |= {"textposition": "none", "hovertemplate": "%{text}: %{x:+.4g} " + unit + "<extra></extra>"}
    layout = sheet(110 + 26 * len(rows)) | {"hovermode": "closest", "showlegend": False}
    layout["xaxis"] = axis(f"change of the objective [{unit}], to first order: left is better")
    layout["yaxis"] = axis("") | {"type": "category"}
    return Chart(
        "Effect of one step more: 1 deg of an angle, else 1 %",
        {"data": [bars | {"marker": {"color": colours}}], "layout": layout},
        cranked=False,
    )


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
