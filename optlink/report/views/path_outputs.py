"""Figures of a synthesised function or transmission: output against the prescribed one, or transmission angles."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from optlink.linkage.dyad_types import transmitting
from optlink.linkage.vector2d import TURN
from optlink.problem.path import PathProblem
from optlink.problem.targets.function import Function
from optlink.report.animation import film, there_and_back
from optlink.report.chart_mpl import into
from optlink.report.chart_spec import Axis, ChartSpec, Curve, Panel, crank_angle
from optlink.report.labels import place_labels
from optlink.report.style import BODIES, LIMIT, WANTED, degrees, figure, scale, styled
from optlink.report.views.function_chart import function_chart
from optlink.report.views.path_captions import LINE, SMALL, assembly, entitle, figures, headed, title_of, wrapped
from optlink.report.views.path_initial_pose import BESIDE, HIGH, initial_pose, trim
from optlink.report.views.path_view import PathView, best
from optlink.tasks.results.path import PathResult
from optlink.validation.path import deviations, transmission_angles

Array = NDArray[np.float64]
FINEST = 360  # number of positions of the output curve


class Output(NamedTuple):
    """Output over crank angles (n,) [deg]: `generated` (n, curves) in the unit of `name`, `target` (n,) if prescribed.

    `factor`: from SI to that unit.
    """

    crank: Array
    generated: Array
    target: Array | None
    name: str
    curves: list[str]
    factor: float = 1.0


def output(track: PathView) -> Output:
    """Return the output of a function over its range, or the transmission angles over the revolution."""
    task, values = track.task, track.design.values
    if task.requirement.kind == "transmission":
        joints = [group.joint for group in transmitting(task.linkage)]
        found = np.degrees(transmission_angles(track.motion, task.linkage))
        return Output(np.degrees(track.motion.crank_angle), found, None, "transmission angle [deg]", joints)
    fine = track.design.problem.override({"requirement.points": FINEST}).model
    assert isinstance(fine, PathProblem)
    angles = fine.crank_angles(values, None)
    travel = deviations(fine, values, angles).generated[:, 0]
    wanted = fine.prescribed_outputs(values)
    unit = track.sketch.scale if task.slides else scale(0.0, "deg")
    if not task.slides:
        travel = travel - TURN * np.round((travel - wanted) / TURN)
    name = f"{'place along' if task.slides else 'angle of'} {task.requirement.output} [{unit.unit}]"
    return Output(np.degrees(angles), travel[:, None] * unit.factor, wanted * unit.factor, name, ["generated"], unit.factor)


@styled
def mechanism(result: PathResult) -> Figure | None:
    """Draw the mechanism of a function or transmission synthesis at its first position."""
    track = best(result)
    if track is None or track.task.pointed:
        return None
    width = min(max(HIGH / track.sketch.ratio + BESIDE, 5.0), 7.6)
    height = min(HIGH, (width - BESIDE) * track.sketch.ratio)
    title = headed(track, width - 0.4)
    made = figure(width, height + 1.0 + LINE * (title.count("\n") + 1))
    entitle(made, track, title)
    axes = made.subplots()
    labels = initial_pose(axes, track)
    crank = f"crank at {degrees(float(track.design.crank_angles[track.first]))}"
    axes.set_title(wrapped([crank, *assembly(track.design)], width - 0.6, ", ", SMALL), fontsize=SMALL)
    trim(made)
    place_labels(made, labels)
    return made


def curve(track: PathView) -> ChartSpec:
    """Return the prescribed and generated output of a function with their difference, or the transmission angles."""
    shown = output(track)
    panels = [_outputs(shown)]
    if shown.target is not None:
        at = np.degrees(track.design.crank_angles)
        error = shown.generated[:, 0] - shown.target
        traces = [Curve(shown.crank, error, "", LIMIT, 1.5, gid="error")]
        if len(at) <= 100:
            traces.append(Curve(at, np.interp(at, shown.crank, error), "", LIMIT, mode="markers", size=3.5, gid="positions"))
        panels.append(Panel(Axis(f"generated minus target [{shown.name.rpartition('[')[2]}"), traces))
    heading = title_of(track, 7.0, track.task.title, wrapped(figures(track), 7.0, "; "))
    title = "Transmission angle" if shown.target is None else "Output over the range"
    return ChartSpec("curve", title, panels, _crank(track, shown), heading, warning=not track.design.valid)


def function_values(track: PathView) -> list[ChartSpec]:
    """Return the prescribed and the generated y(x) of a function; nothing for a law of the crank angle or a transmission."""
    function = track.task.requirement.law
    if track.task.requirement.kind != "function" or not isinstance(function, Function):
        return []
    shown = output(track)
    assert shown.target is not None
    offsets, error = np.radians(shown.crank - shown.crank[0]), (shown.target - shown.generated[:, 0]) / shown.factor
    if not np.any(np.isfinite(error)):
        return []
    title = title_of(track, 7.6, f"{track.task.title}: {function.text}")
    return [function_chart(function, offsets, error, title, warning=not track.design.valid)]


def _crank(track: PathView, shown: Output) -> Axis:
    ends = sorted((float(shown.crank[0]), float(shown.crank[-1])))
    return crank_angle(clockwise=track.way < 0.0, limits=(ends[0], ends[1]))


def _outputs(shown: Output) -> Panel:
    """Return the panel of all curves of an output."""
    traces = []
    if shown.target is not None:
        traces.append(Curve(shown.crank, shown.target, "target", WANTED, 1.4, "dash", gid="target"))
    for k, name in enumerate(shown.curves):
        told = name
        if shown.target is None:
            least, largest = float(np.nanmin(shown.generated[:, k])), float(np.nanmax(shown.generated[:, k]))
            told = f"at {name}: {least:z.2f}° to {largest:z.2f}°"
        traces.append(Curve(shown.crank, shown.generated[:, k], told, BODIES[k % len(BODIES)], 1.9, gid=f"generated {name}"))
    return Panel(Axis(shown.name), traces, 1.6)


def output_film(track: PathView, count: int) -> list[Image.Image]:
    """Draw the frames of the mechanism beside its output or its transmission angles.

    Parameters
    ----------
    track : PathView
    count : int
        Number of frames.
    """
    shown = output(track)
    steps = track.begin + track.way * np.linspace(0.0, TURN, count, endpoint=False)
    if shown.target is not None:
        steps = there_and_back(track.begin, track.end, count)
    order = np.argsort(shown.crank)
    height = np.interp(np.degrees(steps), shown.crank[order], shown.generated[order, 0])
    marks = np.stack([np.degrees(steps), height], axis=-1)
    strip = ChartSpec("", "", [_outputs(shown)], _crank(track, shown))
    title = track.task.title if track.design.valid else f"NOT VALID: {track.task.title}"
    return film(track.sketch, track.sweep(steps), partial(into, spec=strip), marks, title)
