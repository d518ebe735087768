"""Figures of a synthesised mechanism at its first position, of several designs side by side, and of outputs."""

import math
from collections.abc import Sequence
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
from optlink.problem.design import DesignProblem
from optlink.problem.targets.function import Function
from optlink.report.animation import film
from optlink.report.chart_spec import Array, Axis, ChartSpec, Curve, Panel, crank_angle
from optlink.report.labels import Label, place_labels
from optlink.report.shapes import even
from optlink.report.style import BODIES, CRANK, LIMIT, TARGET, charts_per_row, figure, heading, panels, scale, styled
from optlink.report.views.function import function_chart
from optlink.report.views.path_charts import MAX_NUMBERED, points_on
from optlink.report.views.path_tables import cognate_sources
from optlink.report.views.path_view import PathView, assembly, figures, objective, title_of, transmission, wrapped
from optlink.tasks.results.path import PathResult
from optlink.validation.design import deviations
from optlink.validation.linkage_motion import transmission_angles

MAX_HEIGHT, LABEL_WIDTH = 4.3, 0.75  # largest height of a panel and width of its axis labels [inch]
MAX_POSES = 8  # largest number of poses in which the body is drawn


def _turning(axes: Axes, view: PathView) -> None:
    """Draw an arrow on the crank circle in the direction of rotation."""
    crank = view.sketch.mechanism.crank
    pivot, pin = (view.sketch.position(view.here, name)[0] for name in (crank.start, crank.end))
    arm = pin - pivot
    radius = max(float(np.linalg.norm(arm)), 1.7 * view.sketch.size)
    start = math.atan2(arm[1], arm[0])
    turn = min(math.radians(50.0), 5.0 * view.sketch.size / radius)
    if not view.design.crank_turns:
        turn = min(turn, 0.8 * abs(view.end - view.begin))
    angles = start + view.direction * np.linspace(0.25 * turn, 1.25 * turn, 33)
    arc = pivot + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    arrow = FancyArrowPatch(path=Outline(arc), arrowstyle="-|>", mutation_scale=11.0, linewidth=1.5, color=CRANK)
    arrow.set(zorder=3.9, gid="turning")
    axes.add_patch(arrow)


def _draw_poses(axes: Axes, view: PathView) -> None:
    """Draw the guided body in its poses."""
    sketch, body = view.sketch, view.task.body
    for part in sketch.parts[body]:
        if part.kind in ("bar", "plate"):
            places = sketch.placed(view.at, body, part.outline)
            for k in even(len(places), MAX_POSES):
                if k != view.first and np.all(np.isfinite(places[k])):
                    colour = to_rgb(view.colour)
                    ghost = Polygon(places[k], closed=part.kind == "plate", facecolor=(*colour, 0.06), edgecolor=(*colour, 0.35))
                    ghost.set(linewidth=1.2, zorder=1.2, gid="ghost")
                    axes.add_patch(ghost)


def trim(fig: Figure, rows: int = 1) -> None:
    """Reduce the height of a figure by the empty space above and below its rows of panels."""
    fig.draw_without_rendering()
    empty = math.inf
    for axes in fig.axes:
        slot, needed = axes.get_position(original=True).transformed(fig.transFigure), axes.get_tightbbox()
        assert needed is not None
        empty = min(empty, max(0.0, slot.y1 - needed.y1) + max(0.0, needed.y0 - slot.y0))
    if 0.0 < empty < math.inf:
        fig.set_figheight(fig.get_figheight() - rows * empty / fig.dpi)


def initial_pose(axes: Axes, view: PathView) -> list[Label]:
    """Draw the mechanism at the first point with its coupler curve and the precision points, and return the labels."""
    sketch = view.sketch
    factor = sketch.scale.factor
    labels = sketch.show(axes, view.here)
    if view.task.pointed:
        axes.plot(*(view.position(view.run) * factor).T, color=view.colour, linewidth=2.3, zorder=1.5, gid="run")
        points_on(axes, view.targets * factor, 1.0 if len(view.targets) <= MAX_NUMBERED else 0.55)
    if view.task.requirement.kind == "motion":
        _draw_poses(axes, view)
    _turning(axes, view)
    return labels


MAX_DESIGNS = 9  # largest number of designs
SCALE_RATIO = 4.0  # designs up to this multiple of the smallest size share one scale


@styled
def designs(result: PathResult) -> Figure | None:
    """Draw the distinct designs side by side on one scale and name their cognates."""
    if len(result.designs) < 2:
        return None
    related = cognate_sources(result.designs)
    tracks = [PathView(design) for design in result.designs[:MAX_DESIGNS]]
    sizes = np.array([np.ptp(view.sketch.limits, axis=1) / view.sketch.scale.factor for view in tracks])
    reach = sizes.max(axis=1)
    common = sizes[reach <= SCALE_RATIO * np.min(reach)].max(axis=0)
    columns = charts_per_row(len(tracks))
    rows = -(-len(tracks) // columns)
    panel = 3.9 if columns > 2 else 4.6
    tall = min(max(float(common[1] / common[0]), 0.4), 1.5)
    fig = figure(panel * columns, ((panel - LABEL_WIDTH) * tall + 1.35) * rows + 0.4)
    labels: list[Label] = []
    for number, (axes, view) in enumerate(zip(panels(fig, len(tracks), columns), tracks, strict=True)):
        labels += initial_pose(axes, view)
        smaller = max(1.0, np.max(sizes[number] / common))
        half = 0.5 * common * smaller * view.sketch.scale.factor
        middle = np.mean(view.sketch.limits, axis=1)
        axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
        texts = [heading(f"{number + 1}: {objective(view)}", panel - 0.3, 9.0), transmission(view.design)]
        texts.append(wrapped(assembly(view.design), panel - 0.3, ", ", 9.0))
        if number in related:
            texts.append(f"cognate of {related[number] + 1}: the same curve")
        if smaller > 1.0:
            texts.append(f"drawn {smaller:.2g} times smaller than the others")
        axes.set_title("\n".join(filter(None, texts)), fontsize=9.0)
    count = len(result.designs)
    subtitle = f"{count} distinct designs, best first" + (f"; the first {MAX_DESIGNS}" if count > MAX_DESIGNS else "")
    fig.suptitle(heading(f"{tracks[0].task.title}: {subtitle}", panel * columns - 0.4, 10.5), fontsize=10.5)
    trim(fig, rows)
    place_labels(fig, labels)
    return fig


OUTPUT_POSITIONS = 360  # number of positions of the output curve


class OutputCurves(NamedTuple):
    """An output over crank angles (n,) [deg]: `generated` (n, curves) in the unit of `name`, `target` (n,) if prescribed.

    `factor`: from SI to that unit.
    """

    crank: Array
    generated: Array
    target: Array | None
    name: str
    curves: list[str]
    factor: float = 1.0


def output(view: PathView) -> OutputCurves:
    """Return the output of a function over its range, or the transmission angles over the revolution."""
    task, values = view.task, view.design.values
    if task.requirement.kind == "transmission":
        joints = [group.joint for group in transmitting(task.linkage)]
        generated = np.degrees(transmission_angles(view.motion, task.linkage))
        return OutputCurves(np.degrees(view.motion.crank_angle), generated, None, "transmission angle [deg]", joints)
    fine = view.design.problem.override({"requirement.points": OUTPUT_POSITIONS}).model
    assert isinstance(fine, DesignProblem)
    angles = fine.crank_angles(values, None)
    travel = deviations(fine, values, angles).generated[:, 0]
    target = fine.prescribed_outputs(values)
    unit = view.sketch.scale if task.slides else scale(0.0, "deg")
    if not task.slides:
        travel = travel - TURN * np.round((travel - target) / TURN)
    name = f"{'place along' if task.slides else 'angle of'} {task.requirement.output} [{unit.unit}]"
    return OutputCurves(np.degrees(angles), travel[:, None] * unit.factor, target * unit.factor, name, ["generated"], unit.factor)


def curve(view: PathView) -> ChartSpec:
    """Return the prescribed and generated output of a function with their difference, or the transmission angles."""
    shown = output(view)
    panels = [_outputs(shown)]
    if shown.target is not None:
        at = np.degrees(view.design.crank_angles)
        error = shown.generated[:, 0] - shown.target
        traces = [Curve(shown.crank, error, "", LIMIT, 1.5, gid="error")]
        if len(at) <= 100:
            traces.append(Curve(at, np.interp(at, shown.crank, error), "", LIMIT, mode="markers", size=3.5, gid="positions"))
        panels.append(Panel(Axis(f"generated minus target [{shown.name.rpartition('[')[2]}"), traces))
    heading = title_of(view, 7.0, view.task.title, wrapped(figures(view), 7.0, "; "))
    title = "Transmission angle" if shown.target is None else "Output over the range"
    return ChartSpec("curve", title, panels, _crank(view, shown), heading, warning=not view.design.valid)


def function_values(view: PathView) -> list[ChartSpec]:
    """Return the prescribed and the generated y(x) of a function; nothing for a law of the crank angle or a transmission."""
    function = getattr(view.task.requirement, "law", None)
    if not isinstance(function, Function):
        return []
    shown = output(view)
    assert shown.target is not None
    offsets, error = np.radians(shown.crank - shown.crank[0]), (shown.target - shown.generated[:, 0]) / shown.factor
    if not np.any(np.isfinite(error)):
        return []
    title = title_of(view, 7.6, f"{view.task.title}: {function.text}")
    return [function_chart(function, offsets, error, title, warning=not view.design.valid)]


def _crank(view: PathView, shown: OutputCurves) -> Axis:
    ends = sorted((float(shown.crank[0]), float(shown.crank[-1])))
    return crank_angle(clockwise=view.direction < 0.0, limits=(ends[0], ends[1]))


def _outputs(shown: OutputCurves) -> Panel:
    """Return the panel of all curves of an output."""
    traces = []
    if shown.target is not None:
        traces.append(Curve(shown.crank, shown.target, "target", TARGET, 1.4, "dash", gid="target"))
    for k, name in enumerate(shown.curves):
        texts = name
        if shown.target is None:
            least, largest = np.nanmin(shown.generated[:, k]), np.nanmax(shown.generated[:, k])
            texts = f"at {name}: {least:z.2f}° to {largest:z.2f}°"
        traces.append(Curve(shown.crank, shown.generated[:, k], texts, BODIES[k % len(BODIES)], 1.9, gid=f"generated {name}"))
    return Panel(Axis(shown.name), traces, 1.6)


def output_film(view: PathView, steps: Array, titles: Sequence[str]) -> list[Image.Image]:
    """Draw the frames of the mechanism at crank angles [rad] beside its output or its transmission angles."""
    shown = output(view)
    order = np.argsort(shown.crank)
    height = np.interp(np.degrees(steps), shown.crank[order], shown.generated[order, 0])
    marks = np.stack([np.degrees(steps), height], axis=-1)
    return film(view.sketch, view.sweep(steps), ChartSpec("", "", [_outputs(shown)], _crank(view, shown)), marks, titles)
