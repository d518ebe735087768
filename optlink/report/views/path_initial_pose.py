"""Figure of a synthesised mechanism at its first position, with its coupler curve and the precision points."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon
from matplotlib.path import Path as Outline

from optlink.report.labels import Label
from optlink.report.style import CRANK
from optlink.report.views.path_closeup import NUMBERED, points_on, some
from optlink.report.views.path_view import PathView

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
            for k in some(len(places), GHOSTS):
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
