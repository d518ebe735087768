"""Charts of a path or motion synthesis: close-up of the curve with its deviations, and the deviation at every point."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from optlink.report.chart_mpl import into
from optlink.report.chart_spec import Array, Axis, Bars, ChartSpec, Curve, Line, Mark, Panel, Trace
from optlink.report.labels import Label
from optlink.report.shapes import even, finite
from optlink.report.style import BODIES, FOUND, LIMIT, QUIET, TARGET, scale
from optlink.report.views.path_tables import exact, exact_angles
from optlink.report.views.path_view import PathView, figures, fitting, length, title_of, wrapped
from optlink.tasks.results.path import LEVEL

NUMBERED = 20  # number of points up to which each is numbered
SAME = 5e-3  # distance below which points share a label, as a share of the extent of the points
FRAMED = 40  # largest number of poses drawn as frames
AWAY = 0.25  # distance up to which the curve is included, as a share of the extent of the points
FRAME = 0.13  # size of a pose frame, as a share of the extent of the points
ALLOWED = BODIES[2]
CIRCLE = np.array([(math.cos(t), math.sin(t)) for t in np.linspace(0.0, 2.0 * math.pi, 73)] + [(math.nan, math.nan)])


def dots(count: int) -> float:
    """Return the marker size of a point [pt]."""
    return 3.8 if count <= NUMBERED else 3.0 if count <= 100 else 2.0


def points_on(axes: Axes, places: Array, size: float = 1.0) -> None:
    """Draw the precision points.

    Parameters
    ----------
    axes : Axes
    places : array (n, 2)
        In the unit of the axes.
    size : float, optional
        Factor on the marker size.
    """
    size *= dots(len(places))
    axes.plot(*places.T, linestyle="none", marker="o", markersize=size, color=TARGET, mew=0.0, zorder=5, gid="target")


def small_frames(places: Array, angles: Array, length: float) -> Array:
    """Return small coordinate frames, an arrow along x and a short line along y, as one line with gaps, shape (10 n, 2).

    Parameters
    ----------
    places : array (n, 2)
        Origins, in the unit of the axes.
    angles : array (n,) [rad]
    length : float
        Length of the arrow, in the unit of the axes.
    """
    x, y = np.stack([np.cos(angles), np.sin(angles)], axis=-1), np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    gap = (math.nan, math.nan)
    strokes = [(0.0, 0.0), (1.0, 0.0), gap, (0.8, 0.11), (1.0, 0.0), (0.8, -0.11), gap, (0.0, 0.0), (0.0, 0.45), gap]
    return np.stack([places + length * (a * x + b * y) for a, b in strokes], axis=1).reshape(-1, 2)


def _listed(numbers: list[int]) -> str:
    """Format point numbers; consecutive numbers as a range."""
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{numbers[0]}–{numbers[-1]}"
    return ", ".join(map(str, numbers))


def _fold(magnified: float) -> str:
    return f", drawn {magnified:g}-fold" if magnified > 1.0 else ""


class Close:
    """Close-up of the coupler curve in its own axes: precision points, tolerances, deviations, poses."""

    def __init__(self, track: PathView) -> None:
        self.track = track
        self.unit = scale(float(np.nanmax(np.abs(np.concatenate([track.targets, track.generated])))), "m")
        self.length = FRAME * track.size * self.unit.factor
        self.motion = track.task.requirement.kind == "motion"
        self.shown = even(len(track.targets), FRAMED)

    def _ends(self, magnified: float) -> Array:
        """Return the end points of the deviation lines [m]."""
        ends: Array = self.track.targets + magnified * (self.track.generated - self.track.targets)
        return ends

    def _poses(self) -> tuple[Array, Array]:
        """Return the prescribed and the generated frames as lines."""
        track, k = self.track, self.shown
        aim = np.arctan2(track.task.data.columns[:, 3], track.task.data.columns[:, 2])
        targets = small_frames(track.targets[k] * self.unit.factor, aim[k], self.length)
        return targets, small_frames(track.generated[k] * self.unit.factor, track.angles(track.at)[k], self.length)

    def limits(self) -> tuple[Array, Array]:
        """Return the least and largest coordinates to show, with a margin; the aspect ratio is at most two.

        The curve is included as far as it stays near the points.
        """
        track, factor = self.track, self.unit.factor
        radii = np.where(np.isfinite(track.tolerances), track.tolerances * track.factor, 0.0)[:, None]
        seen = [track.targets - radii, track.targets + radii, track.generated, self._ends(track.factor)]
        must = finite(np.concatenate([*(part * factor for part in seen), *(self._poses() if self.motion else ())]))
        low, high = must.min(axis=0), must.max(axis=0)
        size = high - low
        room = AWAY * float(np.max(size))
        run = np.clip(finite(track.position(track.run) * factor), low - room, high + room)
        low, high = np.minimum(low, run.min(axis=0)), np.maximum(high, run.max(axis=0))
        size = high - low
        half = 0.5 * np.maximum(1.16 * size, 0.5 * 1.16 * float(np.max(size)))
        return 0.5 * (low + high) - half, 0.5 * (low + high) + half

    @property
    def ratio(self) -> float:
        """Height divided by width."""
        low, high = self.limits()
        return float((high - low)[1] / (high - low)[0])

    @property
    def once(self) -> bool:
        """Whether the run from the first to the last point is the whole curve."""
        track = self.track
        return bool(np.ptp(track.run.crank_angle) >= np.ptp(track.motion.crank_angle) - 1e-9)

    def chart(self, magnified: float | None = 1.0, *, points: bool = True) -> ChartSpec:
        """Return the close-up as a chart: the curve, points, tolerances, deviations and poses.

        Parameters
        ----------
        magnified : float or None, optional
            Magnification of tolerances and deviations; None leaves them out.
        points : bool, optional
            Draw the generated points and the whole curve instead of the surroundings of the points.
        """
        track, factor, unit = self.track, self.unit.factor, self.unit.unit
        whole, run = (track.position(motion) * factor for motion in (track.motion, track.run))
        targets, found = track.targets * factor, track.generated * factor
        rest = "" if self.once else "rest of the curve"
        traces = [
            Curve.through(whole, rest, track.colour, 1.2, opacity=0.55, hover=False, gid="curve"),
            Curve.through(run, "generated curve", track.colour, 2.0, gid="run"),
        ]
        if magnified is not None:
            traces += [*self._tolerances(magnified), *self._deviations(magnified)]
        if self.motion:
            aims, poses = self._poses()
            traces.append(Curve.through(poses, "generated pose", track.colour, 2.6, opacity=0.6, hover=False, gid="poses"))
            traces.append(Curve.through(aims, "target pose", TARGET, 1.1, hover=False, gid="target poses"))
        numbers = [f"point {k + 1}" for k in range(len(targets))]
        if points:
            traces.append(Curve.through(found, "generated", LIMIT, mode="markers", symbol="plus", size=6.0, text=numbers))
        size = dots(len(targets)) * (0.6 if magnified is not None and np.any(np.isfinite(track.tolerances)) else 1.0)
        words = f"target point{'s' if len(targets) <= NUMBERED else f's, {len(targets)}'}"
        traces.append(Curve.through(targets, words, TARGET, mode="markers", size=size, text=numbers, gid="target"))
        (x0, y0), (x1, y1) = self.limits()
        x, y = Axis(f"x [{unit}]", None if points else (x0, x1)), Axis(f"y [{unit}]", None if points else (y0, y1))
        return ChartSpec("", "Path", [Panel(y, traces, marks=self._numbers(size))], x, equal=True, cursor=False)

    def draw(self, axes: Axes, magnified: float | None) -> list[Label]:
        """Draw the close-up without a legend and return the labels of the points.

        Parameters
        ----------
        axes : Axes
        magnified : float or None
            See `chart`.
        """
        labels = into(axes, self.chart(magnified, points=False), legend=False)
        axes.set_aspect("equal", adjustable="box")
        return labels

    def _tolerances(self, magnified: float) -> list[Curve]:
        """Return the tolerances as circles."""
        track = self.track
        known = np.isfinite(track.tolerances)
        if not np.any(known):
            return []
        circles = track.targets[known][:, None] + magnified * track.tolerances[known][:, None, None] * CIRCLE
        opacity = 0.9 if len(circles) <= 100 else 0.25
        places = circles.reshape(-1, 2) * self.unit.factor
        name = f"tolerance{_fold(magnified)}"
        return [Curve.through(places, name, ALLOWED, 0.9, opacity=opacity, hover=False, gid="tolerances")]

    def _deviations(self, magnified: float) -> list[Curve]:
        """Return the deviations as lines from the prescribed points."""
        track = self.track
        if track.exact:
            return []
        gaps = np.full_like(track.targets, np.nan)
        sticks = np.stack([track.targets, self._ends(magnified), gaps], axis=1).reshape(-1, 2) * self.unit.factor
        width = 1.4 if len(track.targets) <= 100 else 0.7
        return [Curve.through(sticks, f"deviation{_fold(magnified)}", LIMIT, width, hover=False, gid="deviations")]

    def _numbers(self, size: float) -> list[Mark]:
        """Return marks with the numbers of the points; every fifth, tenth, ... if there are many."""
        places = self.track.targets * self.unit.factor
        count = len(places)
        every = next(step for step in (1, 5, 10, 20, 50) if count <= NUMBERED * step or step == 50)
        chosen = [k for k in range(count) if k == 0 or (k + 1) % every == 0]
        middle = np.mean(places, axis=0)
        following = np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0)
        if not self.track.task.closed:
            following[0], following[-1] = places[1] - places[0], places[-1] - places[-2]
        names: dict[int, list[int]] = {}
        same = SAME * float(np.max(np.ptp(places, axis=0)))
        for k in chosen:  # coincident points share a label
            first = next((i for i in names if np.linalg.norm(places[i] - places[k]) <= same), k)
            names.setdefault(first, []).append(k + 1)
        found = []
        for k, numbers in names.items():  # prefer the outer side of the curve
            away = np.array([-following[k, 1], following[k, 0]])
            away = away / max(float(np.linalg.norm(away)), 1e-300)
            away = -away if float(away @ (places[k] - middle)) < 0.0 else away
            at, prefer = (float(places[k, 0]), float(places[k, 1])), (float(away[0]), float(away[1]))
            found.append(Mark(*at, _listed(numbers), TARGET, size=size, prefer=prefer, written=True, font=8.0))
        return found


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
    title, page = f"Deviations at the {what}s", not exact(track.design)
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
            exceeding = f"tolerances from {least} on lie above" if np.any(seen) else f"tolerance, {least}, lies above"
            traces.append(Curve.entry(exceeding, ALLOWED))
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
