"""Charts of the motion of a machine over its cycle, and the curves, axes and marks of all charts over the crank angle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from optlink.dynamics.machine import slider_names
from optlink.dynamics.strokes import last_output
from optlink.linkage.mechanism import FRAME
from optlink.linkage.stroke import Travel
from optlink.linkage.vector2d import TURN
from optlink.report.chart_spec import Axis, ChartSpec, Curve, Dash, Line, Mark, Panel, Span, crank_angle
from optlink.report.style import BODIES, CRANK, FOUND, LIMIT, QUIET, TARGET, Scale, degrees, scale
from optlink.report.views.analysis_curves import NOTHING, CycleCurves
from optlink.tasks.results.analysis import Extreme

MANY = 12  # largest number of dead centres to draw; a body at rest has spurious ones due to rounding
SHOWN = 4  # largest number of sliders in motion.png
ROOM = 0.16  # margin above and below cut values, as a share of the range


class Output(NamedTuple):
    """An output motion to draw: name, columns of position, velocity and acceleration, and its stroke or swing."""

    name: str
    columns: tuple[str, str, str]
    travel: Travel | None

    @property
    def slides(self) -> bool:
        """Whether the output is a slider [m] rather than a rotating body [rad]."""
        return self.columns[0].endswith(".s_m")

    def floors(self, course: CycleCurves) -> tuple[float, float, float]:
        """Return the ranges of position, velocity and acceleration [SI] below which variation is rounding error."""
        size = 1e-8 * (course.peak(self.columns[0]) if self.slides else 1.0)
        turning = abs(course.result.speed)
        return size, size * turning, size * turning * turning

    def scales(self, course: CycleCurves, others: Sequence[Output] = ()) -> tuple[Scale, Scale, Scale]:
        """Return the display units of position, velocity and acceleration, common to all outputs of the same kind.

        Parameters
        ----------
        course : CycleCurves
        others : sequence of Output, optional
            Other outputs in the same picture.
        """
        units = ("m", "m/s", "m/s²") if self.slides else ("deg", "rad/s", "rad/s²")
        alike = [out for out in (self, *others) if out.slides == self.slides]
        s, v, a = (
            scale(max(max(course.peak(out.columns[k]), out.floors(course)[k]) for out in alike), unit)
            for k, unit in enumerate(units)
        )
        return s, v, a


def _slider(course: CycleCurves, name: str) -> Output:
    return Output(name, (f"{name}.s_m", f"{name}.v_m_s", f"{name}.a_m_s2"), course.result.strokes.get(name))


def _body(course: CycleCurves, body: str) -> Output:
    columns = (f"{body}.angle_rad", f"{body}.omega_rad_s", f"{body}.alpha_rad_s2")
    return Output(body, columns, course.result.swings.get(body))


def output(course: CycleCurves) -> Output:
    """Return the main output of the machine: its last slider on the frame, otherwise its last oscillating body."""
    name, slides = last_output(course.result.machine, course.result.swings, course.result.strokes)
    return _slider(course, name) if slides else _body(course, name)


def outputs(course: CycleCurves) -> list[Output]:
    """Return the outputs shown in motion.png: the sliders, those on the frame last, or the main output."""
    names = slider_names(course.result.machine)
    ordered = sorted(course.result.machine.mechanism.guides, key=lambda guide: guide.on == FRAME)
    found = [_slider(course, names[guide.name]) for guide in ordered]
    return [slider for slider in found if course.has(slider.columns[1])][-SHOWN:] or [output(course)]


# --- curves ------------------------------------------------------------------------------------------------------------------


def curves(
    course: CycleCurves,
    column: str,
    shown: Scale,
    name: str,
    colour: str,
    width: float = 1.7,
    dash: Dash = "solid",
    *,
    given: CycleCurves | None = None,
) -> list[Curve]:
    """Return a column as a curve, with dotted lines at its jumps; that of the initial machine in grey comes first.

    Parameters
    ----------
    course : CycleCurves
    column : str
        Column name; also the `gid` of the curve.
    shown : Scale
        Display unit.
    name : str
        Entry in the legend; empty for none.
    colour : str
    width : float [pt], optional
    dash : str, optional
    given : CycleCurves or None, optional
        Initial machine.
    """
    found = []
    if given is not None and column in given.columns:
        words = f"{name}, initial machine" if name else "initial machine"
        found.append(Curve(*given.line(column, shown.factor), words, QUIET, 1.1, "dot"))
    found.append(Curve(*course.line(column, shown.factor), name, colour, width, dash, gid=column))
    for k in course.breaks(column):
        ends = course.columns[column][k : k + 2] * shown.factor
        found.append(Curve(np.full(2, course.degrees[k]), ends, "", colour, 0.9, "dot", hover=False, gid=f"jump {column}"))
    return found


def axis(course: CycleCurves, name: str, traces: Iterable[Curve], *, least: float = 0.0) -> Axis:
    """Return a y axis; values that grow without bound are cut off, and rounding errors are not enlarged.

    Parameters
    ----------
    course : CycleCurves
    name : str
    traces : iterable of Curve
    least : float, optional
        Smallest range, in the unit of the axis.
    """
    values = np.concatenate([trace.y for trace in traces])
    low, high = course.window(values)
    whole = bool(np.all((values >= low) & (values <= high) | np.isnan(values)))
    amount = max(abs(low), abs(high))
    width = high - low if high - low > NOTHING * amount else amount or 1.0
    if whole and high - low > max(NOTHING * amount, least):
        return Axis(name)
    if width < least:
        low, high, width = 0.5 * (low + high - least), 0.5 * (low + high + least), least
    return Axis(name if whole else f"{name}, cut off", (low - ROOM * width, high + ROOM * width))


def panel(
    course: CycleCurves,
    name: str,
    traces: list[Curve],
    height: float = 1.0,
    marks: Iterable[Mark] = (),
    lines: Sequence[Line] = (),
    *,
    least: float = 0.0,
) -> Panel:
    """Return a panel; marks beyond its limits are moved to them and point outwards.

    Parameters
    ----------
    course : CycleCurves
    name : str
        Label of the y axis.
    traces : list of Curve
    height : float, optional
        Relative height.
    marks : iterable of Mark, optional
    lines : sequence of Line, optional
    least : float, optional
        Least range of the y axis, in its unit.
    """
    y = axis(course, name, traces, least=least)
    moved = [_held(mark, *y.limits) if y.limits else mark for mark in marks]
    return Panel(y, traces, height, lines, moved)


def _held(mark: Mark, low: float, high: float) -> Mark:
    if low <= mark.y <= high:
        return mark
    up = mark.y > high
    prefer, angle = (0.0, -1.0 if up else 1.0), 0.0 if up else 180.0
    return Mark(mark.x, high if up else low, mark.text, mark.colour, "triangle", mark.size, prefer, angle=angle, gid=mark.gid)


def extremes(course: CycleCurves, name: str, shown: Scale, colour: str = TARGET, extreme: Extreme | None = None) -> list[Mark]:
    """Return marks at the least and largest value of a column at their exact crank angles.

    Parameters
    ----------
    course : CycleCurves
    name : str
        Column name.
    shown : Scale
        Display unit of the axis.
    colour : str, optional
    extreme : Extreme or None, optional
        Values to mark [SI]; default: the extremes of the column in the analysis.
    """
    extreme = course.result.extremes.get(name) if extreme is None else extreme
    if extreme is None or not math.isfinite(extreme.least) or extreme.largest - extreme.least <= NOTHING * course.peak(name):
        return []
    found = []
    for value, at, way in ((extreme.least, extreme.least_at, -1.0), (extreme.largest, extreme.largest_at, 1.0)):
        x, words = math.degrees(course.inside(at)), f"{shown.text(value)} at {degrees(at)}"
        found.append(Mark(x, value * shown.factor, words, colour, prefer=(0.0, way), gid=f"extreme {name}"))
    return found


def chart(
    course: CycleCurves, file: str, title: str, panels: Sequence[Panel], *, lines: Sequence[Line] = (), **more: Any
) -> ChartSpec:
    """Return a chart over the crank angle with its singular positions.

    Parameters
    ----------
    course : CycleCurves
    file : str
        Name of the picture.
    title : str
    panels : sequence of Panel
    lines : sequence of Line, optional
        Further vertical lines.
    **more
        Further attributes of `ChartSpec`; default of the heading: that of the machine with the title.
    """
    ends = sorted((math.degrees(course.start), math.degrees(course.end)))
    x = crank_angle(clockwise=course.way < 0.0, limits=(ends[0], ends[1]))
    places = [math.degrees(course.inside(position.crank_angle)) for position in course.result.ranges.singular]
    found = [Line(at, "" if k else "not determined beyond", LIMIT, 1.2, gid="singular position") for k, at in enumerate(places)]
    return ChartSpec(file, title, panels, x, **{"heading": titled(course, title), "lines": [*found, *lines], **more})


def titled(course: CycleCurves, words: str) -> str:
    """Return the title of the problem with the title of a chart.

    Parameters
    ----------
    course : CycleCurves
    words : str
        Title of the chart.
    """
    return f"{course.result.problem.model.title}: {words[:1].lower()}{words[1:]}"


# --- motion ------------------------------------------------------------------------------------------------------------------


def motion(course: CycleCurves, given: CycleCurves | None = None) -> list[ChartSpec]:
    """Return displacement, velocity and acceleration of every slider, or of the last oscillating body.

    Parameters
    ----------
    course : CycleCurves
    given : CycleCurves, optional
        Those of the initial machine, drawn in grey.
    """
    shown = outputs(course)
    found = []
    for out in shown:
        words = ("displacement s", "velocity", "acceleration") if out.slides else ("angle θ", "angular velocity", "acceleration")
        panels = []
        for k, (name, unit, word, floor) in enumerate(
            zip(out.columns, out.scales(course, shown), words, out.floors(course), strict=True)
        ):
            traces = curves(course, name, unit, "", (FOUND, BODIES[1], CRANK)[k], given=given)
            limits = _limits(course, out) if name.endswith(".angle_rad") else course.result.extremes.get(name)
            marks = extremes(course, name, unit, TARGET, limits) if limits and limits.largest - limits.least > 2.0 * floor else []
            word = f"angular {word}" if word == "acceleration" and not out.slides else word
            panels.append(panel(course, f"{word} [{unit.unit}]", traces, 1.0, marks, least=4.0 * floor * unit.factor))
        lines, spans = _strokes(course, out.travel)
        width, heading, caption = 7.6 if len(shown) == 1 else 5.6, titled(course, "motion"), _travelled(course, out)
        title = f"Motion of {out.name}"
        found.append(
            chart(course, "motion", title, panels, heading=heading, remark=caption, lines=lines, spans=spans, width=width)
        )
    return found


def _strokes(course: CycleCurves, travel: Travel | None) -> tuple[list[Line], list[Span]]:
    """Return dead centres as lines, and the quick stroke as shaded ranges, named with the crank rotation of both strokes."""
    centres = [math.degrees(at) for at in course.in_order(travel.dead_centres)] if travel else []
    drawn = centres if len(centres) <= MANY else []
    lines = [Line(at, "" if k else "dead centre", QUIET, 1.0, gid="dead centre") for k, at in enumerate(drawn)]
    if travel is None or not (course.result.full and len(centres) == 2 and travel.time_ratio > 1.0 + 1e-6):
        return lines, []
    one = abs(centres[1] - centres[0])
    between = [(centres[0], centres[1])]
    around = [(math.degrees(course.start), centres[0]), (centres[1], math.degrees(course.end))]
    quick = between if one < 180.0 else around
    words = f"quick {min(one, 360.0 - one):z.2f}°, slow {max(one, 360.0 - one):z.2f}°"
    return lines, [Span(min(ends), max(ends), "" if k else words, gid="shade") for k, ends in enumerate(quick)]


def _limits(course: CycleCurves, out: Output) -> Extreme | None:
    travel = out.travel
    if travel is None:
        return None
    turn = TURN * round(
        (course.at(course.inside(travel.low_at), out.columns[0]) - travel.low) / TURN
    )  # the curve may be shifted by a turn
    return Extreme(travel.low + turn, travel.low_at, travel.high + turn, travel.high_at)


def _travelled(course: CycleCurves, out: Output) -> str:
    """Describe stroke or swing, time ratio and dead centres of an output."""
    if out.travel is None:
        angles = course[out.columns[0]]
        turns = not out.slides and abs(abs(angles[-1] - angles[0]) - TURN) < 1e-6
        return f"{out.name}: turns fully" if turns else out.name
    span = scale(out.travel.span, "m" if out.slides else "deg").text(out.travel.span)
    parts = [f"{out.name}: {'stroke' if out.slides else 'swing'} {span}"]
    if math.isfinite(out.travel.time_ratio):
        parts.append(f"time ratio {out.travel.time_ratio:z.4f}")
    if out.travel.dead_centres:
        some = [degrees(at) for at in course.in_order(out.travel.dead_centres)]
        parts.append(f"dead centre{'s' if len(some) > 1 else ''} at {', '.join([*some[:8], '...'] if len(some) > 8 else some)}")
    return ", ".join(parts)


def transmission(course: CycleCurves) -> list[ChartSpec]:
    """Return the transmission angles of all two-link groups over the motion, for the page."""
    names = [name for name in course.columns if name.endswith(".transmission_rad")]
    unit = scale(0.0, "deg")
    traces = [
        curve
        for k, name in enumerate(names)
        for curve in curves(course, name, unit, f"at {name.partition('.')[0]}", BODIES[k % len(BODIES)])
    ]
    return (
        [chart(course, "", "Transmission angle", [Panel(Axis("angle between the links [deg]"), traces, 1.4)])] if traces else []
    )
