"""Charts of the driving torque, joint reactions, guide forces, work and shaking force of a machine over its cycle."""

import math
from collections.abc import Sequence

import numpy as np

from optlink.dynamics.columns import pin_columns
from optlink.dynamics.inverse import shaking as shaken
from optlink.linkage import extrema
from optlink.report.chart_spec import (
    BODIES,
    COUPLER,
    CRANK,
    MUTED,
    RESULT,
    ROCKER,
    TARGET,
    Array,
    Axis,
    ChartSpec,
    Curve,
    Line,
    Mark,
    Panel,
)
from optlink.report.format import Scale, degrees, scale
from optlink.report.views.analysis_charts import DASHES, axis, chart, curves, extremes, look, machine_title, panel, together
from optlink.report.views.analysis_curves import ROUNDING, CycleCurves

TORQUE = "input.torque_Nm"
SHAKING = ("frame.shaking_fx_N", "frame.shaking_fy_N", "frame.shaking_moment_Nm")


def forces(cycle: CycleCurves, initial: CycleCurves | None = None) -> list[ChartSpec]:
    """Return the charts of torque, joint reactions, guide forces, work and shaking that the machine has."""
    return [*torque(cycle, initial), *reactions(cycle), *guides(cycle), *work(cycle, initial), *shaking(cycle, initial)]


def torque(cycle: CycleCurves, initial: CycleCurves | None = None) -> list[ChartSpec]:
    """Return the driving torque, its inertia, gravity and load parts, and its mean, with extremes marked."""
    if not cycle.has(TORQUE):
        return []
    result = cycle.result
    unit = scale(cycle.peak(TORQUE), "N m")
    parts = [name for name in ("inertia", "gravity", "load") if cycle.has(f"input.torque_{name}_Nm", [TORQUE])]
    words = {"load": "loads and friction" if result.machine.friction else "loads"}
    traces = curves(cycle, TORQUE, unit, "driving torque", CRANK, 2.6, initial=initial)
    for part, colour, dash in zip(parts if len(parts) > 1 else [], (COUPLER, ROCKER, BODIES[2]), DASHES, strict=False):
        traces += curves(cycle, f"input.torque_{part}_Nm", unit, f"for {words.get(part, part)}", colour, 1.2, dash)
    lines = []
    mean = result.work / (cycle.end - cycle.start)
    if math.isfinite(mean):
        mean = mean if abs(mean) > ROUNDING * cycle.peak(TORQUE) else 0.0
        lines.append(Line(mean * unit.factor, f"mean {unit.text(mean) if mean else 0}", TARGET, gid="mean"))
    name = f"torque on {result.machine.mechanism.crank.body} [{unit.unit}]"
    shown = panel(cycle, name, traces, 1.6, extremes(cycle, TORQUE, unit), lines)
    speed = f"{abs(result.speed):.5g} rad/s = {abs(result.speed) * 30.0 / math.pi:.5g} rpm"
    speed += "" if result.speed > 0.0 else ", clockwise"
    return [chart(cycle, "torque", "Driving torque", [shown], remark=speed)]


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
    pivot_chart = chart(cycle, "reactions", f"Crank pivot {crank.start}: {caption}", force, heading=heading, width=6.2)
    pivot_hodograph = hodograph(cycle, x, y, unit, "reactions", "Hodograph of this force, crank angle marked")
    unit = scale(cycle.peak(*amounts.values()), "N")
    shown = together(cycle.columns, {label: name for label, name in amounts.items() if cycle.has(name, list(amounts.values()))})
    traces = []
    for k, (label, name) in enumerate(shown.items()):
        colour = (CRANK, *BODIES)[k % (len(BODIES) + 1)]
        extreme = cycle.result.extremes.get(name)
        amount = f"{unit.text(extreme.largest)} at {degrees(extreme.largest_at)}" if extreme else ""
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
    step = 60.0 if cycle.result.full else 10.0 * max(1.0, math.ceil(abs(math.degrees(cycle.end - cycle.start)) / 60.0))
    low, high = sorted((math.degrees(cycle.start), math.degrees(cycle.end)))
    middle = np.array([np.mean(xs[finite_points]), np.mean(ys[finite_points])]) if finite_points.any() else np.zeros(2)
    for turned in np.arange(math.ceil(low / step - 1e-9) * step, high - (1e-6 if cycle.result.full else -1e-9), step):
        at = np.array([cycle.at(math.radians(turned), name) * unit.factor for name in (x, y)])
        if np.all(np.isfinite(at)):
            outward = (at - middle) / max(float(np.linalg.norm(at - middle)), 1e-30)
            prefer = (float(outward[0]), float(outward[1]))
            marks.append(Mark(at[0], at[1], f"{turned % 360.0:z.0f}°", RESULT, size=4.0, prefer=prefer, written=True))
    marks += _sense(xs, ys, [(mark.x, mark.y) for mark in marks])
    across, up = _window(cycle, xs[finite_points], ys[finite_points])
    shown = Panel(Axis(f"force in y [{unit.unit}]", up), traces, marks=marks)
    name = Axis(f"force in x [{unit.unit}]", across)
    return ChartSpec(file, title, [shown], name, heading or machine_title(cycle, title), equal=True, cursor=False, width=4.8)


def _window(cycle: CycleCurves, xs: Array, ys: Array) -> list[tuple[float, float]]:
    """Return limits that contain the curve and the origin; forces that grow without bound are cut off."""
    ends = [(min(0.0, low), max(0.0, high)) for low, high in (cycle.window(xs), cycle.window(ys))]
    size = max(high - low for low, high in ends) or 1.0
    halves = [max(0.62 * (high - low), 0.25 * size) for low, high in ends]
    return [(0.5 * (low + high) - half, 0.5 * (low + high) + half) for (low, high), half in zip(ends, halves, strict=True)]


def _sense(xs: Array, ys: Array, occupied: Sequence[tuple[float, float]]) -> list[Mark]:
    """Return an arrow head on the longest piece of a curve, away from the places of other marks."""
    pieces = [np.stack([xs, ys], axis=-1)[piece] for piece in np.split(np.arange(len(xs)), np.flatnonzero(~np.isfinite(xs + ys)))]
    paths = [piece[np.isfinite(piece).all(axis=1)] for piece in pieces]
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
            traces.append(Curve(cycle.degrees, total_energy, "both", MUTED, 1.2, "dash", gid="energy"))
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
        caption = f"Shaking force, at most {unit.text(math.hypot(most[0], most[1]))} at {degrees(most[2])}"
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
        title = f"Shaking{' of the frame,' * forced} moment about the crank pivot {cycle.result.machine.mechanism.crank.start}"
    remark = "" if forced else "force-balanced: no shaking force"
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
    return float(fx[0]), float(fy[0]), float(place[0])
