"""Curves of the dyads of four poses: pivots in the frame and points of the body, with the parts that can be used."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.presentation.chart_spec import CRANK, LIMIT, MUTED, RESULT, ROCKER, TARGET, Axis, ChartSpec, Curve, Mark, Panel
from optlink.presentation.format import scale
from optlink.presentation.views.design_charts import FRAME_SIZE, small_frames
from optlink.presentation.views.design_view import DesignView
from optlink.synthesis.families import Family, TimedFamily
from optlink.synthesis.four_poses import DyadCurves, Pairs, Positions, pairs
from optlink.tasks.five_targets import SliderCrank, frame_direction, loop_of
from optlink.tasks.four_poses import applies, curves_of, family_of
from optlink.tasks.results.design import SynthesisResult

WINDOW = 1.6  # room about poses and linkage, as a share of their extent
FAR = 20.0  # extent of what is drawn, as a share of that of the window


class _Window:
    """The part of the plane about some points that is drawn."""

    def __init__(self, about: Array) -> None:
        low, high = about.min(axis=0), about.max(axis=0)
        self.middle, self.half = 0.5 * (low + high), 0.5 * WINDOW * np.max(high - low)
        self.unit = scale(self.half, "m")

    def near(self, places: Array) -> NDArray[np.bool_]:
        """Return whether places (n, 2) are drawn."""
        return np.asarray(np.max(np.abs(places - self.middle), axis=1) < FAR * self.half)

    def chart(self, title: str, heading: str, traces: list[Curve], marks: list[Mark]) -> ChartSpec:
        """Return the chart of the window."""
        ends = np.stack([self.middle - self.half, self.middle + self.half], axis=1) * self.unit.factor
        x, y = (Axis(f"{name} [{self.unit.unit}]", (low, high)) for name, (low, high) in zip("xy", ends, strict=True))
        return ChartSpec("dyads", title, [Panel(y, traces, marks=marks)], x, heading, equal=True, cursor=False, width=6.4)


def _plane(numbers: NDArray[Any]) -> Array:
    """Return complex numbers as places (n, 2)."""
    return np.stack([numbers.real, numbers.imag], axis=1)


def charts(result: SynthesisResult, shown: list[DesignView]) -> Iterator[ChartSpec]:
    """Yield the curves of each requirement with four poses, those of its first assembly mode if there is no design."""
    if shown:
        for view in shown:
            if (curves := curves_of(view.task)) is not None and len(curves.points):
                yield from _charts(curves, view)
            elif curves is None and applies(view.task):
                yield from _family_charts(family_of(view.task), view)
        return
    for task in result.problem.variants()[0].spec.parts:
        if (curves := curves_of(task)) is not None and len(curves.points):
            yield from _charts(curves, None)


def _links(view: DesignView | None) -> tuple[Array, Array]:
    """Return points and pivots (2, 2) [m] of crank and rocker at the first pose; empty unless a coupler is guided."""
    loop = None if view is None else view.task.four_bar
    if view is None or loop is None or loop.coupler.body != view.task.body:
        return np.empty((0, 2)), np.empty((0, 2))
    places = {name: view.at.position(name)[0] for name in (loop.pin, loop.joint, view.task.linkage.crank.start, loop.ground_pin)}
    pin, joint, pivot, fixed = places.values()
    return np.array([pin, joint]), np.array([pivot, fixed])


def _charts(curves: DyadCurves, view: DesignView | None) -> Iterator[ChartSpec]:
    points, pivots = _links(view)
    partners = None
    if len(points):
        (begin, _), (pivot, _) = (places @ np.array([1.0, 1j]) for places in (points, pivots))
        partners = pairs(curves.places, curves.angles, (begin[None], pivot[None]), curves.dyads)
    spans = view is not None and view.task.limits.crank == "span"  # the crank need not turn fully
    poses = _plane(curves.places)
    window = _Window(np.concatenate([poses, points, pivots]))
    factor, heading = window.unit.factor, "Dyads of four poses" if view is None else f"{view.title}: dyads of the four poses"
    for title, places, own, axes in (
        ("Pivots of all dyads in the frame", curves.pivots, pivots, "frame"),
        ("Points of all dyads on the body, at pose 1", curves.points, points, "body"),
    ):
        traces = list(_parts(curves, places, window, partners, spans=spans))
        frames = small_frames(poses * factor, curves.angles, FRAME_SIZE * curves.size * factor)
        traces.append(Curve.through(frames, "poses", TARGET, 1.3, hover=False, gid="poses"))
        marks = [Mark(x, y, str(k), TARGET, size=2.5, written=True) for k, (x, y) in enumerate(poses * factor, start=1)]
        if axes == "frame":
            traces.append(Curve.through(curves.poles * factor, "poles", LIMIT, mode="markers", symbol="cross", size=5.0))
        for name, colour, place in zip(("driver", "partner"), (CRANK, ROCKER), own, strict=False):
            x, y = place * factor
            row = int(np.nanargmin(np.linalg.norm(places[1:-1] - place, axis=1))) + 1
            dx, dy = places[row + 1] - places[row - 1]
            way = math.copysign(1.0 / max(math.hypot(dx, dy), 1e-300), dy) if dx * dx + dy * dy > 0.0 else 0.0  # to the right
            marks.append(Mark(x, y, name, colour, size=7.0, prefer=(way * dy, -way * dx), written=True))
        yield window.chart(title, heading, traces, marks)


def _parts(curves: DyadCurves, places: Array, window: _Window, partners: Pairs | None, *, spans: bool) -> Iterator[Curve]:
    """Yield the curve in colours: all dyads, those whose crank passes the poses in order, the partners of the driver."""
    near = window.near(places)
    parts = [("all dyads", MUTED, 1.0, near), ("may drive: poses in order", RESULT, 2.2, near & curves.in_order)]
    if partners is not None:
        usable = (partners.defect[0] == 0) & (partners.turns[0] | spans)
        parts.append(("usable partners of the driver", ROCKER, 4.5, near & usable))
    for name, colour, width, kept in parts:
        line = np.where(kept[:, None], places, np.nan) * window.unit.factor
        yield Curve.through(line, name, colour, width, opacity=0.55 if width > 4.0 else 1.0, hover=False, gid=name)


def _family_charts(family: Family, view: DesignView) -> Iterator[ChartSpec]:
    """Yield the curves of the joints of all linkages of a family at the first target, with the usable ones in colour.

    Of timed points they are those of all cranks, and of the partners of the crank that is drawn.
    """
    task, loop = view.task, loop_of(view.task)
    if family.drivers.special or loop is None:
        return
    ends_of = (loop.joint,) if isinstance(loop, SliderCrank) else (loop.joint, loop.ground_pin)
    names = task.linkage.crank.start, loop.pin, *ends_of
    pivot, pin, joint, *fixed = (complex(*view.at.position(name)[0]) for name in names)
    if isinstance(family, TimedFamily):
        found = family.of_cranks(np.array([pivot]), np.array([pin - pivot]), np.arange(0.0, len(family.rows), 0.25))
        usable, of, titles = _usable(found, view)[0], "partners of the drawn crank", ("Pivots", "Pins and joints, at point 1")
        ends = found.fixed[0], found.joint[0, :, 0]
        cranks, marks = [*family.ends(np.arange(float(len(family.drivers.points))))], [[pivot, *fixed], [pin, joint]]
    else:
        found = family.positions(np.arange(len(family.drivers.points), dtype=float), family.rows)
        usable, of, titles = _usable(found, view)[:, 0], "all", ("Crank pins at position 1", "Joints of the output there")
        turned = fixed[0] - pivot if fixed else np.exp(1j * frame_direction(task))
        ends = pivot + turned * found.pin[:, 0, 0], pivot + turned * found.joint[:, 0, 0]
        cranks, marks = [], [[pin], [joint]]
    window = _Window(_plane(np.array([pivot, pin, joint, *fixed])))
    size = window.unit.factor
    for k, (title, end) in enumerate(zip(titles, ends, strict=True)):
        layers = [("all cranks", MUTED, 1.0, cranks[k])] if cranks else []
        layers.append((of, RESULT if cranks else MUTED, 1.0, end))
        layers.append(("usable: targets in order", ROCKER, 3.5, np.where(usable, end, np.nan)))
        traces = []
        for name, colour, width, line in layers:
            places = _plane(line)
            places[~window.near(places)] = np.nan
            traces.append(Curve.through(places * size, name, colour, width, opacity=0.6 if width > 2.0 else 1.0, hover=False))
        frame = _plane(np.array([pivot, *fixed])) * size
        traces.append(Curve.through(frame, "pivots", TARGET, 1.3, mode="markers", symbol="cross", size=5.0))
        drawn = zip(marks[k], ("drawn", "partner"), (CRANK, ROCKER), strict=False)
        points = [Mark(z.real * size, z.imag * size, name, colour, size=7.0, written=True) for z, name, colour in drawn]
        yield window.chart(title, f"{view.title}: all linkages of the targets", traces, points)


def _usable(found: Positions, view: DesignView) -> Array:
    """Return whether linkages pass the targets in order, (drivers, followers)."""
    return np.asarray((found.pairs.defect == 0) & (found.pairs.turns | (view.task.limits.crank == "span")))
