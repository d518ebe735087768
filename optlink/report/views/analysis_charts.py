"""Charts of the motion of a machine over its cycle, and the curves, axes and marks of all charts over the crank angle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from optlink.dynamics.machine import slider_names
from optlink.dynamics.strokes import last_output
from optlink.linkage.mechanism import FRAME
from optlink.linkage.stroke import Travel
from optlink.linkage.vector2d import TURN, Array
from optlink.report.chart_spec import (
    BODIES,
    CRANK,
    LIMIT,
    MUTED,
    RESULT,
    TARGET,
    Axis,
    ChartSpec,
    Curve,
    Dash,
    Line,
    Mark,
    Panel,
    Span,
    crank_angle,
    max_abs,
)
from optlink.report.format import Scale, degrees, scale
from optlink.report.views.analysis_curves import ROUNDING, CycleCurves
from optlink.tasks.results.extremes import Extreme

MAX_DEAD_CENTRES = 12  # largest number of dead centres to draw; a body at rest has spurious ones due to rounding
MAX_SLIDERS = 4  # largest number of sliders in motion.png
MAX_BODIES = 9  # largest number of curves in bodies.png
DASHES: tuple[Dash, ...] = ("solid", "dash", "dashdot")
LIMIT_MARGIN = 0.16  # margin above and below cut values, as a share of the range


class OutputMotion(NamedTuple):
    """An output motion to draw: name, columns of position, velocity and acceleration, and its stroke or swing."""

    name: str
    columns: tuple[str, str, str]
    travel: Travel | None

    @property
    def slides(self) -> bool:
        """Whether the output is a slider [m] rather than a rotating body [rad]."""
        return self.columns[0].endswith(".s_m")

    def floors(self, cycle: CycleCurves) -> tuple[float, float, float]:
        """Return the ranges of position, velocity and acceleration [SI] below which variation is rounding error."""
        size = 1e-8 * (cycle.peak(self.columns[0]) if self.slides else 1.0)
        turning = abs(cycle.result.speed)
        return size, size * turning, size * turning * turning

    def scales(self, cycle: CycleCurves, others: Sequence[OutputMotion] = ()) -> tuple[Scale, Scale, Scale]:
        """Return the display units of position, velocity and acceleration, common to all outputs of one kind in a picture."""
        units = ("m", "m/s", "m/s²") if self.slides else ("deg", "rad/s", "rad/s²")
        similar = [out for out in (self, *others) if out.slides == self.slides]
        s, v, a = (
            scale(max(max(cycle.peak(out.columns[k]), out.floors(cycle)[k]) for out in similar), unit)
            for k, unit in enumerate(units)
        )
        return s, v, a


def _slider(cycle: CycleCurves, name: str) -> OutputMotion:
    return OutputMotion(name, (f"{name}.s_m", f"{name}.v_m_s", f"{name}.a_m_s2"), cycle.result.strokes.get(name))


def output(cycle: CycleCurves) -> OutputMotion:
    """Return the main output of the machine: its last slider on the frame, otherwise its last oscillating body."""
    name, slides = last_output(cycle.result.machine, cycle.result.swings, cycle.result.strokes)
    if slides:
        return _slider(cycle, name)
    columns = (f"{name}.angle_rad", f"{name}.omega_rad_s", f"{name}.alpha_rad_s2")
    return OutputMotion(name, columns, cycle.result.swings.get(name))


def outputs(cycle: CycleCurves) -> list[OutputMotion]:
    """Return the outputs shown in motion.png: the sliders, those on the frame last, or the main output."""
    names = slider_names(cycle.result.machine)
    ordered = sorted(cycle.result.machine.mechanism.guides, key=lambda guide: guide.on == FRAME)
    sliders = [_slider(cycle, names[guide.name]) for guide in ordered]
    return [slider for slider in sliders if cycle.has(slider.columns[1])][-MAX_SLIDERS:] or [output(cycle)]


# --- curves ------------------------------------------------------------------------------------------------------------------


def curves(
    cycle: CycleCurves,
    column: str,
    shown: Scale,
    name: str,
    colour: str,
    width: float = 1.7,
    dash: Dash = "solid",
    *,
    initial: CycleCurves | None = None,
) -> list[Curve]:
    """Return a column as a curve, with dotted lines at its jumps; that of the initial machine in grey comes first."""
    traces = []
    if initial is not None and column in initial.columns:
        words = f"{name}, initial machine" if name else "initial machine"
        traces.append(Curve(*initial.line(column, shown.factor), words, MUTED, 1.1, "dot"))
    traces.append(Curve(*cycle.line(column, shown.factor), name, colour, width, dash, gid=column))
    for k in cycle.breaks(column):
        ends = cycle.columns[column][k : k + 2] * shown.factor
        traces.append(Curve(np.full(2, cycle.degrees[k]), ends, "", colour, 0.9, "dot", hover=False, gid=f"jump {column}"))
    return traces


def axis(cycle: CycleCurves, name: str, traces: Iterable[Curve], *, least: float = 0.0) -> Axis:
    """Return a y axis with a least range; values that grow without bound are cut off, and rounding errors are not enlarged."""
    values = np.concatenate([trace.y for trace in traces])
    low, high = cycle.window(values)
    complete = bool(np.all((values >= low) & (values <= high) | np.isnan(values)))
    amount = max(abs(low), abs(high))
    width = high - low if high - low > ROUNDING * amount else amount or 1.0
    if complete and high - low > max(ROUNDING * amount, least):
        return Axis(name)
    if width < least:
        low, high, width = 0.5 * (low + high - least), 0.5 * (low + high + least), least
    return Axis(name if complete else f"{name}, cut off", (low - LIMIT_MARGIN * width, high + LIMIT_MARGIN * width))


def panel(
    cycle: CycleCurves,
    name: str,
    traces: list[Curve],
    height: float = 1.0,
    marks: Iterable[Mark] = (),
    lines: Sequence[Line] = (),
    *,
    least: float = 0.0,
) -> Panel:
    """Return a panel; marks beyond its limits are moved to them and point outwards."""
    y = axis(cycle, name, traces, least=least)
    moved = [_held(mark, *y.limits) if y.limits else mark for mark in marks]
    return Panel(y, traces, height, lines, moved)


def _held(mark: Mark, low: float, high: float) -> Mark:
    if low <= mark.y <= high:
        return mark
    up = mark.y > high
    prefer, angle = (0.0, -1.0 if up else 1.0), 0.0 if up else 180.0
    return Mark(mark.x, high if up else low, mark.text, mark.colour, "triangle", mark.size, prefer, angle=angle, gid=mark.gid)


def extremes(cycle: CycleCurves, name: str, shown: Scale, colour: str = TARGET, extreme: Extreme | None = None) -> list[Mark]:
    """Return marks at the least and largest value of a column, or at a given extreme [SI], at their exact crank angles."""
    extreme = cycle.result.extremes.get(name) if extreme is None else extreme
    if extreme is None or not math.isfinite(extreme.least) or extreme.largest - extreme.least <= ROUNDING * cycle.peak(name):
        return []
    marks = []
    for value, at, direction in ((extreme.least, extreme.least_at, -1.0), (extreme.largest, extreme.largest_at, 1.0)):
        x, words = math.degrees(cycle.inside(at)), f"{shown.text(value)} at {degrees(at)}"
        marks.append(Mark(x, value * shown.factor, words, colour, prefer=(0.0, direction), gid=f"extreme {name}"))
    return marks


def chart(
    cycle: CycleCurves, file: str, title: str, panels: Sequence[Panel], *, lines: Sequence[Line] = (), **options: Any
) -> ChartSpec:
    """Return a chart over the crank angle with its singular positions; `options` are further attributes of `ChartSpec`."""
    ends = sorted((math.degrees(cycle.start), math.degrees(cycle.end)))
    x = crank_angle(clockwise=cycle.direction < 0.0, limits=(ends[0], ends[1]))
    places = [math.degrees(cycle.inside(position.crank_angle)) for position in cycle.result.ranges.singular]
    singular = [
        Line(at, "" if k else "not determined beyond", LIMIT, 1.2, gid="singular position") for k, at in enumerate(places)
    ]
    return ChartSpec(file, title, panels, x, **{"heading": machine_title(cycle, title), "lines": [*singular, *lines], **options})


def machine_title(cycle: CycleCurves, words: str) -> str:
    """Return the title of the problem with the title of a chart."""
    return f"{cycle.result.problem.model.title}: {words[:1].lower()}{words[1:]}"


# --- motion ------------------------------------------------------------------------------------------------------------------


def motion(cycle: CycleCurves, initial: CycleCurves | None = None) -> list[ChartSpec]:
    """Return displacement, velocity and acceleration of every slider, or of the last oscillating body."""
    shown = outputs(cycle)
    charts = []
    for out in shown:
        words = ("displacement s", "velocity", "acceleration") if out.slides else ("angle θ", "angular velocity", "acceleration")
        panels = []
        for k, (name, unit, word, floor) in enumerate(
            zip(out.columns, out.scales(cycle, shown), words, out.floors(cycle), strict=True)
        ):
            traces = curves(cycle, name, unit, "", (RESULT, BODIES[1], CRANK)[k], initial=initial)
            limits = _limits(cycle, out) if name.endswith(".angle_rad") else cycle.result.extremes.get(name)
            marks = extremes(cycle, name, unit, TARGET, limits) if limits and limits.largest - limits.least > 2.0 * floor else []
            word = f"angular {word}" if word == "acceleration" and not out.slides else word
            panels.append(panel(cycle, f"{word} [{unit.unit}]", traces, 1.0, marks, least=4.0 * floor * unit.factor))
        lines, spans = _strokes(cycle, out.travel)
        width, heading, caption = 7.6 if len(shown) == 1 else 5.6, machine_title(cycle, "motion"), _stroke_text(cycle, out)
        title = f"Motion of {out.name}"
        charts.append(
            chart(cycle, "motion", title, panels, heading=heading, remark=caption, lines=lines, spans=spans, width=width)
        )
    return charts


def bodies(cycle: CycleCurves) -> list[ChartSpec]:
    """Return angular velocity and acceleration of the bodies that turn at a variable speed, with their extremes."""
    mechanism, turning = cycle.result.machine.mechanism, abs(cycle.result.speed)
    others = [body for body in mechanism.bodies if body != mechanism.crank.body]
    colours = {f"{body}.omega_rad_s": BODIES[k % len(BODIES)] for k, body in enumerate(others)}  # those of mechanism.png
    names = {body: f"{body}.omega_rad_s" for body in others}
    windows = {body: cycle.window(cycle[name]) for body, name in names.items()}
    variable = {body: names[body] for body, (low, high) in windows.items() if high - low > 1e-8 * turning}
    shown = dict(list(together(cycle.columns, variable).items())[:MAX_BODIES])
    if not shown:
        return []
    panels = []
    for word, ending, si in (("velocity", ".omega_rad_s", "rad/s"), ("acceleration", ".alpha_rad_s2", "rad/s²")):
        columns = {label: name.replace(".omega_rad_s", ending) for label, name in shown.items()}
        unit, traces = scale(cycle.peak(*columns.values()), si), []
        for k, (label, name) in enumerate(columns.items()):
            extreme = cycle.result.extremes.get(name)
            least = unit.text(extreme.least).removesuffix(f" {unit.unit}") if extreme else ""
            words = f"{label}:  {least} to {unit.text(extreme.largest)}" if extreme else label
            colour, (width, dash) = colours[shown[label]], look(k, len(columns))
            traces += curves(cycle, name, unit, words, colour, width, dash)
        panels.append(panel(cycle, f"angular {word} [{unit.unit}]", traces, 1.4))
    return [chart(cycle, "bodies", "Rotation of the bodies", panels, width=8.6)]


def look(k: int, count: int) -> tuple[float, Dash]:
    """Return width [pt] and dash of curve `k` of `count`: overlapping curves stay visible, and distinct without colours."""
    return 2.5 - 1.3 * k / max(1, count - 1), DASHES[(k + k // (len(BODIES) + 1)) % len(DASHES)]


def together(columns: Mapping[str, Array], names: Mapping[str, str]) -> dict[str, str]:
    """Merge columns with identical values under one combined label; `names` are columns by label."""
    merged: dict[str, str] = {}
    for label, name in names.items():
        values = columns[name]
        least = ROUNDING * max_abs(values)
        same = next((k for k, v in merged.items() if np.allclose(columns[v], values, ROUNDING, least, equal_nan=True)), None)
        if same is None:
            merged[label] = name
        else:
            merged = {f"{k}, {label}" if k == same else k: v for k, v in merged.items()}
    return merged


def _strokes(cycle: CycleCurves, travel: Travel | None) -> tuple[list[Line], list[Span]]:
    """Return dead centres as lines, and the quick stroke as shaded ranges, named with the crank rotation of both strokes."""
    centres = [math.degrees(at) for at in cycle.in_order(travel.dead_centres)] if travel else []
    visible = centres if len(centres) <= MAX_DEAD_CENTRES else []
    lines = [Line(at, "" if k else "dead centre", MUTED, 1.0, gid="dead centre") for k, at in enumerate(visible)]
    if travel is None or not (cycle.result.full and len(centres) == 2 and travel.time_ratio > 1.0 + 1e-6):
        return lines, []
    rotation = abs(centres[1] - centres[0])
    between = [(centres[0], centres[1])]
    around = [(math.degrees(cycle.start), centres[0]), (centres[1], math.degrees(cycle.end))]
    quick = between if rotation < 180.0 else around
    words = f"quick {min(rotation, 360.0 - rotation):z.2f}°, slow {max(rotation, 360.0 - rotation):z.2f}°"
    return lines, [Span(min(ends), max(ends), "" if k else words, gid="shade") for k, ends in enumerate(quick)]


def _limits(cycle: CycleCurves, out: OutputMotion) -> Extreme | None:
    travel = out.travel
    if travel is None:
        return None
    turn = TURN * round(
        (cycle.at(cycle.inside(travel.low_at), out.columns[0]) - travel.low) / TURN
    )  # the curve may be shifted by a turn
    return Extreme(travel.low + turn, travel.low_at, travel.high + turn, travel.high_at)


def _stroke_text(cycle: CycleCurves, out: OutputMotion) -> str:
    """Describe stroke or swing, time ratio and dead centres of an output."""
    if out.travel is None:
        angles = cycle[out.columns[0]]
        turns_fully = not out.slides and abs(abs(angles[-1] - angles[0]) - TURN) < 1e-6
        return f"{out.name}: turns fully" if turns_fully else out.name
    span = scale(out.travel.span, "m" if out.slides else "deg").text(out.travel.span)
    parts = [f"{out.name}: {'stroke' if out.slides else 'swing'} {span}"]
    if math.isfinite(out.travel.time_ratio):
        parts.append(f"time ratio {out.travel.time_ratio:z.4f}")
    if out.travel.dead_centres:
        centres = [degrees(at) for at in cycle.in_order(out.travel.dead_centres)]
        parts.append(
            f"dead centre{'s' if len(centres) > 1 else ''} at {', '.join([*centres[:8], '...'] if len(centres) > 8 else centres)}"
        )
    return ", ".join(parts)


def transmission(cycle: CycleCurves) -> list[ChartSpec]:
    """Return the transmission angles of all two-link groups over the motion, for the page."""
    names = [name for name in cycle.columns if name.endswith(".transmission_rad")]
    unit = scale(0.0, "deg")
    traces = [
        curve
        for k, name in enumerate(names)
        for curve in curves(cycle, name, unit, f"at {name.partition('.')[0]}", BODIES[k % len(BODIES)])
    ]
    return [chart(cycle, "", "Transmission angle", [Panel(Axis("angle between the links [deg]"), traces, 1.4)])] if traces else []
