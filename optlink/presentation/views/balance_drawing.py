"""Drawing of a balanced machine with its counterweights to scale."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.drawing import Sketch
from optlink.presentation.format import scale
from optlink.presentation.labels import Label, in_points, lay_out, place_labels
from optlink.presentation.style import figure, heading, styled
from optlink.tasks.results.balance import AddedCounterweight, Balance


@styled
def mechanism(result: Balance) -> Figure:
    """Draw the machine with its counterweights to scale: discs solid, other shapes dashed with their radius of gyration."""
    machine = result.heavier
    assert machine is not None
    sketch = Sketch(machine.motion(result.angles, result.speed), machine)
    for counterweight in result.added:
        corners = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * _size(counterweight, sketch)
        sketch.widen((_centres(counterweight, sketch, sketch.motion)[:, None, :] + corners).reshape(-1, 2))
    start = result.problem.model.driving.first
    turn = math.copysign(TURN, result.speed)
    full = len(result.angles) == (result.problem.model.balance.positions if result.problem.model.balance else 0)
    places = [start, start + 0.5 * turn] if full else [result.angles[0], result.angles[-1]]
    panel = 5.2
    fig = figure(2.0 * panel, (panel - 0.7) * min(max(sketch.ratio, 0.35), 1.4) + 1.4)
    labels: list[Label] = []
    shown = []
    for axes, at in zip(fig.subplots(1, 2, sharey=True), places, strict=True):
        position = machine.motion(np.array([at]), result.speed)
        labels += sketch.show(axes, position)
        for counterweight in result.added:
            centre, body = _centres(counterweight, sketch, position)[0], counterweight.body
            shown.append((axes, counterweight, centre))
            _disc(axes, sketch, counterweight, centre)
            x, y = _centres(counterweight, sketch, sketch.motion).T
            axes.plot(x, y, color=sketch.colours[body], linewidth=0.8, linestyle=":", zorder=1, gid=f"track {body}")
        driving = result.problem.model.driving
        axes.set_title(f"φ {math.degrees(at) % 360.0:.4g}°" if driving.ends is None else driving.text(at), fontsize=9.5)
    sketch.add_legend(fig)
    fig.suptitle(heading(f"{result.problem.model.title}: counterweights to scale", 2.0 * panel), fontsize=11)
    lay_out(fig)
    labels += [_mass_label(axes, sketch, counterweight, centre) for axes, counterweight, centre in shown]
    place_labels(fig, labels)
    return fig


def _centres(counterweight: AddedCounterweight, sketch: Sketch, motion: Motion) -> Array:
    """Return the centres of a counterweight in a motion (positions, 2), in the display unit."""
    return sketch.placed(motion, counterweight.body, np.array([counterweight.place]) * sketch.scale.factor)[:, 0]


def _size(counterweight: AddedCounterweight, sketch: Sketch) -> float:
    """Return the radius to draw, in the display unit."""
    return (counterweight.radius if counterweight.radius is not None else counterweight.gyration) * sketch.scale.factor


def _disc(axes: Axes, sketch: Sketch, counterweight: AddedCounterweight, centre: Array) -> None:
    """Draw a counterweight."""
    colour, disc = sketch.colours[counterweight.body], counterweight.radius is not None
    face, place = (*to_rgb(colour), 0.30 if disc else 0.10), (centre[0], centre[1])
    shape = Circle(place, _size(counterweight, sketch), facecolor=face, edgecolor=colour)
    shape.set(linewidth=1.6, linestyle="-" if disc else "--", zorder=2.5, gid=f"counterweight {counterweight.body}")
    axes.add_patch(shape)


def _mass_label(axes: Axes, sketch: Sketch, counterweight: AddedCounterweight, centre: Array) -> Label:
    """Label a counterweight with its mass and size."""
    radius = counterweight.radius
    shown = counterweight.gyration if radius is None else 2.0 * radius
    size = f"{'gyration' if radius is None else '∅'} {scale(shown, 'm').text(shown)}"
    text = f"{counterweight.body}: {counterweight.mass:.4g} kg\n{size}"
    clear = in_points(axes, _size(counterweight, sketch))
    return Label(axes, (centre[0], centre[1]), text, sketch.colours[counterweight.body], 8.5, clear)
