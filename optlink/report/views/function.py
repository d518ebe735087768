"""View of a function synthesis result of a four-bar: mechanism, law and error, transmission angle, objective map, animation."""

import itertools
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc
from PIL import Image

from optlink.linkage.fourbar import LENGTHS, dead_centre, lengths_of, reachable
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN
from optlink.optimization.constraints import rows as limit_rows
from optlink.optimization.output_derivatives import ErrorResiduals
from optlink.problem.targets.function import Function
from optlink.report.animation import film, there_and_back
from optlink.report.causes import marked
from optlink.report.chart_spec import Array, Axis, Band, ChartSpec, Curve, Line, Mark, Panel, Span, Trace, crank_angle
from optlink.report.drawing import Sketch, merged_positions
from optlink.report.format import dimension
from optlink.report.labels import place_labels
from optlink.report.style import LIMIT, MUTED, RESULT, ROCKER, TARGET, figure, heading, panels, styled
from optlink.report.view import View
from optlink.report.views.certificate_view import certificate_charts
from optlink.report.views.path_view import with_verdict
from optlink.solvers.contract import selectable
from optlink.tasks.results.design import LinkageDesign, SynthesisResult
from optlink.validation.linkage_motion import transmission_angles


def _moved(result: SynthesisResult, angles: Array) -> Motion:
    return sweep(result.definite.spec.linkage, result.definite.spec.sizes(result.design), angles)


def _best(result: SynthesisResult) -> LinkageDesign:
    assert result.best is not None
    return result.best


def _sizes(result: SynthesisResult) -> dict[str, float]:
    return {name: result.design[name] for name in LENGTHS}


def _start(result: SynthesisResult) -> float:
    """Return the starting angle [rad] within half a turn of zero, as the machine has it."""
    start = result.design["phi0"]
    return math.remainder(start, TURN) if math.isfinite(start) else math.nan


def _clockwise(result: SynthesisResult) -> bool:
    return result.definite.spec.span < 0.0


def _range(result: SynthesisResult) -> Array:
    """Return rising crank angles [rad] of a revolution from the starting angle, or of the reachable range that contains it."""
    start = _start(result)
    for low, high in reachable(*lengths_of(_sizes(result))):
        if high - low > TURN - 1e-9:
            begin = (start if math.isfinite(start) else 0.0) - (TURN if _clockwise(result) else 0.0)
            return np.linspace(begin, begin + TURN, 721)
        for turn in (-TURN, 0.0, TURN):
            if math.isfinite(start) and low + turn - 1e-9 <= start <= high + turn + 1e-9:
                return np.linspace(low + turn + 1e-6, high + turn - 1e-6, 721)
    return np.array([])


def _transmission(motion: Motion) -> Array:
    return np.degrees(transmission_angles(motion, motion.mechanism)[:, 0])


# --- mechanism -------------------------------------------------------------------------------------------------------


def positions(result: SynthesisResult) -> dict[str, float]:
    """Return the characteristic crank angles [rad] by name: start and end of the span, dead centres, transmission extremes."""
    problem, sizes = result.definite.spec, _sizes(result)
    angles: dict[str, float] = {"start": result.design["phi0"], "end of the span": result.design["phi0"] + problem.span}
    whole_turn = [(low, high) for low, high in reachable(*lengths_of(sizes)) if high - low > TURN - 1e-9]
    if whole_turn:
        for name, outer in (("outer dead centre", True), ("inner dead centre", False)):
            limit = dead_centre(*lengths_of(sizes), problem.side, outer=outer)
            if limit.margin >= 0.0:
                angles[name] = float(limit.phi)
        angles["smallest transmission angle"], angles["largest transmission angle"] = 0.0, math.pi
    return merged_positions(angles.items())


@styled
def mechanism(result: SynthesisResult) -> Figure | None:
    """Draw the mechanism at its characteristic positions side by side, on one scale."""
    angles = _range(result)
    if angles.size == 0:
        return None
    sketch = Sketch(_moved(result, angles))
    named = positions(result)
    columns = 3 if len(named) > 4 else 2 if len(named) > 1 else 1
    rows = -(-len(named) // columns)
    fig = figure(3.9 * columns, (3.3 * min(max(sketch.ratio, 0.45), 1.3) + 0.95) * rows + 0.55)
    letters = []
    for axes, (name, phi) in zip(panels(fig, len(named), columns), named.items(), strict=True):
        position = _moved(result, np.array([phi]))
        letters += sketch.show(axes, position)
        gamma = float(_transmission(position)[0])
        psi = math.degrees(float(position.body_angle("rocker").value[0]))
        axes.set_title(f"{name}\nφ {math.degrees(phi) % 360.0:z.2f}°   ψ {psi:z.2f}°   γ {gamma:z.2f}°", fontsize=9.5)
    lengths = "   ".join(f"{name} {value * sketch.scale.factor:z.3f}" for name, value in _sizes(result).items())
    titles = marked(result.definite.spec.title, _best(result), result.refuted)
    lines = [heading(line, 3.9 * columns) for line in (*titles, f"{lengths} {sketch.scale.unit}")]
    fig.suptitle("\n".join(lines), fontsize=11, color=None if result.valid else LIMIT)
    place_labels(fig, letters)
    return fig


# --- output ----------------------------------------------------------------------------------------------------------


def charts(result: SynthesisResult) -> list[ChartSpec]:
    """Return the law over the span, y(x) of a function, the transmission angle over the motion, and the global search."""
    return [*law(result), *function_values(result), *transmission(result), *certified(result)]


def certified(result: SynthesisResult) -> list[ChartSpec]:
    """Return the charts of the certificate of the global optimum."""
    spec, design = result.definite.spec, {} if result.conflict else result.design
    return certificate_charts(result.certificate, spec.title, spec.shown_objective, design, result.assembly, spec.display)


def function_values(result: SynthesisResult) -> list[ChartSpec]:
    """Return the prescribed and the generated y(x) with the error in y; nothing for a law of the crank angle."""
    problem = result.definite.spec
    function = problem.requirement.law
    offsets = problem.span * np.linspace(0.0, 1.0, 361)
    if not isinstance(function, Function) or not math.isfinite(result.design["phi0"]):
        return []
    error = result.error(offsets)
    if not np.any(np.isfinite(error)):
        return []
    return [function_chart(function, offsets, error, heading(f"{problem.title}: {function.text}", 7.6))]


def law(result: SynthesisResult) -> list[ChartSpec]:
    """Return the prescribed and the generated function over the span, with the precision points, and the error below."""
    problem, design = result.definite.spec, result.design
    offsets, at = problem.span * np.linspace(0.0, 1.0, 361), problem.law.offsets
    if not math.isfinite(design["phi0"]):
        return []
    begin = math.degrees(_start(result))
    crank, marked = begin + np.degrees(offsets), begin + np.degrees(at)
    target, marks = (np.degrees(problem.law.curve(places, design["phi0"], design["psi0"])) for places in (offsets, at))
    generated = np.degrees(np.asarray(_moved(result, design["phi0"] + offsets).body_angle("rocker").value))
    generated = generated + 360.0 * np.round((target[0] - generated[0]) / 360.0)
    if not np.any(np.isfinite(generated)):
        return []
    error, at_marks = np.degrees(result.error(offsets)), np.degrees(result.error())
    above = [
        Curve(crank, target, "target", TARGET, 1.4, "dash", gid="target"),
        Curve(crank, generated, "generated", RESULT, 1.8, gid="generated"),
        Curve(marked, marks, "design positions", TARGET, mode="markers", size=3.0, gid="positions"),
    ]
    robust, worst = problem.requirement.robust, int(np.nanargmax(np.abs(error)))
    below: list[Trace] = []
    top, words = float(error[worst]), f"largest {error[worst]:+z.3f}°".replace("-", "−")
    if robust is not None:
        built = np.degrees(ErrorResiduals(problem).band(design, offsets))
        below.append(Band(crank, built[0], built[1], f"built, {robust.band}", LIMIT))
        top, words = float(built[int(error[worst] > 0.0), worst]), f"{words} nominal"
    below.append(Curve(crank, error, "" if robust is None else "nominal", LIMIT, 1.5, gid="error"))
    below.append(Curve(marked, at_marks, "", LIMIT, mode="markers", size=3.0))
    mark = Mark(crank[worst], top, words, size=1.0, prefer=(0.0, 1.0 if error[worst] > 0.0 else -1.0))
    panels = [Panel(Axis("rocker angle ψ [deg]"), above, 1.7), Panel(Axis("target minus generated [deg]"), below, marks=[mark])]
    shown = problem.shown_objective(result.objective)
    objective = f"{shown.value:.4g}°" if shown.unit == "deg" else f"{shown.value:.6g} {unit_of(result)}"
    title = f"{problem.title}: {_best(result).measure} {objective}"
    return [ChartSpec("law", "Motion law over the span", panels, crank_angle(clockwise=_clockwise(result)), title)]


def transmission(result: SynthesisResult) -> list[ChartSpec]:
    """Return the transmission angle over the whole motion with its limits."""
    problem, angles = result.definite.spec, _range(result)
    if angles.size == 0:
        return []
    half_turns = math.pi * np.arange(-4.0, 5.0)  # with the extremes of a full revolution
    angles = np.union1d(angles, half_turns[(half_turns > angles[0]) & (half_turns < angles[-1])])
    gamma, crank = _transmission(_moved(result, angles)), np.degrees(angles)
    start, span = math.degrees(_start(result)), math.degrees(problem.span)
    spans: list[Span] = []
    for turn in (-360.0, 0.0, 360.0):
        low, high = sorted((start + turn, start + turn + span))
        low, high = max(low, float(crank[0])), min(high, float(crank[-1]))
        if low < high - 1e-9:
            spans.append(Span(low, high, "" if spans else "span of the requirement", RESULT, 0.08))
    traces = [Curve(crank, gamma, "transmission angle γ", RESULT, 1.9, gid="transmission")]
    lines = []
    limit = problem.limits.transmission_at()
    for words, end in () if limit is None else (("at least", limit.low), ("at most", limit.high)):
        if end is None:
            continue
        bound = math.degrees(end)
        name = f"{words} {bound:.5g}°"
        if problem.limits.transmission_range == "revolution":
            lines.append(Line(bound, name, LIMIT, 1.3))
        else:
            traces.append(Curve(np.sort([start, start + span]), np.full(2, bound), name, LIMIT, 1.3, "dash"))
    marks = [
        Mark(crank[k], gamma[k], f"{word} {gamma[k]:z.2f}°", RESULT, prefer=(0.0, direction))
        for k, word, direction in ((int(np.argmin(gamma)), "least", -1.0), (int(np.argmax(gamma)), "largest", 1.0))
    ]
    x = crank_angle(clockwise=_clockwise(result), limits=(crank[0], crank[-1]))
    shown = Panel(Axis("γ [deg]"), traces, 1.4, lines, marks)
    return [ChartSpec("transmission", "Transmission angle", [shown], x, f"{problem.title}: transmission angle", spans=spans)]


# --- animation -------------------------------------------------------------------------------------------------------


@styled
def frames(result: SynthesisResult, count: int = 90) -> list[Image.Image]:
    """Draw the frames of the animation: one revolution, or back and forth over the reachable range.

    Beside the mechanism, the rocker angle is drawn.
    """
    angles = _range(result)
    if angles.size == 0:
        return []
    full = angles[-1] - angles[0] > TURN - 1e-6
    motion = _moved(result, angles)
    sketch = Sketch(motion)
    begin, span = result.design["phi0"], result.definite.spec.span
    known = math.isfinite(begin)  # no start: a linkage without the dead centre at which the law begins
    once = (begin if known else 0.0) + np.linspace(0.0, TURN, count, endpoint=False)
    steps = once if full else there_and_back(float(angles[0]), float(angles[-1]), count)
    psi, crank = np.degrees(np.asarray(motion.body_angle("rocker").value)), np.degrees(angles)
    at = (np.degrees(steps) - crank[0]) % 360.0 + crank[0] if full else np.degrees(steps)

    traces = [Curve(crank, psi, "", ROCKER)]
    x = crank_angle(limits=(crank[0], crank[-1]))
    strip = ChartSpec("", "", [Panel(Axis("rocker angle ψ [deg]"), traces)], x)

    def required(axes: Axes) -> None:
        if not known:
            return
        ends = {"theta1": math.degrees(min(begin, begin + span)), "theta2": math.degrees(max(begin, begin + span))}
        size = 1.1 * result.design["crank"] * sketch.scale.factor
        axes.add_patch(Arc((0.0, 0.0), size, size, color=MUTED, linewidth=1.3, **ends))

    marks = np.stack([at, np.interp(at, crank, psi)], axis=-1)
    titles = marked(result.definite.spec.title, _best(result), result.refuted)
    return film(sketch, _moved(result, steps), strip, marks, titles, more=required)


def function_chart(function: Function, offsets: Array, error: Array, title: str, *, warning: bool = False) -> ChartSpec:
    """Return the prescribed and the generated y(x) with the error in y.

    `offsets` (positions,) [rad] are crank rotations from the start; `error` [rad or m] is prescribed minus generated output,
    finite at one of them at least; `warning` says that the design is not valid.
    """
    least, largest = function.ends
    x = function.low + (function.high - function.low) * offsets / function.input
    target = np.asarray(function.expression({"x": x}) + 0.0 * x, dtype=float)
    deviation = error * (largest - least) / function.output
    worst = int(np.nanargmax(np.abs(deviation)))
    above = [
        Curve(x, target, "target", TARGET, 1.4, "dash", gid="target y"),
        Curve(x, target - deviation, "generated", RESULT, 1.8, gid="generated y"),
    ]
    most = float(deviation[worst])
    words = f"largest {most:+.3g}".replace("-", "−")
    mark = Mark(x[worst], most, words, size=1.0, prefer=(0.0, np.sign(most)))
    below = Panel(Axis("target minus generated"), [Curve(x, deviation, "", LIMIT, 1.5, gid="error in y")], marks=[mark])
    panels = [Panel(Axis("y"), above, 1.7), below]
    return ChartSpec("function", "Function y(x)", panels, Axis("x"), title, cursor=False, warning=warning)


COLOURS = ("#e67e22", "#8e44ad", "#16a085", "#c0392b")  # of back ends, by their position in the registry
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit_of(result: SynthesisResult) -> str:
    """Return the unit of the objective with typographic exponents."""
    return result.definite.spec.objective_display[1].replace("^2", "²")


@styled
def objective_map(result: SynthesisResult) -> Figure | None:
    """Draw contours of the objective over two design variables, the feasible region, the iterates and the optimum."""
    problem, solution = result.definite.spec, result.solution
    if solution is None or len(problem.free) != 2:
        return None
    x_name, y_name = problem.free
    (x_low, x_high), (y_low, y_high) = (problem.quantities[name].bounds for name in problem.free)
    x, y = np.meshgrid(np.linspace(x_low, x_high, 121), np.linspace(y_low, y_high, 121))
    with np.errstate(all="ignore"):
        flat = problem.complete({x_name: x, y_name: y})
        objective = ErrorResiduals(problem).objective(problem.complete({x_name: x[..., None], y_name: y[..., None]}))
        slacks = []
        for row in limit_rows(problem, flat, problem.reach(flat), problem.quantities["frame"].value):
            value = np.broadcast_to(np.asarray(row.value, dtype=float), x.shape)
            slacks.append(np.fmin(value - row.low, row.high - value))
        least = np.min(slacks or [np.ones_like(x)], axis=0)
    fig = figure(7.0, 5.8)
    axes = fig.subplots()
    scale_x, scale_y = (1e3 if name in LENGTHS else math.degrees(1.0) for name in problem.free)
    shown = np.where(np.isfinite(objective) & (objective > 0.0), objective, np.nan)
    furthest = math.pi if problem.objective_unit == "rad" else len(problem.law.offsets) * math.pi**2
    # limit to the largest possible angular error; near dead centres, first-order effects of tolerances would exceed it
    shown = np.minimum(shown, furthest) * problem.objective_display[0]
    if not np.any(np.isfinite(shown)):
        return None
    low, high = max(np.nanmin(shown), 1e-12), np.nanmax(shown)
    levels, height = np.log10(np.geomspace(low * 1.0001, high, 22)), np.log10(shown)
    x, y = x * scale_x, y * scale_y
    filled = axes.contourf(x, y, height, levels=levels, cmap="Blues_r", alpha=0.9)
    axes.contour(x, y, height, levels=levels, colors="white", linewidths=0.4, linestyles="solid")
    if np.any(least >= 0.0) and not np.all(least >= 0.0):
        outside = np.nan_to_num(least, nan=-1.0)
        axes.contourf(x, y, outside, levels=[outside.min() - 1.0, 0.0], colors=["white"], alpha=0.62)
        axes.contour(x, y, least, levels=[0.0], colors=[LIMIT], linewidths=1.5)
        axes.plot([], [], color=LIMIT, linewidth=1.5, label="edge of the feasible region")
    _iterations(axes, result, scale_x, scale_y)
    at = (result.design[x_name] * scale_x, result.design[y_name] * scale_y)
    axes.plot(*at, "*", color="#f1c40f", markeredgecolor=TARGET, markersize=15, zorder=6, label="design")
    names = (f"{name} [{'mm' if name in LENGTHS else 'deg'}]" for name in problem.free)
    axes.set(xlim=(x_low * scale_x, x_high * scale_x), ylim=(y_low * scale_y, y_high * scale_y))
    axes.set(**dict(zip(("xlabel", "ylabel"), names, strict=True)))
    axes.grid(False)
    axes.legend(frameon=True, framealpha=0.9, fontsize=8.5, loc="upper right")
    bar = fig.colorbar(filled, ax=axes, pad=0.02)
    ticks = [t for t in range(math.floor(np.log10(low)), math.ceil(np.log10(high)) + 1) if np.log10(low) <= t <= np.log10(high)]
    bar.set_ticks(ticks, labels=[f"10{str(t).translate(SUPERSCRIPTS)}" for t in ticks])
    bar.set_label(f"{_best(result).measure} [{unit_of(result)}]")
    place = (f"{name} {dimension(value)} {problem.display(name)[1]}" for name, value in zip(problem.free, at, strict=True))
    reached = f"{_best(result).measure} {problem.shown_objective(result.objective).value:.6g} {unit_of(result)}"
    axes.set_title(heading(f"{problem.title}: {reached} at {', '.join(place)}", 6.8, 10.5), fontsize=10.5)
    return fig


def _iterations(axes: Axes, result: SynthesisResult, scale_x: float, scale_y: float) -> None:
    colors = dict(zip(selectable(), itertools.cycle(COLOURS), strict=False))
    solutions = result.backends or ({result.backend: result.solution} if result.solution else {})
    sizes = [result.definite.spec.quantities["frame"].value if n in LENGTHS else 1.0 for n in result.definite.spec.free]
    for name, solution in solutions.items():
        if solution.path is not None and len(solution.path) > 1:
            path = solution.path[:, :2] * sizes * [scale_x, scale_y]
            axes.plot(path[:, 0], path[:, 1], "-o", markersize=3, linewidth=1.1, color=colors[name], label=f"{name}, iterations")
            axes.plot(*path[0], "s", color=colors[name], markersize=6)


VIEW = View(
    charts=charts,
    drawings={"mechanism": mechanism, "map": objective_map},
    design=lambda result: with_verdict(None if result.conflict else result.machine, result.best),
    frames=frames,
    result=SynthesisResult,
)
