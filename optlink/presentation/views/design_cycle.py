"""Pictures of a machine over its cycle: minimised and limited quantities, and the initial mechanism beside the design."""

import math
from collections.abc import Iterable
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from optlink.dynamics.columns import MotionColumns, efforts
from optlink.linkage.vector2d import TURN, Value
from optlink.presentation import chart_spec
from optlink.presentation.chart_spec import GROUND, LIMIT, MUTED, RESULT, Array, Axis, ChartSpec, Curve, Panel, drive_axis
from optlink.presentation.drawing import Sketch
from optlink.presentation.format import Scale, marked, position, scale
from optlink.presentation.labels import place_labels
from optlink.presentation.style import figure, heading, styled
from optlink.presentation.view import SomeDrawing
from optlink.problem.design import DesignProblem
from optlink.problem.driving import Driving
from optlink.problem.terms import BACK, Term
from optlink.tasks.analyze import Analysis
from optlink.tasks.results.design import LinkageDesign, SynthesisResult
from optlink.units import KINDS
from optlink.validation.cycle import Cycle

INITIAL = MUTED
STEPS = 720


class Line(NamedTuple):
    """A quantity over the revolution or range: positions of the drive in its unit, values [SI] with NaN at jumps, its measure.

    `way` is BACK if they are those of the way back through the range, where the extreme occurs.
    """

    angles: Array
    values: Array
    figure: float
    way: str


def _line(cycle: Cycle, term: Term, driving: Driving) -> Line:
    """Evaluate a cyclic term over the revolution, with one-sided values at load jumps."""
    (machine, read), speed = cycle.history(term), -cycle.speed if cycle.on_way_back(term) else cycle.speed
    jumps = cycle.low + np.remainder(cycle.work.jumps - cycle.low, cycle.cycle)
    even = np.linspace(cycle.low, cycle.high, STEPS * max(1, round(cycle.cycle / TURN)) + 1)
    angles = np.concatenate([even, jumps, jumps])
    values = read(MotionColumns(machine.moving(np.concatenate([even, jumps]), speed)))
    before = read(MotionColumns(machine.moving(jumps, speed, side=-1))) if jumps.size else np.zeros(0)
    rank = np.concatenate([np.ones(len(even)), np.full(len(jumps), 2.0), np.zeros(len(jumps))])
    rank = rank if speed > 0.0 else -rank
    order = np.lexsort((rank, angles))
    x, y = driving.shown(angles[order]), np.concatenate([values, before])[order]
    gaps = np.flatnonzero(np.diff(x) == 0.0) + 1
    return Line(np.insert(x, gaps, np.nan), np.insert(y, gaps, np.nan), cycle.figure(term), cycle.on_way_back(term) * BACK)


def _distinct_terms(problem: DesignProblem) -> Iterable[tuple[Term, float | None, float | None]]:
    """Yield every cyclic term once, with its limits [SI]."""
    terms: dict[tuple[object, ...], tuple[Term, float | None, float | None]] = {}
    objectives = [(goal, None, None) for goal in problem.goals]
    for term, low, high in [*objectives, *((b.term, b.interval.low, b.interval.high) for b in problem.bounds)]:
        if term.nature.cyclic:
            key = (term.quantity, term.of, term.on, term.static, term.about)
            first, *merged = terms.get(key, (term, None, None))
            bounds = (low, high) if term.extreme else (None, None)
            terms[key] = (first, bounds[0] if merged[0] is None else merged[0], bounds[1] if merged[1] is None else merged[1])
    yield from terms.values()


def courses(design: LinkageDesign) -> list[ChartSpec]:
    """Return the minimised and limited quantities over the revolution: initial machine grey, optimal in colour, limits red."""
    shown, initial, optimal = list(_distinct_terms(design.whole)), design.first_cycle, design.cycle
    if not shown or optimal is None or not optimal.complete:
        return []
    cycles = {"result": optimal} if initial is None or not initial.complete else {"initial": initial, "result": optimal}
    driving = design.problem.model.driving
    panels = [_panel(design, term, cycles, (low, high)) for term, low, high in shown]
    places = [optimal.low + (at - optimal.low) % optimal.cycle for at in optimal.work.jumps]
    jumps = [chart_spec.Line(driving.shown(at), colour=RESULT, width=0.8) for at in places]
    x = drive_axis(driving, limits=(driving.shown(optimal.low), driving.shown(optimal.high)))
    if optimal.speed < 0.0 and driving.ends is None:
        x = Axis(f"{x.name}, turned clockwise: from right to left", x.limits, step=x.step)
    whole = optimal.over if optimal.limits or optimal.cycle == TURN else "the cycle"
    title = f"Objectives and limits over {whole}"
    return [ChartSpec("courses", title, panels, x, heading=design.whole.title, lines=jumps, brief=True)]


def _panel(design: LinkageDesign, term: Term, cycles: dict[str, Cycle], limits: tuple[float | None, float | None]) -> Panel:
    lines = {name: _line(cycle, term, design.problem.model.driving) for name, cycle in cycles.items()}
    kind = design.whole.kind(term)
    unit = "deg" if kind == "angle" else KINDS[kind].si.replace("**2", "²").replace("*", " ") if kind in KINDS else ""
    shown = scale(max(np.nanmax(np.abs(line.values)) for line in lines.values()), unit)
    styles = {"initial": (INITIAL, 1.3), "result": (RESULT, 1.8)}
    curves = [
        Curve(
            line.angles,
            line.values * shown.factor,
            f"{name}: {term.how} {shown.text(line.figure)}{line.way}",
            *styles[name],
            gid=name,
            initial=name == "initial",
        )
        for name, line in lines.items()
    ]
    low = min(np.nanmin(line.values) for line in lines.values())
    return Panel(Axis(f"{term.subject} [{shown.unit}]"), curves, lines=list(_limits(term, limits, shown, low)))


def _limits(term: Term, limits: tuple[float | None, float | None], shown: Scale, low: float) -> Iterable[chart_spec.Line]:
    """Yield the limits as red lines; a peak is limited on both sides of zero."""
    lines = [limit for limit in limits if limit is not None]
    if term.how == "peak" and lines and not term.nature.vector and low < -0.6 * lines[0]:
        lines.append(-lines[0])
    for k, limit in enumerate(lines):
        yield chart_spec.Line(limit * shown.factor, "" if k else "limit", LIMIT, dash="dashdot")


@partial(SomeDrawing, lambda result: result.best and result.best.whole.of_cycle and result.best.analysis and result)
@styled
def beside_initial(result: SynthesisResult) -> Figure:
    """Draw the initial machine grey and the optimal one in colour, with joint paths, where the drive exerts most."""
    design = result.best
    assert design is not None
    assert design.analysis is not None
    initial, optimal = design.initial_analysis, design.analysis
    at = np.array([_largest_effort(optimal)])
    sketches = [(a, Sketch(_revolution(a), a.machine)) for a in (initial, optimal) if a is not None]
    main = sketches[-1][1]
    for _, sketch in sketches[:-1]:
        factor = main.scale.factor / sketch.scale.factor
        main.widen(np.array([sketch.low, sketch.high]) * factor)
    width = 7.4
    fig = figure(width, min(9.0, max(3.6, 0.9 * width * main.ratio + 1.1)))
    axes = fig.subplots()
    if initial is not None:
        _draw_initial(axes, initial, main.scale, at)
    names = main.show(axes, optimal.machine.motion(at))
    grey = {} if initial is None else {"initial_machine": Line2D([], [], color=INITIAL, linewidth=3.0)}
    main.add_legend(fig, 5, **grey)
    driving = optimal.problem.model.driving
    title = f"{design.whole.title}: at {driving.noun} {position(driving, float(at[0]))}"
    titles = marked(title, design, result.refuted)
    fig.suptitle(heading("\n".join(titles), width), color=None if design.valid else LIMIT)
    place_labels(fig, names)
    return fig


def _largest_effort(optimal: Analysis) -> float:
    """Return the position [rad] at which the absolute torque or force of the drive of the optimal machine is largest."""
    extreme = optimal.extremes.get(efforts(optimal.machine.mechanism)[0].column)
    if extreme is None or not math.isfinite(extreme.largest):
        return float(optimal.positions[0])
    return extreme.largest_at if extreme.largest >= -extreme.least else extreme.least_at


def _revolution(analysis: Analysis) -> Value:
    mechanism = analysis.machine.mechanism
    return analysis.machine.motion(np.linspace(*mechanism.extent, STEPS + 1))


def _draw_initial(axes: Axes, initial: Analysis, shown: Scale, at: Array) -> None:
    """Draw the initial machine in grey: joint paths and bodies as lines."""
    mechanism = initial.machine.mechanism
    whole_turn, position = _revolution(initial), initial.machine.motion(at)
    for name, bodies in mechanism.owners.items():
        if set(bodies) != {"frame"}:
            path = whole_turn.position(name) * shown.factor
            axes.plot(*path.T, color=INITIAL, linewidth=0.9, alpha=0.6, zorder=0.8, linestyle="--")
    for link in mechanism.links:
        if link.end:
            ends = np.array([position.position(point)[0] for point in (link.start, link.end)]) * shown.factor
            axes.plot(*ends.T, color=INITIAL, linewidth=3.0, alpha=0.55, zorder=1.2, solid_capstyle="round")
    pins = np.array([position.position(name)[0] for name in mechanism.pins]) * shown.factor
    axes.plot(*pins.T, linestyle="none", marker="o", markersize=5, mfc="white", mec=GROUND, alpha=0.6, zorder=1.4)
