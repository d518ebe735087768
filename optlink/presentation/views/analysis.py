"""View of an analysis: mechanism at its characteristic positions, charts over the cycle, animation."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch
from numpy.typing import NDArray
from PIL import Image

from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import TURN
from optlink.presentation.chart_spec import CRANK, TARGET, ChartSpec
from optlink.presentation.drawing import Sketch, film, merged_positions, there_and_back
from optlink.presentation.format import position, round_below, scale
from optlink.presentation.labels import Label, place_labels
from optlink.presentation.style import figure, heading, panels, styled
from optlink.presentation.view import View
from optlink.presentation.views import analysis_charts, analysis_tables, conclusions
from optlink.presentation.views.analysis_charts import ROUNDING, CycleCurves, output

FRAMES = 80


def charts(cycle: CycleCurves) -> list[ChartSpec]:
    """Return the charts of an analysis: motion, transmission angles and any forces."""
    return [
        *analysis_charts.motion(cycle),
        *analysis_charts.bodies(cycle),
        *analysis_charts.transmission(cycle),
        *analysis_charts.forces(cycle),
    ]


# --- mechanism -------------------------------------------------------------------------------------------------------------


def positions(cycle: CycleCurves) -> dict[str, float]:
    """Return the characteristic crank angles [rad] by name.

    These are the start (or start, middle and end of a limited range), the dead centres of the output and the torque extremes.
    """
    result, out = cycle.result, output(cycle)
    angles = [("start", cycle.start)]
    if not result.full:
        middle = 0.5 * (cycle.start + cycle.end)
        angles = [("start of the range", cycle.start), ("middle of the range", middle), ("end of the range", cycle.end)]
    centres = cycle.in_order(out.travel.dead_centres) if out.travel else []
    ends = (out.travel.low_at, out.travel.high_at) if out.travel else ()
    for number, at in enumerate(centres, 1):
        if len(centres) <= 4 or any(abs(math.remainder(at - end, TURN)) < 1e-6 for end in ends):
            angles.append((f"dead centre {number} of {out.name}" if 1 < len(centres) <= 4 else f"limit of {out.name}", at))
    for effort in cycle.efforts if len(cycle.efforts) == 1 else ():
        extreme, name = result.extremes.get(effort.column), effort.quantity
        if extreme and cycle.has(effort.column) and extreme.largest - extreme.least > ROUNDING * cycle.peak(effort.column):
            angles += [(f"largest {name}", cycle.inside(extreme.largest_at)), (f"least {name}", cycle.inside(extreme.least_at))]
    return merged_positions(angles, periodic=result.full)


@styled
def mechanism(cycle: CycleCurves) -> Figure:
    """Draw the mechanism at its characteristic positions with joint traces, and the joint velocities at one of them."""
    result = cycle.result
    machine = result.machine
    sketch = Sketch(machine.motion(cycle.angles, result.speed), machine)
    angles = positions(cycle)
    motions = {name: machine.motion(np.array([at]), result.speed) for name, at in angles.items()}
    moving = [point for point, bodies in machine.mechanism.owners.items() if FRAME not in bodies]
    speeds = {name: max(np.linalg.norm(motion.velocity(point)[0]) for point in moving) for name, motion in motions.items()}
    # show velocities at the largest torque or, if some are unbounded, where they are smallest
    slow = {name: speed for name, speed in speeds.items() if math.isfinite(speed)}
    chosen = next((name for name in angles if "largest " in name), next(iter(angles)))
    if slow and not cycle.steady:
        chosen = min(slow, key=lambda name: slow[name])
    longest = 0.2 * np.max(sketch.high - sketch.low)
    drawn_arrows = {} if result.static else sketch.arrows(motions[chosen], moving, longest)
    sketch.widen(np.array([end for _, end in drawn_arrows.values()]).reshape(-1, 2))
    count = len(angles) + bool(drawn_arrows)
    tall = sketch.ratio > 1.15
    columns = 4 if tall and count > 6 else 3 if count > 4 else 2 if count > 1 else 1
    rows = -(-count // columns)
    panel = 3.3 if tall else 4.0
    width = panel * columns
    fig = figure(width, ((panel - 0.6) * min(max(sketch.ratio, 0.3), 1.6) + 0.95) * rows + 0.8)
    grid = panels(fig, count, columns)
    labels: list[Label] = []
    for axes, (name, at) in zip(grid, angles.items(), strict=False):
        labels += sketch.show(axes, motions[name])
        axes.set_title(f"{heading(name, panel, 9.5)}\n{_state(cycle, at)}", fontsize=9.5)
    if drawn_arrows:
        axes = grid[-1]
        labels += sketch.show(axes, motions[chosen], traces=False)
        axes.set_xlabel(axes.get_xlabel(), loc="left")  # the scale of the arrows is drawn on the right
        for point, (begin, end) in drawn_arrows.items():
            _arrow(axes, begin, end, gid=f"velocity {point}")
        axes.set_title(f"velocities of the joints, {_place(cycle, angles[chosen])}\n{heading(chosen, panel, 9.5)}", fontsize=9.5)
    fig.suptitle(heading(result.problem.model.title, width), fontsize=11)
    sketch.add_legend(fig, int(1.1 * width))
    place_labels(fig, labels)
    if drawn_arrows:
        top = max(float(np.linalg.norm(motions[chosen].velocity(point)[0])) for point in drawn_arrows)
        _scale_arrow(grid[-1], top, longest)
    return fig


def _scale_arrow(axes: Axes, top: float, longest: float) -> None:
    """Draw the scale arrow of the velocities below the x axis; a velocity `top` [m/s] is drawn `longest` long."""
    unit = scale(top, "m/s")
    shown = round_below(0.6 * top * unit.factor, (1.0, 2.0, 5.0), 1e-12)
    (_, low), (right, _) = axes.get_window_extent().get_points()
    x, y = axes.transData.inverted().transform((right, low - 27.0 / 72.0 * axes.figure.dpi))
    length = longest * shown / (top * unit.factor)
    _arrow(axes, np.array([x - length, y]), np.array([x, y]), gid="scale").set_clip_on(False)
    room = 0.015 * np.ptp(axes.get_xlim())
    axes.text(x - length - room, y, f"{shown:g} {unit.unit}", ha="right", va="center", fontsize=8.5, in_layout=False)


def _arrow(axes: Axes, begin: NDArray[np.float64], end: NDArray[np.float64], gid: str) -> FancyArrowPatch:
    """Draw an arrow between two points (2,)."""
    ends = (begin[0], begin[1]), (end[0], end[1])
    drawn = FancyArrowPatch(*ends, arrowstyle="-|>", mutation_scale=9.0, linewidth=1.4, color=TARGET, shrinkA=0.0, shrinkB=0.0)
    drawn.set(zorder=6, gid=gid)
    axes.add_patch(drawn)
    return drawn


def _place(cycle: CycleCurves, at: float) -> str:
    """Format a position of the drive: "φ 30.00°", "length 1050 mm"."""
    return f"{'φ' if cycle.driving.ends is None else cycle.driving.noun} {position(cycle.driving, at)}"


def _state(cycle: CycleCurves, at: float) -> str:
    """Format crank angle, output position and driving torque at a position."""
    out = output(cycle)
    parts = [_place(cycle, at), f"{'s' if out.slides else 'θ'} {out.scales(cycle)[0].text(cycle.at(at, out.columns[0]))}"]
    for effort in cycle.efforts if not np.any(np.abs(cycle.result.jumps - at) < 1e-6) else ():
        if cycle.has(effort.column) and math.isfinite(value := cycle.at(at, effort.column)):
            parts.append(f"{effort.symbol} {scale(cycle.peak(effort.column), effort.unit).text(value)}")
    return "   ".join(parts)


# --- animation ---------------------------------------------------------------------------------------------------------------


@styled
def frames(cycle: CycleCurves, count: int = FRAMES) -> list[Image.Image]:
    """Draw the frames of the animation: one revolution, or back and forth over a limited crank range.

    Beside the mechanism, the driving torque or the output motion is drawn.
    """
    result = cycle.result
    machine = result.machine
    sketch = Sketch(machine.motion(cycle.angles), machine)
    once = cycle.start + cycle.direction * result.cycle * np.arange(count) / count
    steps = once if result.full else there_and_back(cycle.start, cycle.end, count)
    out = output(cycle)
    effort = next((one for one in cycle.efforts if cycle.has(one.column)), None)
    name = effort.column if effort else out.columns[0]
    unit = scale(cycle.peak(name), effort.unit) if effort else out.scales(cycle)[0]
    word = effort.words if effort else f"{out.name}: {'slide' if out.slides else 'angle'}"
    traces = analysis_charts.curves(cycle, name, unit, "", CRANK)
    strip = analysis_charts.chart(cycle, "", "", [analysis_charts.panel(cycle, f"{word} [{unit.unit}]", traces)])
    marks = np.array([[cycle.driving.shown(at), cycle.at(at, name) * unit.factor] for at in steps])
    return film(sketch, machine.motion(steps), strip, marks, [result.problem.model.title])


VIEW = View(
    analysis_tables.analysis,
    conclusions.analysis,
    "Analysis",
    model=CycleCurves,
    charts=charts,
    drawings={"mechanism": mechanism},
    tables=lambda result: {"cycle": result.columns},
    frames=frames,
)
