"""Drawing of a balanced machine with its counterweights to scale."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import Array
from optlink.report.drawing import Sketch
from optlink.report.labels import Label, in_points, place_labels
from optlink.report.style import figure, heading, scale, styled
from optlink.tasks.results.balance import AddedCounterweight, Balance


@styled
def mechanism(result: Balance) -> Figure | None:
    """Draw the machine with its counterweights to scale: discs solid, other shapes dashed with their radius of gyration."""
    if result.heavier is None:
        return None
    machine = result.heavier
    sketch = Sketch(sweep(machine.mechanism, machine.sizes, result.angles, result.speed), machine)
    for one in result.added:
        size = _size(one, sketch)
        track = sketch.placed(sketch.motion, one.body, _centre(one, sketch))[:, 0]
        corners = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * size
        sketch.widen((track[:, None, :] + corners).reshape(-1, 2))
    start = result.problem.model.drive.start.value
    turn = math.copysign(2.0 * math.pi, result.speed)
    full = len(result.angles) == (result.problem.model.balance.positions if result.problem.model.balance else 0)
    places = [start, start + 0.5 * turn] if full else [float(result.angles[0]), float(result.angles[-1])]
    panel = 5.2
    made = figure(2.0 * panel, (panel - 0.7) * min(max(sketch.ratio, 0.35), 1.4) + 1.4)
    labels: list[Label] = []
    shown = []
    for axes, at in zip(made.subplots(1, 2, sharey=True), places, strict=True):
        here = sweep(machine.mechanism, machine.sizes, np.array([at]), result.speed)
        labels += sketch.show(axes, here)
        for one in result.added:
            shown.append((axes, one, sketch.placed(here, one.body, _centre(one, sketch))[0, 0]))
            _disc(axes, sketch, one, shown[-1][2])
            track = sketch.placed(sketch.motion, one.body, _centre(one, sketch))[:, 0]
            axes.plot(*track.T, color=sketch.colours[one.body], linewidth=0.8, linestyle=":", zorder=1, gid=f"track {one.body}")
        axes.set_title(f"φ {math.degrees(at) % 360.0:.4g}°", fontsize=9.5)
    sketch.add_legend(made)
    made.suptitle(heading(f"{result.problem.model.title}: counterweights to scale", 2.0 * panel), fontsize=11)
    made.draw_without_rendering()  # computes the layout, so that sizes in the figure are known
    labels += [_told(axes, sketch, one, centre) for axes, one, centre in shown]
    place_labels(made, labels)
    return made


def _centre(one: AddedCounterweight, sketch: Sketch) -> Array:
    return np.array([one.place]) * sketch.scale.factor


def _size(one: AddedCounterweight, sketch: Sketch) -> float:
    """Return the radius to draw, in the display unit."""
    return (one.radius if one.radius is not None else one.gyration) * sketch.scale.factor


def _disc(axes: Axes, sketch: Sketch, one: AddedCounterweight, centre: Array) -> None:
    """Draw a counterweight."""
    colour, disc = sketch.colours[one.body], one.radius is not None
    face, place = (*to_rgb(colour), 0.30 if disc else 0.10), (float(centre[0]), float(centre[1]))
    shape = Circle(place, _size(one, sketch), facecolor=face, edgecolor=colour)
    shape.set(linewidth=1.6, linestyle="-" if disc else "--", zorder=2.5, gid=f"counterweight {one.body}")
    axes.add_patch(shape)


def _told(axes: Axes, sketch: Sketch, one: AddedCounterweight, centre: Array) -> Label:
    """Label a counterweight with its mass and size."""
    shown = 2.0 * one.radius if one.radius is not None else one.gyration
    text = f"{one.body}: {one.mass:.4g} kg\n{'∅' if one.radius is not None else 'gyration'} {scale(shown, 'm').text(shown)}"
    clear = in_points(axes, _size(one, sketch))
    return Label(axes, (float(centre[0]), float(centre[1])), text, sketch.colours[one.body], 8.5, clear)
