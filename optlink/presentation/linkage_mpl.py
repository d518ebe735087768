"""The linkage of any result, drawn into axes of matplotlib or moving."""

from __future__ import annotations

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from optlink.errors import InputError
from optlink.linkage.arguments import check_number
from optlink.presentation.drawing import Sketch
from optlink.presentation.export.export import check_unit_of_place, place_of
from optlink.presentation.format import single_units
from optlink.presentation.html.moving_linkage import Moving
from optlink.presentation.html.page import moving_linkage
from optlink.presentation.labels import lay_out
from optlink.presentation.scene import MM
from optlink.presentation.shapes import even
from optlink.presentation.style import HALO, apply_style, figure, heading, legible, notebook_figure, styled
from optlink.problem.arguments import typed
from optlink.problem.document import Document

STEPS = 120  # positions per revolution of traces
WIDTH = 5.0  # of a figure [inch]
MOST_FRAMES = 1000
PAUSE = 40  # between the frames of an animation [ms]


class LinkageAnimation(FuncAnimation):
    """An animation of matplotlib that a notebook shows with buttons and a slider; `save` writes it."""

    def _repr_html_(self) -> str:
        """Return the animation as a page of JavaScript, without the setting `animation.html` of matplotlib."""
        html: str = self.to_jshtml()
        return html


def _moving(result: Document) -> tuple[Moving, Sketch]:
    """Return the moving linkage of a result, and its sketch at all positions.

    Raises
    ------
    InputError
        If the result has no linkage, or one that cannot be assembled.
    """
    moving = moving_linkage(result, STEPS)
    if moving is None:
        remedy = f"Plot one of: {', '.join(result.plots)}" if result.plots else "Write its page: optlink.report(result, file)"
        raise InputError(f"this {result.kind} has no linkage that can be drawn in motion", remedy, key="plot")
    drawn = moving.scene
    sketch = Sketch(drawn.motion, moving.cycle.machine, regions=drawn.regions, unit=MM)
    return moving, sketch.moved(drawn.shown, closed=drawn.closed)


def _most_open(sketch: Sketch) -> int:
    """Return the position in which the joints spread most over the plane, so that the links cover each other least.

    The measure is the determinant of the covariance of the joints, which vanishes where all are in one line.
    """
    places = np.array([sketch.position(sketch.shown, name) for name in sketch.names])
    x, y = np.moveaxis(places - np.mean(places, axis=0), -1, 0)
    spread = np.sum(x * x, axis=0) * np.sum(y * y, axis=0) - np.sum(x * y, axis=0) ** 2
    spread[~np.isfinite(spread)] = -1.0
    return int(np.argmax(spread))


def _pose(sketch: Sketch, axes: Axes, k: int) -> list[Artist]:
    """Draw position `k` of a sketch with the names of its points, and return the artists."""
    artists = sketch.pose(axes, sketch.shown, k)
    for name, (places, chosen) in sketch.places_of_names.items():
        at = sketch.position(sketch.shown, name)[k] + places[chosen[k]]
        if np.all(np.isfinite(at)):
            text = axes.text(at[0], at[1], sketch.captions[name], ha="center", va="center", fontsize=9.0, zorder=9, clip_on=True)
            text.set(path_effects=HALO, gid=f"name {name}")
            artists.append(text)
    return artists


@typed
def draw_linkage(result: Document, ax: Axes | None = None, angle: float | None = None) -> Axes:
    """Draw the linkage of a result at a crank angle [rad]; see `Document.plot`."""
    axes = ax
    with single_units():
        moving, sketch = _moving(result)
        machine, cycle = moving.cycle.machine, moving.cycle
        at = float(sketch.shown.crank_angle[_most_open(sketch)])
        if angle is not None:
            check_unit_of_place(cycle, angle, "angle")
            at = place_of(cycle, check_number("angle", angle), "angle")
        sketch = sketch.moved(machine.motion([at], cycle.speed))
        if axes is None:
            fig = notebook_figure(WIDTH, min(WIDTH * sketch.ratio + 1.0, 8.0))
            with apply_style():
                axes = fig.add_subplot()
                title = f"{result.problem.model.title}\n{cycle.problem.model.driving.text(at)}"
                axes.set_title(heading(title, WIDTH), fontsize=10)
        with apply_style():
            sketch.stage(axes)
            _pose(sketch, axes, 0)
            legible(axes.figure)  # type: ignore[arg-type]
    return axes


@styled
@typed
def animate_linkage(result: Document, frames: int = 48) -> LinkageAnimation:
    """Return the linkage of a result in motion; see `Document.animate`."""
    if not 2 <= frames <= MOST_FRAMES:
        raise InputError("out of range", f"Give 2 to {MOST_FRAMES} frames", key="frames", value=frames)
    with single_units():
        moving, sketch = _moving(result)
        count = len(sketch.shown.crank_angle)
        chosen = even(count, frames + 1)[:-1] if sketch.closed else even(count, frames)  # a closed motion ends at its first
        fig = figure(WIDTH, min(WIDTH * sketch.ratio + 1.0, 8.0))
        fig.set_dpi(80)
        axes = fig.add_subplot()
        sketch.stage(axes)
        name = heading(result.problem.model.title, WIDTH)
        title = axes.set_title(f"{name}\n{moving.stops.name}", fontsize=10)
        legible(fig)
        lay_out(fig)  # once, not for each frame
    stops, drawn = moving.stops, list[Artist]()

    @styled
    def show(k: int) -> list[Artist]:
        while drawn:
            drawn.pop().remove()
        drawn.extend(_pose(sketch, axes, k))
        title.set_text(f"{name}\n{stops.name} {stops.values[k]:z.{stops.decimals}f}{stops.unit}")
        return drawn

    return LinkageAnimation(fig, show, frames=chosen.tolist(), interval=PAUSE, blit=False)
