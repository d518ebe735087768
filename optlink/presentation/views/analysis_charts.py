"""Charts of the motion of a machine over its cycle, and the curves, axes and marks of all charts over the crank angle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from optlink.dynamics.columns import Effort, MotionColumns, efforts, pin_columns
from optlink.dynamics.inverse import shaking as shaken
from optlink.dynamics.machine import slider_names
from optlink.dynamics.strokes import last_output
from optlink.dynamics.work import Work
from optlink.linkage import extrema
from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import continuous
from optlink.linkage.stroke import Travel
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.chart_spec import (
    BODIES,
    COUPLER,
    CRANK,
    LIMIT,
    MUTED,
    RESULT,
    ROCKER,
    TARGET,
    Axis,
    ChartSpec,
    Curve,
    Dash,
    Line,
    Mark,
    Panel,
    Span,
    drive_axis,
    max_abs,
)
from optlink.presentation.format import Scale, position, round_below, scale
from optlink.presentation.scene import colours_of
from optlink.presentation.shapes import finite_range, normed, pieces
from optlink.problem.terms import BACK
from optlink.tasks.analyze import Analysis
from optlink.tasks.results.extremes import Extreme

# Time history of a machine over the crank angle, with exact extremes and gaps at load jumps.

POINTS = 720
MAX_TABLE_ROWS = 2000  # largest number of analysis rows that are added to the points of the curves
ROUNDING = 1e-9  # share of the largest value below which a value is rounding error


class CycleCurves:
    """Time history of a machine over the crank angle, in the order of the motion.

    It contains every row of the analysis table (if there are not too many), points between them, the crank angles of all
    extremes, and two points at each jump of a load: the values just before and just after it.
    """

    def __init__(self, result: Analysis) -> None:
        self.result = result
        self.direction = 1.0 if result.speed > 0.0 else -1.0
        table = result.positions
        self.start = float(table[0])
        self.end = self.start + self.direction * result.cycle if result.full else table[-1]
        low, high = sorted((self.start, self.end))
        marks = [self.inside(at) for extreme in result.extremes.values() for at in (extreme.least_at, extreme.largest_at)]
        grid = np.concatenate([np.linspace(low, high, POINTS + 1), table if len(table) <= MAX_TABLE_ROWS else [], marks])
        grid = np.unique(grid[(grid >= low) & (grid <= high)])
        jumps = np.asarray(result.jumps, dtype=float)
        if jumps.size:
            grid = grid[np.min(np.abs(grid[:, None] - jumps), axis=1) > 1e-9]
        everywhere = np.concatenate([grid, jumps, jumps])
        order = np.argsort(self.direction * everywhere, kind="stable")
        self.angles: Array = everywhere[order]
        self.driving = result.problem.model.driving
        self.places: Array = self.driving.shown(self.angles)
        machine, speed = result.machine, result.speed
        records = [MotionColumns(machine.moving(grid, speed))]
        if jumps.size:
            records += [MotionColumns(machine.moving(jumps, speed, side=side)) for side in (-1, 1)]
        self.columns = {name: np.concatenate([record[name] for record in records])[order] for name in records[0].columns}
        for name in self.columns:
            if name.endswith(".angle_rad"):
                self.columns[name] = continuous(self.columns[name])
        self.columns["input.work_J"] = Work(machine, self.start, low, high, speed)(self.angles)
        for name, _, _ in pin_columns(machine):
            self.columns[name] = np.hypot(*(self.columns[name.replace(".f_N", f".f{axis}_N")] for axis in "xy"))
        self._pairs = np.flatnonzero(np.diff(self.angles) == 0.0)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def steady(self) -> bool:
        """Whether the motion that is asked for is possible and no quantity grows without bound."""
        return self.result.valid and self.result.ranges.complete

    @property
    def efforts(self) -> list[Effort]:
        """What the drives exert."""
        return efforts(self.result.machine.mechanism)

    def peak(self, *names: str) -> float:
        """Return the largest absolute value of the columns [SI], restricted to the range of values that is drawn."""
        windows = [self.window(self.columns[name]) for name in names if name in self.columns]
        return max((max(abs(low), abs(high)) for low, high in windows), default=0.0)

    def window(self, values: Array) -> tuple[float, float]:
        """Return the least and largest value to draw.

        At singular positions or ends of the crank range, where values grow without bound, outliers are cut off.
        """
        low, high = finite_range(values)
        if low < high and not self.steady:
            first, last = (float(end) for end in np.percentile(values[np.isfinite(values)], [8.0, 92.0]))
            if 0.0 < last - first < (high - low) / 8.0:
                low, high = max(low, 2.0 * first - last), min(high, 2.0 * last - first)
        return low, high

    def has(self, name: str, among: Sequence[str] = ()) -> bool:
        """Return whether a column exists and exceeds the rounding error of the others, whose level those in `among` set."""
        return self.peak(name) > ROUNDING * self.peak(name, *among) and self.peak(name) > 0.0

    def breaks(self, *names: str) -> list[int]:
        """Return the indices after which one of the columns jumps."""
        jumps = []
        for k in self._pairs:
            for name in names:
                values = self.columns[name]
                if abs(values[k + 1] - values[k]) > 1e-6 * self.peak(name):
                    jumps.append(int(k))
                    break
        return jumps

    def line(self, name: str, factor: float = 1.0) -> tuple[Array, Array]:
        """Return positions of the drive in its unit and scaled values, with NaN inserted at jumps."""
        at = [k + 1 for k in self.breaks(name)]
        return np.insert(self.places, at, np.nan), np.insert(self.columns[name] * factor, at, np.nan)

    def inside(self, crank_angle: float) -> float:
        """Return the crank angle [rad] shifted by whole periods into the range of the motion."""
        low, high = sorted((self.start, self.end))
        within = low <= crank_angle <= high or not self.result.full
        return crank_angle if within else low + (crank_angle - low) % self.result.cycle

    def place(self, crank_angle: float) -> float:
        """Return where a position [rad] lies on the axis of a chart, in the unit of the drive."""
        return self.driving.shown(self.inside(crank_angle))

    @property
    def ends(self) -> tuple[float, float]:
        """Least and largest position of the drive in its unit."""
        low, high = sorted((self.driving.shown(self.start), self.driving.shown(self.end)))
        return low, high

    @property
    def pivot(self) -> str:
        """What the first joint of the driven body is called."""
        return "Crank pivot" if self.driving.ends is None else "Pivot"

    def in_order(self, crank_angles: Sequence[float]) -> list[float]:
        """Return crank angles [rad] shifted into the range of the motion, in the order of the motion."""
        return sorted((self.inside(at) for at in crank_angles), key=lambda at: self.direction * at)

    def at(self, crank_angle: float, name: str) -> float:
        """Interpolate a column at a crank angle [rad] within the range of the motion."""
        rising = slice(None) if self.direction > 0.0 else slice(None, None, -1)
        return float(np.interp(crank_angle, self.angles[rising], self.columns[name][rising]))


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
        traces.append(Curve(*initial.line(column, shown.factor), words, MUTED, 1.1, "dot", initial=True))
    traces.append(Curve(*cycle.line(column, shown.factor), name, colour, width, dash, gid=column))
    for k in cycle.breaks(column):
        ends = cycle.columns[column][k : k + 2] * shown.factor
        traces.append(Curve(np.full(2, cycle.places[k]), ends, "", colour, 0.9, "dot", hover=False, gid=f"jump {column}"))
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
    marks, ways = [], cycle.result.extremes.on_way_back(name) if name in cycle.result.extremes else (False, False)
    ends = (extreme.least, extreme.least_at, -1.0), (extreme.largest, extreme.largest_at, 1.0)
    for (value, at, direction), back in zip(ends, ways, strict=True):
        x, words = cycle.place(at), f"{shown.text(value)} at {position(cycle.driving, at)}{BACK * back}"
        marks.append(Mark(x, value * shown.factor, words, colour, prefer=(0.0, direction), gid=f"extreme {name}"))
    return marks


def chart(
    cycle: CycleCurves, file: str, title: str, panels: Sequence[Panel], *, lines: Sequence[Line] = (), **options: Any
) -> ChartSpec:
    """Return a chart over the positions of the drive with the singular ones; `options` are further attributes of `ChartSpec`."""
    backwards = cycle.driving.shown(cycle.start) > cycle.driving.shown(cycle.end)
    x = drive_axis(cycle.driving, clockwise=backwards, limits=cycle.ends)
    places = [cycle.place(position.crank_angle) for position in cycle.result.ranges.singular]
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
    shown, main = outputs(cycle), output(cycle).name
    charts = []
    for out in shown:
        words = ("displacement s", "velocity", "acceleration") if out.slides else ("angle θ", "angular velocity", "acceleration")
        panels = []
        colours = (RESULT, BODIES[1], CRANK)[: 1 if cycle.result.static else 3]
        rows = zip(colours, out.columns, out.scales(cycle, shown), words, out.floors(cycle), strict=False)
        for colour, name, unit, word, floor in rows:
            traces = curves(cycle, name, unit, "", colour, initial=initial)
            limits = _limits(cycle, out) if name.endswith(".angle_rad") else cycle.result.extremes.get(name)
            marks = extremes(cycle, name, unit, TARGET, limits) if limits and limits.largest - limits.least > 2.0 * floor else []
            word = f"angular {word}" if word == "acceleration" and not out.slides else word
            panels.append(panel(cycle, f"{word} [{unit.unit}]", traces, 1.0, marks, least=4.0 * floor * unit.factor))
        lines, spans = _strokes(cycle, out.travel)
        charts.append(
            chart(
                cycle,
                "motion",
                f"Motion of {out.name}",
                panels,
                lines=lines,
                heading=machine_title(cycle, "motion"),
                remark=_stroke_text(cycle, out),
                spans=spans,
                width=7.6 if len(shown) == 1 else 5.6,
                brief=out.name == main,
            )
        )
    return charts


def bodies(cycle: CycleCurves) -> list[ChartSpec]:
    """Return angular velocity and acceleration of the bodies that turn at a variable speed, with their extremes."""
    mechanism, turning = cycle.result.machine.mechanism, abs(cycle.result.speed)
    bodies = colours_of(mechanism)
    colours = {f"{body}.omega_rad_s": colour for body, colour in bodies.items()}
    names = {body: f"{body}.omega_rad_s" for body in bodies if body != mechanism.crank.body}
    windows = {body: cycle.window(cycle[name]) for body, name in names.items()}
    variable = {body: names[body] for body, (low, high) in windows.items() if high - low > 1e-8 * turning}
    shown = dict(list(together(cycle.columns, variable).items())[:MAX_BODIES])
    if not shown or cycle.result.static:
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
    centres = [cycle.driving.shown(at) for at in cycle.in_order(travel.dead_centres)] if travel else []
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
        centres = [position(cycle.driving, at) for at in cycle.in_order(out.travel.dead_centres)]
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
    panel, forced = Panel(Axis("angle between the links [deg]"), traces, 1.4), any(cycle.has(one.column) for one in cycle.efforts)
    return [chart(cycle, "", "Transmission angle", [panel], brief=not forced)] if traces else []


# Charts of the driving torque, joint reactions, guide forces, work and shaking force of a machine over its cycle.

SHAKING = ("frame.shaking_fx_N", "frame.shaking_fy_N", "frame.shaking_moment_Nm")


def forces(cycle: CycleCurves, initial: CycleCurves | None = None) -> list[ChartSpec]:
    """Return the charts of torque, joint reactions, guide forces, work and shaking that the machine has."""
    return [*torque(cycle, initial), *reactions(cycle), *guides(cycle), *work(cycle, initial), *shaking(cycle, initial)]


def torque(cycle: CycleCurves, initial: CycleCurves | None = None) -> list[ChartSpec]:
    """Return what the drives exert: a torque with its inertia, gravity and load parts, and its mean; with extremes marked."""
    shown = [effort for effort in cycle.efforts if cycle.has(effort.column)]
    if not shown:
        return []
    result, panels = cycle.result, []
    for effort in shown:
        column, unit, lines = effort.column, scale(cycle.peak(effort.column), effort.unit), []
        parts = [name for name in ("inertia", "gravity", "load") if cycle.has(f"input.torque_{name}_Nm", [column])]
        words = {"load": "loads and friction" if result.machine.friction else "loads"}
        traces = curves(cycle, column, unit, effort.words, CRANK, 2.6, initial=initial)
        for part, colour, dash in zip(parts if len(parts) > 1 else [], (COUPLER, ROCKER, BODIES[2]), DASHES, strict=False):
            traces += curves(cycle, f"input.torque_{part}_Nm", unit, f"for {words.get(part, part)}", colour, 1.2, dash)
        mean = math.nan if result.machine.mechanism.drives else result.work / (cycle.end - cycle.start)
        if math.isfinite(mean):
            mean = mean if abs(mean) > ROUNDING * cycle.peak(column) else 0.0
            lines.append(Line(mean * unit.factor, f"mean {unit.text(mean) if mean else 0}", TARGET, gid="mean"))
        name = f"{effort.quantity} on {effort.body} [{unit.unit}]"
        panels.append(panel(cycle, name, traces, 1.6, extremes(cycle, column, unit), lines))
    speed = f"{abs(result.speed):.5g} rad/s ({abs(result.speed) * 30.0 / math.pi:.5g} rpm)"
    speed += "" if result.speed > 0.0 else ", clockwise"
    title = f"Driving {' and '.join(dict.fromkeys(effort.quantity for effort in shown))}"
    return [chart(cycle, "torque", title, panels, remark="" if result.machine.mechanism.drives else speed, brief=True)]


def joints(cycle: CycleCurves) -> dict[str, str]:
    """Return the column of the force magnitude of every joint reaction, by label."""
    names = [name for name, _, _ in pin_columns(cycle.result.machine)]
    return {name.removesuffix(".f_N").replace(".", " on "): name for name in names}


def reactions(cycle: CycleCurves) -> list[ChartSpec]:
    """Return the crank-pivot reaction over the crank angle and as a hodograph, and the magnitudes of all joint reactions."""
    amounts = joints(cycle)
    if not any(cycle.has(name) for name in amounts.values()):
        return []
    crank = cycle.result.machine.mechanism.crank
    pivot = next(name for name in (f"{crank.start}.f_N", f"{crank.start}.{crank.body}.f_N") if name in cycle.columns)
    x, y = pivot.replace(".f_N", ".fx_N"), pivot.replace(".f_N", ".fy_N")
    unit = scale(cycle.peak(pivot), "N")
    pair = [*curves(cycle, x, unit, "in x", RESULT), *curves(cycle, y, unit, "in y", CRANK, dash="dash")]
    marks = extremes(cycle, x, unit, RESULT) + extremes(cycle, y, unit, CRANK)
    caption = cycle.result.meanings.get(x, "").removesuffix(" in x")
    heading = machine_title(cycle, "joint reactions")
    force = [panel(cycle, f"force [{unit.unit}]", pair, 1.6, marks)]
    pivot_chart = chart(cycle, "reactions", f"{cycle.pivot} {crank.start}: {caption}", force, heading=heading, width=6.2)
    pivot_hodograph = hodograph(cycle, x, y, unit, "reactions", f"Hodograph of this force, {cycle.driving.noun} marked")
    unit = scale(cycle.peak(*amounts.values()), "N")
    shown = together(cycle.columns, {label: name for label, name in amounts.items() if cycle.has(name, list(amounts.values()))})
    traces = []
    for k, (label, name) in enumerate(shown.items()):
        colour = (CRANK, *BODIES)[k % (len(BODIES) + 1)]
        extreme = cycle.result.extremes.get(name)
        amount = f"{unit.text(extreme.largest)} at {position(cycle.driving, extreme.largest_at)}" if extreme else ""
        amount = "without bound" if name in cycle.result.unbounded else amount
        traces += curves(cycle, name, unit, f"{label}:  {amount}" if amount else label, colour, *look(k, len(shown)))
    y_axis = axis(cycle, f"amount of force [{unit.unit}]", traces)
    high = y_axis.limits[1] if y_axis.limits else 1.06 * max(np.nanmax(trace.y) for trace in traces)
    every = Panel(Axis(y_axis.name, (0.0, high)), traces, 1.7)
    return [
        pivot_chart,
        pivot_hodograph,
        chart(cycle, "reactions", "Joint reactions, with their largest amounts", [every], row=1, width=11.0),
    ]


def hodograph(
    cycle: CycleCurves, x: str, y: str, unit: Scale, file: str, title: str, more: Sequence[Mark] = (), heading: str = ""
) -> ChartSpec:
    """Return the hodograph of a force on equal scales: the origin, the direction of motion and round crank angles are marked.

    `x` and `y` are columns [N], `unit` that of both axes.
    """
    breaks = [k + 1 for k in cycle.breaks(x, y)]
    xs, ys = (np.insert(cycle[name] * unit.factor, breaks, np.nan) for name in (x, y))
    traces = [Curve(xs, ys, "", RESULT, 1.6, gid=f"hodograph {x}")]
    for k in cycle.breaks(x, y):
        ends = [cycle[name][k : k + 2] * unit.factor for name in (x, y)]
        traces.append(Curve(ends[0], ends[1], "", RESULT, 0.9, "dot", hover=False, gid="jump"))
    marks = [Mark(0.0, 0.0, "", TARGET, "plus", 9.0), *more]
    finite_points = np.isfinite(xs) & np.isfinite(ys)
    low, high = cycle.ends
    step = 60.0 if cycle.result.full else 10.0 * max(1.0, math.ceil((high - low) / 60.0))
    if cycle.driving.ends is not None:
        step = round_below((high - low) / 4.0, (1.0, 2.0, 5.0))
    middle = np.array([np.mean(xs[finite_points]), np.mean(ys[finite_points])]) if finite_points.any() else np.zeros(2)
    for shown in np.arange(math.ceil(low / step - 1e-9) * step, high - (1e-6 if cycle.result.full else -1e-9), step):
        at = np.array([cycle.at(cycle.driving.at(shown), name) * unit.factor for name in (x, y)])
        if np.all(np.isfinite(at)):
            outward = normed(at - middle)
            prefer = (outward[0], outward[1])
            text = f"{shown % 360.0:z.0f}°" if cycle.driving.ends is None else f"{shown:.6g} mm"
            marks.append(Mark(at[0], at[1], text, RESULT, size=4.0, prefer=prefer, written=True))
    marks += _sense(xs, ys, [(mark.x, mark.y) for mark in marks])
    across, up = _window(cycle, xs[finite_points], ys[finite_points])
    plane = Panel(Axis(f"force in y [{unit.unit}]", up), traces, marks=marks)
    name = Axis(f"force in x [{unit.unit}]", across)
    return ChartSpec(file, title, [plane], name, heading or machine_title(cycle, title), equal=True, cursor=False, width=4.8)


def _window(cycle: CycleCurves, xs: Array, ys: Array) -> list[tuple[float, float]]:
    """Return limits that contain the curve and the origin; forces that grow without bound are cut off."""
    ends = [(min(0.0, low), max(0.0, high)) for low, high in (cycle.window(xs), cycle.window(ys))]
    size = max(high - low for low, high in ends) or 1.0
    halves = [max(0.62 * (high - low), 0.25 * size) for low, high in ends]
    return [(0.5 * (low + high) - half, 0.5 * (low + high) + half) for (low, high), half in zip(ends, halves, strict=True)]


def _sense(xs: Array, ys: Array, occupied: Sequence[tuple[float, float]]) -> list[Mark]:
    """Return an arrow head on the longest piece of a curve, away from the places of other marks."""
    paths = [*pieces(np.stack([xs, ys], axis=-1))] or [np.zeros((1, 2))]
    lengths = [np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)) if len(path) > 1 else np.zeros(1) for path in paths]
    k = int(np.argmax([length[-1] for length in lengths]))
    if lengths[k][-1] <= 0.0:
        return []
    places = np.searchsorted(lengths[k], np.linspace(0.2, 0.8, 13) * lengths[k][-1])
    free = [np.min(np.linalg.norm(np.array(occupied) - paths[k][place], axis=1)) for place in places]
    p, q = (paths[k][places[int(np.argmax(free))] + i] for i in (0, 1))
    angle = math.degrees(math.atan2(q[1] - p[1], q[0] - p[0])) - 90.0
    return [Mark(p[0], p[1], "", RESULT, "triangle", 8.0, angle=angle)]


def guides(cycle: CycleCurves) -> list[ChartSpec]:
    """Return the normal force, friction force and moment of every guide on its slider."""
    every = cycle.result.machine.mechanism.guides
    normals = [f"{guide.name}.normal_N" for guide in every]
    moments = [f"{guide.name}.moment_Nm" for guide in every]
    shown = [guide for guide in every if cycle.has(f"{guide.name}.normal_N", normals)]
    lever = max((cycle.peak(name) for name in normals), default=0.0) * _extent(cycle)
    turned = [name for name in moments if cycle.peak(name) > ROUNDING * lever and cycle.peak(name) > 0.0]
    heading = machine_title(cycle, "guide forces")
    charts = []
    for row, guide in enumerate(shown or [guide for guide in every if f"{guide.name}.moment_Nm" in turned]):
        names = [f"{guide.name}.normal_N", f"{guide.name}.friction_N"]
        unit = scale(cycle.peak(*names), "N")
        rubbed = cycle.has(names[1])
        traces = curves(cycle, names[0], unit, "normal force" if rubbed else "", RESULT)
        traces += curves(cycle, names[1], unit, "friction", BODIES[2], 1.3) if rubbed else []
        force = panel(cycle, f"normal force [{unit.unit}]", traces, 1.1, extremes(cycle, names[0], unit))
        title, caption = f"Guide force in {guide.name}", f"{guide.name}: {guide.on} on {guide.slider}, to the left of the line"
        charts.append(
            chart(cycle, "guides", title, [force], heading=heading, remark=caption, row=row, width=6.6 if turned else 7.6)
        )
        name = f"{guide.name}.moment_Nm"
        if name in turned:
            unit = scale(cycle.peak(name), "N m")
            marks = extremes(cycle, name, unit)
            moment = panel(cycle, f"moment [{unit.unit}]", curves(cycle, name, unit, "", BODIES[3]), 1.1, marks)
            title = f"Guide moment in {guide.name} on {guide.slider}"
            charts.append(chart(cycle, "guides", title, [moment], heading=heading, row=row, width=4.8))
    return charts


def _extent(cycle: CycleCurves) -> float:
    """Return a characteristic length of the machine [m]."""
    return max((cycle.peak(name) for name in cycle.columns if name.endswith((".x_m", ".y_m"))), default=1.0)


def work(cycle: CycleCurves, initial: CycleCurves | None = None) -> list[ChartSpec]:
    """Return the work of the drive since the start with its extremes, and below it the kinetic and potential energy."""
    name, energies = "input.work_J", ("energy.kinetic_J", "energy.potential_J")
    if not cycle.has(name):
        return []
    unit = scale(cycle.peak(name), "J")
    traces = curves(cycle, name, unit, "", RESULT, 1.9, initial=initial)
    panels = [panel(cycle, f"work of the drive [{unit.unit}]", traces, 1.2, extremes(cycle, name, unit))]
    total = cycle.result.work if abs(cycle.result.work) > ROUNDING * cycle.peak(name) else 0.0
    caption = f"{unit.text(total) if total else '0 J'} {cycle.result.extent}" if math.isfinite(total) else ""
    stored = [energy for energy in energies if cycle.has(energy, energies)]
    if stored:
        unit = scale(cycle.peak(*stored), "J")
        words = {energies[0]: ("kinetic", CRANK), energies[1]: ("potential", ROCKER)}
        traces = [curve for energy in stored for curve in curves(cycle, energy, unit, *words[energy], 1.5)]
        if len(stored) == 2:
            total_energy = (cycle[energies[0]] + cycle[energies[1]]) * unit.factor
            traces.append(Curve(cycle.places, total_energy, "both", MUTED, 1.2, "dash", gid="energy"))
        panels.append(panel(cycle, f"energy [{unit.unit}]", traces))
    return [chart(cycle, "work", "Work of the drive", panels, remark=caption)]


def shaking(cycle: CycleCurves, initial: CycleCurves | None = None) -> list[ChartSpec]:
    """Return the hodograph of the shaking force, and over the crank angle its components and the moment about the pivot."""
    x, y, moment = SHAKING
    forced = any(cycle.has(name, [x, y, *joints(cycle).values()]) for name in (x, y))
    if not forced and not cycle.has(moment):
        return []
    charts, panels = [], []
    heading = machine_title(cycle, "shaking force and moment")
    if forced:
        unit = scale(cycle.peak(x, y), "N")
        most = _largest_shaking(cycle)
        mark = Mark(most[0] * unit.factor, most[1] * unit.factor, "", CRANK, size=5.0, gid="largest")
        caption = f"Shaking force, at most {unit.text(math.hypot(most[0], most[1]))} at {position(cycle.driving, most[2])}"
        charts.append(hodograph(cycle, x, y, unit, "shaking", caption, [mark], heading))
        traces = [
            *curves(cycle, x, unit, "in x", RESULT, initial=initial),
            *curves(cycle, y, unit, "in y", CRANK, dash="dash", initial=initial),
        ]
        panels.append(panel(cycle, f"shaking force [{unit.unit}]", traces))
    title = "Shaking of the frame"
    if cycle.peak(moment) > ROUNDING * cycle.peak(x, y) * _extent(cycle):
        unit = scale(cycle.peak(moment), "N m")
        traces = curves(cycle, moment, unit, "", BODIES[3], initial=initial)
        panels.append(panel(cycle, f"moment [{unit.unit}]", traces, 1.0, extremes(cycle, moment, unit)))
        pivot = f"{cycle.pivot.lower()} {cycle.result.machine.mechanism.crank.start}"
        title = f"Shaking{' of the frame,' * forced} moment about the {pivot}"
    remark = "" if forced else "force-balanced: no shaking force"
    if panels:  # a moment that is rounding alone has none
        charts.append(chart(cycle, "shaking", title, panels, heading=heading, remark=remark, width=5.8 if forced else 7.6))
    return charts


def _largest_shaking(cycle: CycleCurves) -> tuple[float, float, float]:
    """Return the components [N] of the largest shaking force and its crank angle [rad]."""
    machine, speed = cycle.result.machine, cycle.result.speed

    def force(angles: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            wrench = shaken(machine.moving(angles, speed)).force
        return np.broadcast_to(np.asarray(wrench[0]), angles.shape), np.broadcast_to(np.asarray(wrench[1]), angles.shape)

    grid = np.unique(cycle.angles)
    place, _ = extrema.maxima(lambda angles: np.hypot(*force(angles))[None, :], grid)
    fx, fy = force(place)
    return fx[0], fy[0], place[0]
