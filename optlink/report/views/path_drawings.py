"""Figures of a synthesised mechanism at its first position, of several designs side by side, and of outputs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon
from matplotlib.path import Path as Outline
from PIL import Image

from optlink.linkage.dyad_types import transmitting
from optlink.linkage.vector2d import TURN
from optlink.problem.path import PathProblem
from optlink.problem.targets.function import Function
from optlink.report.animation import film
from optlink.report.chart_spec import Array, Axis, ChartSpec, Curve, Panel, crank_angle
from optlink.report.labels import Label, place_labels
from optlink.report.shapes import even
from optlink.report.style import BODIES, CRANK, LIMIT, TARGET, beside, figure, heading, panels, scale, styled
from optlink.report.views.function import function_chart
from optlink.report.views.path_charts import NUMBERED, points_on
from optlink.report.views.path_tables import kin
from optlink.report.views.path_view import PathView, assembly, figures, objective, title_of, transmission, wrapped
from optlink.tasks.results.path import PathResult
from optlink.validation.path import deviations, transmission_angles

HIGH, BESIDE = 4.3, 0.75  # largest height of a panel and width of its axis labels [inch]
GHOSTS = 8  # largest number of poses in which the body is drawn


def _turning(axes: Axes, track: PathView) -> None:
    """Draw an arrow on the crank circle in the direction of rotation."""
    crank = track.sketch.mechanism.crank
    pivot, pin = (track.sketch.position(track.here, name)[0] for name in (crank.start, crank.end))
    arm = pin - pivot
    radius = max(float(np.linalg.norm(arm)), 1.7 * track.sketch.size)
    start = math.atan2(arm[1], arm[0])
    turn = min(math.radians(50.0), 5.0 * track.sketch.size / radius)
    if not track.design.crank_turns:
        turn = min(turn, 0.8 * abs(track.end - track.begin))
    angles = start + track.way * np.linspace(0.25 * turn, 1.25 * turn, 33)
    arc = pivot + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    drawn = FancyArrowPatch(path=Outline(arc), arrowstyle="-|>", mutation_scale=11.0, linewidth=1.5, color=CRANK)
    drawn.set(zorder=3.9, gid="turning")
    axes.add_patch(drawn)


def _ghosts(axes: Axes, track: PathView) -> None:
    """Draw the guided body in its poses."""
    sketch, body = track.sketch, track.task.body
    for part in sketch.parts[body]:
        if part.kind in ("bar", "plate"):
            places = sketch.placed(track.at, body, part.outline)
            for k in even(len(places), GHOSTS):
                if k != track.first and np.all(np.isfinite(places[k])):
                    colour = to_rgb(track.colour)
                    ghost = Polygon(places[k], closed=part.kind == "plate", facecolor=(*colour, 0.06), edgecolor=(*colour, 0.35))
                    ghost.set(linewidth=1.2, zorder=1.2, gid="ghost")
                    axes.add_patch(ghost)


def trim(made: Figure, rows: int = 1) -> None:
    """Reduce the height of a figure by the empty space above and below its panels.

    Parameters
    ----------
    made : Figure
    rows : int, optional
        Number of rows of panels.
    """
    made.draw_without_rendering()
    empty = math.inf
    for axes in made.axes:
        slot, needed = axes.get_position(original=True).transformed(made.transFigure), axes.get_tightbbox()
        assert needed is not None
        empty = min(empty, max(0.0, slot.y1 - needed.y1) + max(0.0, needed.y0 - slot.y0))
    if 0.0 < empty < math.inf:
        made.set_figheight(made.get_figheight() - rows * empty / made.dpi)


def initial_pose(axes: Axes, track: PathView) -> list[Label]:
    """Draw the mechanism at the first point with its coupler curve and the precision points, and return the labels.

    Parameters
    ----------
    axes : Axes
    track : PathView
    """
    sketch = track.sketch
    factor = sketch.scale.factor
    labels = sketch.show(axes, track.here)
    if track.task.pointed:
        axes.plot(*(track.position(track.run) * factor).T, color=track.colour, linewidth=2.3, zorder=1.5, gid="run")
        points_on(axes, track.targets * factor, 1.0 if len(track.targets) <= NUMBERED else 0.55)
    if track.task.requirement.kind == "motion":
        _ghosts(axes, track)
    _turning(axes, track)
    return labels


PANELS = 9  # largest number of designs
APART = 4.0  # designs up to this multiple of the smallest size share one scale


@styled
def designs(result: PathResult) -> Figure | None:
    """Draw the distinct designs side by side on one scale and name their cognates."""
    if len(result.designs) < 2:
        return None
    related = kin(result.designs)
    tracks = [PathView(design) for design in result.designs[:PANELS]]
    sizes = np.array([np.ptp(track.sketch.limits, axis=1) / track.sketch.scale.factor for track in tracks])
    reach = sizes.max(axis=1)
    common = sizes[reach <= APART * float(np.min(reach))].max(axis=0)
    columns = beside(len(tracks))
    rows = -(-len(tracks) // columns)
    panel = 3.9 if columns > 2 else 4.6
    tall = min(max(float(common[1] / common[0]), 0.4), 1.5)
    made = figure(panel * columns, ((panel - BESIDE) * tall + 1.35) * rows + 0.4)
    labels: list[Label] = []
    for number, (axes, track) in enumerate(zip(panels(made, len(tracks), columns), tracks, strict=True)):
        labels += initial_pose(axes, track)
        smaller = max(1.0, float(np.max(sizes[number] / common)))
        half = 0.5 * common * smaller * track.sketch.scale.factor
        middle = np.mean(track.sketch.limits, axis=1)
        axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
        texts = [heading(f"{number + 1}: {objective(track)}", panel - 0.3, 9.0), transmission(track.design)]
        texts.append(wrapped(assembly(track.design), panel - 0.3, ", ", 9.0))
        if number in related:
            texts.append(f"cognate of {related[number] + 1}: the same curve")
        if smaller > 1.0:
            texts.append(f"drawn {smaller:.2g} times smaller than the others")
        axes.set_title("\n".join(filter(None, texts)), fontsize=9.0)
    count = len(result.designs)
    many = f"{count} distinct designs, best first" + (f"; the first {PANELS}" if count > PANELS else "")
    made.suptitle(heading(f"{tracks[0].task.title}: {many}", panel * columns - 0.4, 10.5), fontsize=10.5)
    trim(made, rows)
    place_labels(made, labels)
    return made


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
    target = fine.prescribed_outputs(values)
    unit = track.sketch.scale if task.slides else scale(0.0, "deg")
    if not task.slides:
        travel = travel - TURN * np.round((travel - target) / TURN)
    name = f"{'place along' if task.slides else 'angle of'} {task.requirement.output} [{unit.unit}]"
    return Output(np.degrees(angles), travel[:, None] * unit.factor, target * unit.factor, name, ["generated"], unit.factor)


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
        traces.append(Curve(shown.crank, shown.target, "target", TARGET, 1.4, "dash", gid="target"))
    for k, name in enumerate(shown.curves):
        texts = name
        if shown.target is None:
            least, largest = float(np.nanmin(shown.generated[:, k])), float(np.nanmax(shown.generated[:, k]))
            texts = f"at {name}: {least:z.2f}° to {largest:z.2f}°"
        traces.append(Curve(shown.crank, shown.generated[:, k], texts, BODIES[k % len(BODIES)], 1.9, gid=f"generated {name}"))
    return Panel(Axis(shown.name), traces, 1.6)


def output_film(track: PathView, steps: Array, title: str) -> list[Image.Image]:
    """Draw the frames of the mechanism beside its output or its transmission angles.

    Parameters
    ----------
    track : PathView
    steps : array (frames,) [rad]
        Crank angles.
    title : str
    """
    shown = output(track)
    order = np.argsort(shown.crank)
    height = np.interp(np.degrees(steps), shown.crank[order], shown.generated[order, 0])
    marks = np.stack([np.degrees(steps), height], axis=-1)
    return film(track.sketch, track.sweep(steps), ChartSpec("", "", [_outputs(shown)], _crank(track, shown)), marks, title)
