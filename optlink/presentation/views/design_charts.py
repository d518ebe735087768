"""Charts of a path or motion synthesis: close-up of the curve with its deviations, and the deviation at every point."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from PIL import Image

from optlink.linkage.dyads import transmitting
from optlink.linkage.vector2d import TURN
from optlink.optimization.output_errors import ErrorResiduals
from optlink.presentation.chart_mpl import draw_into
from optlink.presentation.chart_spec import (
    BODIES,
    LIMIT,
    MUTED,
    RESULT,
    TARGET,
    Array,
    Axis,
    Band,
    Bars,
    ChartSpec,
    Curve,
    Line,
    Mark,
    Panel,
    Span,
    Trace,
    crank_angle,
    max_abs,
)
from optlink.presentation.drawing import film
from optlink.presentation.format import scale, si
from optlink.presentation.labels import Label
from optlink.presentation.shapes import even, finite, left_of, normed, ways
from optlink.presentation.views.design_tables import captions, from_flat, words_of
from optlink.presentation.views.design_view import DesignView, fitting, title_of, wrapped
from optlink.problem.requirements.base import pose_angles
from optlink.problem.targets.law import Function

MAX_NUMBERED = 20  # number of points up to which each is numbered
COINCIDENT = 5e-3  # distance below which points share a label, as a share of the extent of the points
MAX_FRAMES = 40  # largest number of poses drawn as frames
CURVE_DISTANCE = 0.25  # distance up to which the curve is included, as a share of the extent of the points
FRAME_SIZE = 0.13  # size of a pose frame, as a share of the extent of the points
TOLERANCE_COLOUR = BODIES[2]
CIRCLE = np.array([(math.cos(t), math.sin(t)) for t in np.linspace(0.0, TURN, 73)] + [(math.nan, math.nan)])


def dots(count: int) -> float:
    """Return the marker size of a point [pt]."""
    return 3.8 if count <= MAX_NUMBERED else 3.0 if count <= 100 else 2.0


def points_on(axes: Axes, places: Array, size: float = 1.0) -> None:
    """Draw the precision points (n, 2); `size` is a factor on the marker size."""
    size *= dots(len(places))
    axes.plot(*places.T, linestyle="none", marker="o", markersize=size, color=TARGET, mew=0.0, zorder=5, gid="target")


def small_frames(places: Array, angles: Array, length: float) -> Array:
    """Return small coordinate frames, an arrow along x and a short line along y, as one line with gaps, shape (10 n, 2).

    `places` (n, 2) are the origins, `angles` (n,) in rad; the arrow has the given length.
    """
    x, y = ways(angles), left_of(ways(angles).T).T
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


class CloseUp:
    """Close-up of the coupler curve in its own axes: precision points, tolerances, deviations, poses."""

    def __init__(self, view: DesignView) -> None:
        self.track = view
        self.unit = scale(max_abs(np.concatenate([view.targets, view.generated])), "m")
        self.length = FRAME_SIZE * view.size * self.unit.factor
        self.motion = view.task.requirement.kind == "motion"
        self.shown = even(len(view.targets), MAX_FRAMES)

    def _ends(self, magnified: float) -> Array:
        """Return the end points of the deviation lines [m]."""
        ends: Array = self.track.targets + magnified * (self.track.generated - self.track.targets)
        return ends

    def _poses(self) -> tuple[Array, Array]:
        """Return the prescribed and the generated frames as lines."""
        view, k = self.track, self.shown
        target_angles = pose_angles(view.task.data.columns)[k]
        targets = small_frames(view.targets[k] * self.unit.factor, target_angles, self.length)
        return targets, small_frames(view.generated[k] * self.unit.factor, view.angles(view.at)[k], self.length)

    def limits(self) -> tuple[Array, Array]:
        """Return the least and largest coordinates to show, with a margin; the aspect ratio is at most two.

        The curve is included as far as it stays near the points.
        """
        view, factor = self.track, self.unit.factor
        radii = np.where(np.isfinite(view.tolerances), view.tolerances * view.factor, 0.0)[:, None]
        visible = [view.targets - radii, view.targets + radii, view.generated, self._ends(view.factor)]
        must = finite(np.concatenate([*(part * factor for part in visible), *(self._poses() if self.motion else ())]))
        low, high = must.min(axis=0), must.max(axis=0)
        size = high - low
        room = CURVE_DISTANCE * np.max(size)
        run = np.clip(finite(view.position(view.run) * factor), low - room, high + room)
        low, high = np.minimum(low, run.min(axis=0)), np.maximum(high, run.max(axis=0))
        size = high - low
        half = 0.5 * np.maximum(1.16 * size, 0.5 * 1.16 * np.max(size))
        return 0.5 * (low + high) - half, 0.5 * (low + high) + half

    @property
    def ratio(self) -> float:
        """Height divided by width."""
        low, high = self.limits()
        return float((high - low)[1] / (high - low)[0])

    @property
    def once(self) -> bool:
        """Whether the run from the first to the last point is the whole curve."""
        view = self.track
        return bool(np.ptp(view.run.crank_angle) >= np.ptp(view.motion.crank_angle) - 1e-9)

    def chart(self, magnified: float | None = 1.0, *, points: bool = True) -> ChartSpec:
        """Return the close-up as a chart: the curve, points, and poses; tolerances and deviations if they are magnified.

        `points` draws the generated points and the whole curve instead of the surroundings of the points.
        """
        view, factor, unit = self.track, self.unit.factor, self.unit.unit
        full_curve, run = (view.position(motion) * factor for motion in (view.motion, view.run))
        targets, generated = view.targets * factor, view.generated * factor
        rest = "" if self.once else "rest of the curve"
        traces = [
            Curve.through(full_curve, rest, view.colour, 1.2, opacity=0.55, hover=False, gid="curve"),
            Curve.through(run, "generated curve", view.colour, 2.0, gid="run"),
        ]
        if magnified is not None:
            traces += [*self._tolerances(magnified), *self._deviations(magnified)]
        if self.motion:
            target_poses, poses = self._poses()
            traces.append(Curve.through(poses, "generated pose", view.colour, 2.6, opacity=0.6, hover=False, gid="poses"))
            traces.append(Curve.through(target_poses, "target pose", TARGET, 1.1, hover=False, gid="target poses"))
        numbers = [f"point {k + 1}" for k in range(len(targets))]
        if points:
            traces.append(Curve.through(generated, "generated", LIMIT, mode="markers", symbol="plus", size=6.0, text=numbers))
        size = dots(len(targets)) * (0.6 if magnified is not None and np.any(np.isfinite(view.tolerances)) else 1.0)
        words = f"target point{'s' if len(targets) <= MAX_NUMBERED else f's, {len(targets)}'}"
        traces.append(Curve.through(targets, words, TARGET, mode="markers", size=size, text=numbers, gid="target"))
        (x0, y0), (x1, y1) = self.limits()
        x, y = Axis(f"x [{unit}]", None if points else (x0, x1)), Axis(f"y [{unit}]", None if points else (y0, y1))
        return ChartSpec("", "Path", [Panel(y, traces, marks=self._numbers(size))], x, equal=True, cursor=False, brief=True)

    def draw(self, axes: Axes, magnified: float | None) -> list[Label]:
        """Draw the close-up without a legend and return the labels of the points."""
        labels = draw_into(axes, self.chart(magnified, points=False), legend=False)
        axes.set_aspect("equal", adjustable="box")
        return labels

    def _tolerances(self, magnified: float) -> list[Curve]:
        """Return the tolerances as circles."""
        view = self.track
        limited = np.isfinite(view.tolerances)
        if not np.any(limited):
            return []
        circles = view.targets[limited][:, None] + magnified * view.tolerances[limited][:, None, None] * CIRCLE
        opacity = 0.9 if len(circles) <= 100 else 0.25
        places = circles.reshape(-1, 2) * self.unit.factor
        name = f"tolerance{_fold(magnified)}"
        return [Curve.through(places, name, TOLERANCE_COLOUR, 0.9, opacity=opacity, hover=False, gid="tolerances")]

    def _deviations(self, magnified: float) -> list[Curve]:
        """Return the deviations as lines from the prescribed points."""
        view = self.track
        if view.design.exact:
            return []
        gaps = np.full_like(view.targets, np.nan)
        sticks = np.stack([view.targets, self._ends(magnified), gaps], axis=1).reshape(-1, 2) * self.unit.factor
        width = 1.4 if len(view.targets) <= 100 else 0.7
        return [Curve.through(sticks, f"deviation{_fold(magnified)}", LIMIT, width, hover=False, gid="deviations")]

    def _numbers(self, size: float) -> list[Mark]:
        """Return marks with the numbers of the points; every fifth, tenth, ... if there are many."""
        places = self.track.targets * self.unit.factor
        count = len(places)
        every = next(step for step in (1, 5, 10, 20, 50) if count <= MAX_NUMBERED * step or step == 50)
        chosen = [k for k in range(count) if k == 0 or (k + 1) % every == 0]
        middle = np.mean(places, axis=0)
        following = np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0)
        if not self.track.task.closed:
            following[0], following[-1] = places[1] - places[0], places[-1] - places[-2]
        names: dict[int, list[int]] = {}
        same = COINCIDENT * np.max(np.ptp(places, axis=0))
        for k in chosen:  # coincident points share a label
            first = next((i for i in names if np.linalg.norm(places[i] - places[k]) <= same), k)
            names.setdefault(first, []).append(k + 1)
        marks = []
        for k, numbers in names.items():  # prefer the outer side of the curve
            outward = normed(left_of(following[k]))
            outward = -outward if float(outward @ (places[k] - middle)) < 0.0 else outward
            at, prefer = (places[k, 0], places[k, 1]), (outward[0], outward[1])
            marks.append(Mark(*at, _listed(numbers), TARGET, size=size, prefer=prefer, written=True, font=8.0))
        return marks


MAX_COLOURED_BARS = 40  # number of points up to which bars beyond their tolerance are red
CUT_RATIO = 4.0  # points without tolerance are cut off beyond this multiple of the deviations with tolerance


def errors(view: DesignView) -> list[ChartSpec]:
    """Return the deviation at every point: distance, components, and for poses the angle; nothing if all are met exactly."""
    if view.design.exact:
        return []
    turned = view.design.measured.turned
    panels = [_distances(view), _directions(view)]
    if turned is not None:
        panels.append(Panel(Axis("generated minus target angle [deg]"), [_bars(np.degrees(turned), RESULT, "turned")]))
    count, what = len(view.targets), words_of(view.design).spot
    every = next(step for step in (1, 2, 5, 10, 20, 50, 100) if count <= MAX_NUMBERED * step or step == 100)
    x = Axis(what, (0.4, count + 0.6), ticks=[(float(k), str(k)) for k in range(1, count + 1) if k % every == 0])
    heading = title_of(view, 7.2, f"{view.title}: deviations", wrapped(captions(view.design), 7.2, "; "))
    return [ChartSpec("errors", f"Deviations at the {what}s", panels, x, heading, warning=not view.design.valid, cursor=False)]


def _bars(values: Array, colours: str | list[str], gid: str, name: str = "", place: float = 0.0, wide: float = 0.6) -> Bars:
    return Bars(np.arange(1.0, len(values) + 1.0) + place, values, name, colours, wide, gid=gid)


def _bulk(view: DesignView) -> NDArray[np.bool_]:
    """Return the points whose bars set the scale.

    These are all points, or only those with a tolerance if the others deviate so far that they would hide them.
    """
    distances, limited = view.design.measured.distances, np.isfinite(view.tolerances)
    if not np.any(limited) or np.all(limited):
        return np.ones(len(limited), dtype=bool)
    near = max(np.nanmax(distances[limited]), np.max(view.tolerances[limited]))
    return limited if np.nanmax(distances[~limited]) > CUT_RATIO * near else np.ones(len(limited), dtype=bool)


def _distances(view: DesignView) -> Panel:
    distances, tolerances = view.design.measured.distances, view.tolerances
    largest = np.nanmax(distances)
    unit = fitting(largest, view.sketch.scale)
    limited, bulk = np.isfinite(tolerances), _bulk(view)
    beyond = [LIMIT if far else RESULT for far in distances > tolerances * (1.0 + 1e-6)]
    traces: list[Trace] = [_bars(distances * unit.factor, beyond if len(beyond) <= MAX_COLOURED_BARS else RESULT, "distances")]
    top = np.nanmax(distances[bulk])
    if np.any(limited):
        visible = limited & (tolerances <= 4.0 * largest)
        top = max(top, np.max(tolerances[visible], initial=0.0))
        numbers = np.arange(1.0, len(distances) + 1.0)[visible]
        edges = np.stack([numbers - 0.5, numbers + 0.5, np.full_like(numbers, np.nan)], axis=1).ravel()
        heights = np.repeat(tolerances[visible] * unit.factor, 3)
        traces.append(Curve(edges, heights, "tolerance" if np.any(visible) else "", TOLERANCE_COLOUR, 1.8, gid="tolerance"))
        if not np.all(visible[limited]):
            least = si(np.min(tolerances[limited & ~visible]), "m")
            exceeding = f"tolerances from {least} on lie above" if np.any(visible) else f"tolerance, {least}, lies above"
            traces.append(Curve.entry(exceeding, TOLERANCE_COLOUR))
    return Panel(Axis(f"distance [{unit.unit}]", (0.0, 1.1 * top * unit.factor)), traces)


def _directions(view: DesignView) -> Panel:
    """Return the components along and across the curve, to the left of the motion; x and y where the velocity vanishes."""
    miss, speed = view.generated - view.targets, view.direction * view.at.velocity(view.task.point)
    fast, unit = np.linalg.norm(speed, axis=1), fitting(np.nanmax(np.linalg.norm(miss, axis=1)), view.sketch.scale)
    names, parts = ("in x", "in y"), miss
    if np.all(np.isfinite(fast)) and np.min(fast) > 1e-9 * view.task.size:
        (tx, ty), (x, y) = (speed / fast[:, None]).T, miss.T
        names, parts = ("along the curve", "across, to the left"), np.stack([tx * x + ty * y, tx * y - ty * x], axis=1)
    parts = parts * unit.factor
    traces = [
        _bars(parts[:, k], colour, name, name, place, 0.34)
        for k, (name, colour, place) in enumerate(zip(names, (MUTED, RESULT), (-0.18, 0.18), strict=True))
    ]
    shown = parts[_bulk(view)]
    low, high = min(0.0, np.nanmin(shown)), max(0.0, np.nanmax(shown))
    room = 0.06 * (high - low)
    return Panel(Axis(f"generated minus target [{unit.unit}]", (low - room, high + room)), traces)


# Charts of a design over the crank angle: output of a law with its error, function y(x), transmission angles; their film.

POSITIONS = 721  # over the range of a law
MAX_MARKED = 100  # largest number of positions of a law that are marked


def law(view: DesignView) -> list[ChartSpec]:
    """Return the prescribed and the generated output of a law with their difference, and y(x) of a function."""
    task, design = view.task, view.design
    offsets, at = task.span * np.linspace(0.0, 1.0, POSITIONS), task.law.offsets
    target, prescribed = (task.law.curve(places, view.begin, design.own.get(task.base_name, 0.0)) for places in (offsets, at))
    unit = view.sketch.scale if task.slides else scale(0.0, "deg")
    error, at_marks = (unit.factor * design.errors(places) for places in (offsets, at))
    if not np.any(np.isfinite(error)):
        return []
    crank, marked = (view.crank(view.begin + places) for places in (offsets, at))
    above: list[Trace] = [
        Curve(crank, target * unit.factor, "target", TARGET, 1.4, "dash", gid="target"),
        Curve(crank, target * unit.factor + error, "generated", RESULT, 1.9, gid="generated"),
    ]
    below: list[Trace] = []
    worst = int(np.nanargmax(np.abs(error)))
    top, words = error[worst], f"largest {error[worst]:+.4g}{'°' if unit.unit == 'deg' else ' ' + unit.unit}"
    if task.robust is not None:  # there the error is prescribed minus generated
        high, low = (-unit.factor * end for end in ErrorResiduals(task).band(design.own, offsets))
        below.append(Band(crank, low, high, f"built, {task.robust.band}", LIMIT))
        top, words = (high if error[worst] > 0.0 else low)[worst], f"{words} nominal"
    below.append(Curve(crank, error, "" if task.robust is None else "nominal", LIMIT, 1.5, gid="error"))
    if len(at) <= MAX_MARKED:
        name = "design positions"
        above.append(Curve(marked, prescribed * unit.factor, name, TARGET, mode="markers", size=3.0, gid="positions"))
        below.append(Curve(marked, at_marks, "", LIMIT, mode="markers", size=3.0, gid="errors at the positions"))
    mark = Mark(crank[worst], top, words.replace("-", "−"), size=1.0, prefer=(0.0, np.sign(error[worst])))
    panels = [
        Panel(Axis(_output_axis(view, unit.unit)), above, 1.7),
        Panel(Axis(f"generated minus target [{unit.unit}]"), below, marks=[mark]),
    ]
    title = title_of(view, 7.0, view.title, wrapped(captions(design), 7.0, "; "))
    warning = not design.valid
    chart = ChartSpec("law", "Output over the range", panels, _crank(view, crank), title, warning=warning, brief=True)
    source = task.requirement.law
    if not isinstance(source, Function):
        return [chart]
    return [chart, _function(view, source, offsets, error / unit.factor)]


def _function(view: DesignView, function: Function, offsets: Array, error: Array) -> ChartSpec:
    """Return the prescribed and the generated y(x) of a function with the error in y."""
    least, largest = function.ends
    x = function.low + (function.high - function.low) * offsets / function.input
    target = np.asarray(function.expression({"x": x}) + 0.0 * x, dtype=float)
    deviation = error * (largest - least) / function.output
    most = float(deviation[worst := int(np.nanargmax(np.abs(deviation)))])
    mark = Mark(x[worst], most, f"largest {most:+.3g}".replace("-", "−"), size=1.0, prefer=(0.0, np.sign(most)))
    above = [
        Curve(x, target, "target", TARGET, 1.4, "dash", gid="target y"),
        Curve(x, target + deviation, "generated", RESULT, 1.8, gid="generated y"),
    ]
    below = Panel(Axis("generated minus target"), [Curve(x, deviation, "", LIMIT, 1.5, gid="error in y")], marks=[mark])
    panels, title = [Panel(Axis("y"), above, 1.7), below], title_of(view, 7.6, f"{view.title}: {function.text}")
    return ChartSpec("function", "Function y(x)", panels, Axis("x"), title, cursor=False, warning=not view.design.valid)


def transmission(view: DesignView) -> list[ChartSpec]:
    """Return the transmission angle of every dyad over the whole motion, with its limits and its extreme values."""
    task, groups = view.task, transmitting(view.task.linkage)
    places, extreme = view.transmission_extremes
    if not groups or not np.any(np.isfinite(extreme)):
        return []
    angles = np.union1d(view.motion.crank_angle, places[np.isfinite(places)])
    gamma, crank = np.degrees(view.transmission(angles)), view.crank(angles)
    begin, end = view.crank(np.sort([view.begin, view.end]))
    spans: list[Span] = []
    for turn in (-360.0, 0.0, 360.0) if view.partial else ():
        low, high = max(begin + turn, crank[0]), min(end + turn, crank[-1])
        if low < high - 1e-9:
            spans.append(Span(low, high, "" if spans else "range of the requirement", RESULT, 0.08))
    traces, lines, marks = [], [], []
    for k, group in enumerate(groups):
        colour, ends = RESULT if len(groups) == 1 else BODIES[k % len(BODIES)], np.degrees(extreme[k])
        name = f"at {group.joint}: {ends[0]:z.2f}° to {ends[1]:z.2f}°"
        traces.append(Curve(crank, gamma[:, k], name, colour, 1.9, gid=f"transmission {group.joint}"))
        words = f"smallest {ends[0]:z.2f}°", f"largest {ends[1]:z.2f}°{from_flat(*ends)}"
        for text, at, value, way in zip(words, view.crank(places[k]), ends, (-1.0, 1.0), strict=True):
            marks.append(Mark(at, value, text, colour, prefer=(0.0, way)))
        limit = task.limits.transmission_at(group.joint)
        for word, bound in () if limit is None else (("at least", limit.low), ("at most", limit.high)):
            lines += [] if bound is None else [(f"{word} {math.degrees(bound):.5g}°", math.degrees(bound))]
    within = task.limits.transmission_range == "span" and view.partial
    drawn = dict(lines)  # limits that several dyads share are one line
    if within:
        traces += [Curve(np.array([begin, end]), np.full(2, at), name, LIMIT, 1.3, "dash") for name, at in drawn.items()]
    limits = [] if within else [Line(at, name, LIMIT, 1.3) for name, at in drawn.items()]
    panel = Panel(Axis("transmission angle γ [deg]"), traces, 1.4, limits, marks)
    title = title_of(view, 7.0, f"{task.title}: transmission angle")
    x = _crank(view, crank)
    warning = not view.design.valid
    return [ChartSpec("transmission", "Transmission angle", [panel], x, title, spans=spans, warning=warning, brief=True)]


def output(view: DesignView) -> list[ChartSpec]:
    """Return the angle of the output lever over the whole motion, on pages alone; nothing without a lever."""
    if view.output is None or view.slides:
        return []
    angle = np.degrees(np.unwrap(np.asarray(view.motion.body_angle(view.output).value, dtype=float)))
    crank = view.crank(view.motion.crank_angle)
    name = f"{view.output}: {np.nanmin(angle):z.2f}° to {np.nanmax(angle):z.2f}°"
    panel = Panel(Axis(f"angle of {view.output} [deg]"), [Curve(crank, angle, name, BODIES[1], 1.9, gid="output")])
    return [ChartSpec("", f"Angle of {view.output}", [panel], _crank(view, crank), brief=True)]


def _crank(view: DesignView, crank: Array) -> Axis:
    return crank_angle(clockwise=view.direction < 0.0, limits=(np.min(crank), np.max(crank)))


def output_film(view: DesignView, steps: Array, titles: Sequence[str]) -> list[Image.Image]:
    """Draw the frames of the mechanism at crank angles [rad] beside its output, or else its transmission angle."""
    task, angles = view.task, view.motion.crank_angle
    if not hasattr(task.requirement, "output_of"):
        axis, values = "transmission angle γ [deg]", np.degrees(view.transmission(angles)[:, 0])
    else:
        unit = view.sketch.scale if task.slides else scale(0.0, "deg")
        jet = view.motion.coordinate(task.output) if task.slides else view.motion.body_angle(task.output)
        axis, values = _output_axis(view, unit.unit), np.asarray(jet.value) * unit.factor
    crank, at, order = view.crank(angles), view.crank(steps), np.argsort(angles)
    at = (at - crank.min()) % 360.0 + crank.min() if view.turns else at
    marks = np.stack([at, np.interp(at, crank[order], values[order])], axis=-1)
    strip = ChartSpec("", "", [Panel(Axis(axis), [Curve(crank, values, "", BODIES[1])])], _crank(view, crank))

    def required(axes: Axes) -> None:
        if view.partial:
            link = view.sketch.mechanism.crank
            pivot, pin = (view.sketch.position(view.run, name) for name in (link.start, link.end))
            axes.plot(*(0.45 * pivot + 0.55 * pin).T, color=MUTED, linewidth=1.3)

    return film(view.sketch, view.sweep(steps), strip, marks, titles, more=required)


def _output_axis(view: DesignView, unit: str) -> str:
    words = ("" if "." in view.task.output else "place along ") if view.task.slides else "angle of "
    return f"{words}{view.task.output} [{unit}]"
