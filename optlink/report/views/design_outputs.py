"""Charts of a design over the crank angle: output of a law with its error, function y(x), transmission angles; their film."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from PIL import Image

from optlink.linkage.dyad_types import transmitting
from optlink.optimization.output_derivatives import ErrorResiduals
from optlink.problem.targets.function import Function
from optlink.report.animation import film
from optlink.report.chart_spec import (
    BODIES,
    LIMIT,
    MUTED,
    RESULT,
    TARGET,
    Array,
    Axis,
    Band,
    ChartSpec,
    Curve,
    Line,
    Mark,
    Panel,
    Span,
    Trace,
    crank_angle,
)
from optlink.report.format import scale
from optlink.report.views.design_view import DesignView, title_of, wrapped
from optlink.report.views.design_words import captions

POSITIONS = 721  # over the range of a law
MAX_MARKED = 100  # largest number of positions of a law that are marked


def law(view: DesignView) -> list[ChartSpec]:
    """Return the prescribed and the generated output of a law with their difference, and y(x) of a function."""
    task, design = view.task, view.design
    offsets, at = task.span * np.linspace(0.0, 1.0, POSITIONS), task.law.offsets
    target, prescribed = (task.law.curve(places, view.begin, design.own.get(task.base_name, 0.0)) for places in (offsets, at))
    unit = view.sketch.scale if task.slides else scale(0.0, "deg")
    error, at_marks = (-unit.factor * design.errors(places) for places in (offsets, at))
    if not np.any(np.isfinite(error)):
        return []
    crank, marked = (view.crank(view.begin + places) for places in (offsets, at))
    above: list[Trace] = [
        Curve(crank, target * unit.factor, "target", TARGET, 1.4, "dash", gid="target"),
        Curve(crank, target * unit.factor + error, "generated", RESULT, 1.9, gid="generated"),
    ]
    below: list[Trace] = []
    worst = int(np.nanargmax(np.abs(error)))
    top, words = float(error[worst]), f"largest {error[worst]:+.4g}{'°' if unit.unit == 'deg' else ' ' + unit.unit}"
    if task.robust is not None:  # there the error is prescribed minus generated
        high, low = (-unit.factor * end for end in ErrorResiduals(task).band(design.own, offsets))
        below.append(Band(crank, low, high, f"built, {task.robust.band}", LIMIT))
        top, words = float((high if error[worst] > 0.0 else low)[worst]), f"{words} nominal"
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
    chart = ChartSpec("law", "Output over the range", panels, _crank(view, crank), title, warning=warning)
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
        low, high = max(begin + turn, float(crank[0])), min(end + turn, float(crank[-1]))
        if low < high - 1e-9:
            spans.append(Span(low, high, "" if spans else "range of the requirement", RESULT, 0.08))
    traces, lines, marks = [], [], []
    for k, group in enumerate(groups):
        colour, ends = RESULT if len(groups) == 1 else BODIES[k % len(BODIES)], np.degrees(extreme[k])
        name = f"at {group.joint}: {ends[0]:z.2f}° to {ends[1]:z.2f}°"
        traces.append(Curve(crank, gamma[:, k], name, colour, 1.9, gid=f"transmission {group.joint}"))
        for word, at, value, way in zip(("least", "largest"), view.crank(places[k]), ends, (-1.0, 1.0), strict=True):
            marks.append(Mark(at, value, f"{word} {value:z.2f}°", colour, prefer=(0.0, way)))
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
    return [ChartSpec("transmission", "Transmission angle", [panel], x, title, spans=spans, warning=not view.design.valid)]


def _crank(view: DesignView, crank: Array) -> Axis:
    return crank_angle(clockwise=view.direction < 0.0, limits=(float(np.min(crank)), float(np.max(crank))))


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
