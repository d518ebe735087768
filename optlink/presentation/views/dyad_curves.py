"""Curves of the dyads of four poses: pivots in the frame and points of the body, with the parts that can be used."""

import math
from collections.abc import Iterator

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.presentation.chart_spec import CRANK, LIMIT, MUTED, RESULT, ROCKER, TARGET, Axis, ChartSpec, Curve, Mark, Panel
from optlink.presentation.format import Scale, scale
from optlink.presentation.views.design_charts import FRAME_SIZE, small_frames
from optlink.presentation.views.design_view import DesignView
from optlink.synthesis.four_poses import DyadCurves, Pairs, pairs
from optlink.tasks.four_poses import curves_of
from optlink.tasks.results.design import SynthesisResult

WINDOW = 1.6  # room about poses and linkage, as a share of their extent
FAR = 20.0  # extent of what is drawn, as a share of that of the window


def charts(result: SynthesisResult, shown: list[DesignView]) -> Iterator[ChartSpec]:
    """Yield the curves of each requirement with four poses, those of its first assembly mode if there is no design."""
    if shown:
        for view in shown:
            if (curves := curves_of(view.task)) is not None and len(curves.points):
                yield from _charts(curves, view)
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
    poses = np.stack([curves.places.real, curves.places.imag], axis=1)
    about = np.concatenate([poses, points, pivots])
    low, high = about.min(axis=0), about.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * WINDOW * float(np.max(high - low))
    unit = scale(half, "m")
    for title, places, own, axes in (
        ("Pivots of all dyads in the frame", curves.pivots, pivots, "frame"),
        ("Points of all dyads on the body, at pose 1", curves.points, points, "body"),
    ):
        traces = list(_parts(curves, places, middle, half, partners, unit, spans=spans))
        frames = small_frames(poses * unit.factor, curves.angles, FRAME_SIZE * curves.size * unit.factor)
        traces.append(Curve.through(frames, "poses", TARGET, 1.3, hover=False, gid="poses"))
        marks = [Mark(x, y, str(k), TARGET, size=2.5, written=True) for k, (x, y) in enumerate(poses * unit.factor, start=1)]
        if axes == "frame":
            traces.append(Curve.through(curves.poles * unit.factor, "poles", LIMIT, mode="markers", symbol="cross", size=5.0))
        for name, colour, place in zip(("driver", "partner"), (CRANK, ROCKER), own, strict=False):
            x, y = place * unit.factor
            row = int(np.nanargmin(np.linalg.norm(places[1:-1] - place, axis=1))) + 1
            dx, dy = places[row + 1] - places[row - 1]
            way = math.copysign(1.0 / max(math.hypot(dx, dy), 1e-300), dy) if dx * dx + dy * dy > 0.0 else 0.0  # to the right
            marks.append(Mark(x, y, name, colour, size=7.0, prefer=(way * dy, -way * dx), written=True))
        (x0, y0), (x1, y1) = (middle - half) * unit.factor, (middle + half) * unit.factor
        x, y = Axis(f"x [{unit.unit}]", (x0, x1)), Axis(f"y [{unit.unit}]", (y0, y1))
        heading = "Dyads of four poses" if view is None else f"{view.title}: dyads of the four poses"
        yield ChartSpec("dyads", title, [Panel(y, traces, marks=marks)], x, heading, equal=True, cursor=False, width=6.4)


def _parts(
    curves: DyadCurves, places: Array, middle: Array, half: float, partners: Pairs | None, unit: Scale, *, spans: bool
) -> Iterator[Curve]:
    """Yield the curve in colours: all dyads, those whose crank passes the poses in order, the partners of the driver."""
    near = np.max(np.abs(places - middle), axis=1) < FAR * half
    parts = [("all dyads", MUTED, 1.0, near), ("may drive: poses in order", RESULT, 2.2, near & curves.in_order)]
    if partners is not None:
        usable = (partners.defect[0] == 0) & (partners.turns[0] | spans)
        parts.append(("usable partners of the driver", ROCKER, 4.5, near & usable))
    for name, colour, width, kept in parts:
        line = np.where(kept[:, None], places, np.nan) * unit.factor
        yield Curve.through(line, name, colour, width, opacity=0.55 if width > 4.0 else 1.0, hover=False, gid=name)
