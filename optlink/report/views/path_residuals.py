"""Chart of the deviations of a path or motion synthesis at every point."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from optlink.report.chart_spec import Axis, Bars, ChartSpec, Curve, Line, Panel, Trace
from optlink.report.style import FOUND, LIMIT, QUIET
from optlink.report.views.path_captions import figures, fitting, length, title_of, wrapped
from optlink.report.views.path_closeup import ALLOWED, NUMBERED
from optlink.report.views.path_tables import exact, exact_angles
from optlink.report.views.path_view import PathView
from optlink.tasks.results.path import LEVEL

Array = NDArray[np.float64]
BARS = 40  # number of points up to which bars beyond their tolerance are red
CUT = 4.0  # points without tolerance are cut off beyond this multiple of the deviations with tolerance
NOTHING = 1e-3  # components below this share of the largest deviation are not shown


def errors(track: PathView) -> ChartSpec:
    """Return the deviation at every point: distance, components, and for poses the angle."""
    turned = track.design.measured.turned
    panels = [_distances(track)]
    if not track.exact:
        panels.append(_directions(track))
    if turned is not None:
        panels.append(_turned(track, turned))
    count = len(track.targets)
    every = next(step for step in (1, 2, 5, 10, 20, 50, 100) if count <= NUMBERED * step or step == 100)
    ticks = [(float(k), str(k)) for k in range(1, count + 1) if k % every == 0]
    what = "point" if turned is None else "pose"
    x = Axis(what, (0.4, count + 0.6), ticks=ticks)
    heading = title_of(track, 7.2, f"{track.task.title}: deviations", wrapped(figures(track), 7.2, "; "))
    title, page = f"How far the {what}s are missed", not exact(track.design)
    return ChartSpec("errors", title, panels, x, heading, warning=not track.design.valid, cursor=False, page=page)


def _bars(values: Array, colours: str | list[str], gid: str, name: str = "", place: float = 0.0, wide: float = 0.6) -> Bars:
    return Bars(np.arange(1.0, len(values) + 1.0) + place, values, name, colours, wide, gid=gid)


def _rounding(name: str, values: Array, level: float, unit: str) -> Panel:
    """Return deviations that are rounding error on a logarithmic axis, with the level of rounding."""
    low = 1e-9 * level
    numbers = np.arange(1.0, len(values) + 1.0)
    trace = Curve(numbers, np.maximum(values, low), "", QUIET, mode="markers", size=4.0, gid="exact")
    line = Line(level, f"exact to rounding: all below {level:.1e} {unit}", FOUND, gid="level")
    return Panel(Axis(f"{name} [{unit}]", (low / 3.0, 1e4 * level), "log"), [trace], lines=[line])


def _bulk(track: PathView) -> NDArray[np.bool_]:
    """Return the points whose bars set the scale.

    These are all points, or only those with a tolerance if the others deviate so far that they would hide them.
    """
    distances, known = track.design.measured.distances, np.isfinite(track.tolerances)
    if not np.any(known) or np.all(known):
        return np.ones(len(known), dtype=bool)
    near = max(float(np.nanmax(distances[known])), float(np.max(track.tolerances[known])))
    return known if float(np.nanmax(distances[~known])) > CUT * near else np.ones(len(known), dtype=bool)


def _distances(track: PathView) -> Panel:
    distances, tolerances = track.design.measured.distances, track.tolerances
    if track.exact:
        unit = track.sketch.scale
        return _rounding("distance", distances * unit.factor, LEVEL * track.task.size * unit.factor, unit.unit)
    largest = float(np.nanmax(distances))
    unit = fitting(largest, track.sketch.scale)
    known, bulk = np.isfinite(tolerances), _bulk(track)
    beyond = [LIMIT if far else FOUND for far in distances > tolerances * (1.0 + 1e-6)]
    traces: list[Trace] = [_bars(distances * unit.factor, beyond if len(beyond) <= BARS else FOUND, "distances")]
    top = float(np.nanmax(distances[bulk]))
    if np.any(known):
        seen = known & (tolerances <= 4.0 * largest)
        top = max(top, float(np.max(tolerances[seen], initial=0.0)))
        numbers = np.arange(1.0, len(distances) + 1.0)[seen]
        edges = np.stack([numbers - 0.5, numbers + 0.5, np.full_like(numbers, np.nan)], axis=1).ravel()
        heights = np.repeat(tolerances[seen] * unit.factor, 3)
        traces.append(Curve(edges, heights, "tolerance" if np.any(seen) else "", ALLOWED, 1.8, gid="tolerance"))
        if not np.all(seen[known]):
            least = length(float(np.min(tolerances[known & ~seen])), track.sketch.scale)
            told = f"tolerances from {least} on lie above" if np.any(seen) else f"tolerance, {least}, lies above"
            traces.append(Curve(np.full(1, np.nan), np.full(1, np.nan), told, ALLOWED))
    return Panel(Axis(f"distance [{unit.unit}]", (0.0, 1.1 * top * unit.factor)), traces)


def _directions(track: PathView) -> Panel:
    """Return the components along and across the curve, to the left of the motion; x and y where the velocity vanishes."""
    miss = track.generated - track.targets
    speed = track.way * track.at.velocity(track.task.requirement.point)
    fast = np.linalg.norm(speed, axis=1)
    largest = float(np.nanmax(np.linalg.norm(miss, axis=1)))
    unit = fitting(largest, track.sketch.scale)
    parts = {"in x": miss[:, 0], "in y": miss[:, 1]}
    if np.all(np.isfinite(fast)) and float(np.min(fast)) > 1e-9 * track.task.size:
        (tx, ty), (x, y) = (speed / fast[:, None]).T, miss.T
        parts = {"along the curve": tx * x + ty * y, "across, to the left": tx * y - ty * x}
        along, across = parts.values()
        if float(np.max(np.abs(along))) < NOTHING * largest:
            parts = {"across the curve, to the left; along it none": across}
        elif float(np.max(np.abs(across))) < NOTHING * largest:
            parts = {"along the curve; across it none": along}
    two, bulk = len(parts) > 1, _bulk(track)
    traces = []
    for k, (name, values) in enumerate(parts.items()):
        place, wide = ((k - 0.5) * 0.36, 0.34) if two else (0.0, 0.6)
        traces.append(_bars(values * unit.factor, QUIET if two and k == 0 else FOUND, name, name, place, wide))
    every = np.array([values[bulk] for values in parts.values()]) * unit.factor
    low, high = min(0.0, float(np.nanmin(every))), max(0.0, float(np.nanmax(every)))
    room = 0.06 * (high - low)
    return Panel(Axis(f"generated minus target [{unit.unit}]", (low - room, high + room)), traces)


def _turned(track: PathView, turned: Array) -> Panel:
    name = "generated minus target angle"
    if exact_angles(track.design):
        return _rounding(name, np.degrees(np.abs(turned)), math.degrees(LEVEL), "deg")
    return Panel(Axis(f"{name} [deg]"), [_bars(np.degrees(turned), FOUND, "turned")])
