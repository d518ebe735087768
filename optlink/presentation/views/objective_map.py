"""Map of the objective over two design variables, with the feasible region, the iterates of the solvers and the design."""

import itertools
import math
from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.presentation.chart_spec import LIMIT, TARGET
from optlink.presentation.format import dimension, pretty
from optlink.presentation.style import figure, heading, styled
from optlink.presentation.view import SomeDrawing
from optlink.presentation.views.design_tables import measure
from optlink.solvers.contract import selectable
from optlink.solvers.solution import Solution
from optlink.tasks.results.design import SynthesisResult

GRID = 121  # values of each design variable
COLOURS = ("#e67e22", "#8e44ad", "#16a085", "#c0392b")  # of back ends, by their position in the registry
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _two_unknowns(result: SynthesisResult) -> bool:
    best, solution = result.best, result.solution
    if best is None or solution is None or len(result.problem.model.free) != 2 or best.whole.composed:
        return False
    return sum(variable.name not in solution.nlp.helpers for variable in solution.nlp.variables) == 2


@partial(SomeDrawing, lambda result: _two_unknowns(result) and result)
@styled
def objective_map(result: SynthesisResult) -> Figure | None:
    """Draw contours of the objective over two design variables; None if it is nowhere positive on the grid."""
    best, solution, model = result.best, result.solution, result.problem.model
    assert best is not None
    assert solution is not None
    nlp, names = solution.nlp, list(model.free)
    bounds = [model.quantities[name].bounds for name in names]
    scales, units = zip(*map(model.display, names), strict=True)
    sides = [np.linspace(*ends, GRID) for ends in bounds]
    objective, least = _sampled(nlp, names, sides)
    factor, unit = model.objective_display[0], pretty(model.objective_display[1])
    shown = factor * np.where(np.isfinite(objective) & (objective > 0.0), objective, np.nan)
    if not np.any(np.isfinite(shown)):
        return None
    fig = figure(7.0, 5.8)
    axes = fig.subplots()
    low, high = max(np.nanmin(shown), 1e-12), np.nanmax(shown)
    levels, height = np.log10(np.geomspace(low * 1.0001, high, 22)), np.log10(shown)
    x, y = (side * scale for side, scale in zip(sides, scales, strict=True))
    filled = axes.contourf(x, y, height, levels=levels, cmap="Blues_r", alpha=0.9)
    axes.contour(x, y, height, levels=levels, colors="white", linewidths=0.4, linestyles="solid")
    if np.any(least >= 0.0) and not np.all(least >= 0.0):
        outside = np.nan_to_num(least, nan=-1.0)
        axes.contourf(x, y, outside, levels=[outside.min() - 1.0, 0.0], colors=["white"], alpha=0.62)
        axes.contour(x, y, least, levels=[0.0], colors=[LIMIT], linewidths=1.5)
        axes.plot([], [], color=LIMIT, linewidth=1.5, label="edge of the feasible region")
    _iterations(axes, result.backends or {result.backend: solution}, names, scales)
    at = [best.values[name] * scale for name, scale in zip(names, scales, strict=True)]
    axes.plot(*at, "*", color="#f1c40f", markeredgecolor=TARGET, markersize=15, zorder=6, label="design")
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), xlabel=f"{names[0]} [{units[0]}]", ylabel=f"{names[1]} [{units[1]}]")
    axes.grid(False)
    axes.legend(frameon=True, framealpha=0.9, fontsize=8.5, loc="upper right")
    bar = fig.colorbar(filled, ax=axes, pad=0.02)
    ticks = [t for t in range(math.floor(np.log10(low)), math.ceil(np.log10(high)) + 1) if np.log10(low) <= t <= np.log10(high)]
    bar.set_ticks(ticks, labels=[f"10{str(t).translate(SUPERSCRIPTS)}" for t in ticks])
    bar.set_label(f"{measure(best)} [{unit}]")
    place = ", ".join(f"{name} {dimension(value)} {unit}" for name, value, unit in zip(names, at, units, strict=True))
    reached = f"{measure(best)} {factor * best.objective:.6g} {unit}"
    axes.set_title(heading(f"{model.title}: {reached} at {place}", 6.8, 10.5), fontsize=10.5)
    return fig


def _sampled(nlp: NLP, names: list[str], sides: list[Array]) -> tuple[Array, Array]:
    """Return the objective [SI] and the least slack of the limits over a grid (second, first design variable).

    An angle differs by half a turn at most: near dead centres the effects of tolerances, of first order, would exceed that.
    """
    limits = [k for k, row in enumerate(nlp.rows) if row.limit not in nlp.helpers]
    most = math.pi if nlp.measure.unit.startswith("rad") else math.inf
    objective, least = np.full((2, len(sides[1]), len(sides[0])), np.nan)
    for i, j in np.ndindex(objective.shape):
        x = nlp.x_of({names[0]: float(sides[0][j]), names[1]: float(sides[1][i])})
        objective[i, j] = nlp.measure.of(np.clip(nlp.residuals(x), -most, most))
        g = nlp.values(x, nlp.p)[1][limits]
        least[i, j] = np.min(np.fmin(g - nlp.low[limits], nlp.high[limits] - g), initial=1.0)
    return objective, least


def _iterations(axes: Axes, solutions: Mapping[str, Solution], names: list[str], scales: tuple[float, ...]) -> None:
    """Draw the iterates of every solver."""
    colours = dict(zip(selectable(), itertools.cycle(COLOURS), strict=False))
    for name, solution in solutions.items():
        if solution.path is not None and len(solution.path) > 1:
            designs = [solution.nlp.design(x) for x in solution.path]
            path = np.array([[design[free] * scale for free, scale in zip(names, scales, strict=True)] for design in designs])
            label = f"{name}, iterations"
            axes.plot(*path.T, "-o", markersize=3, linewidth=1.1, color=colours.get(name), label=label)
            axes.plot(*path[0], "s", color=colours.get(name), markersize=6)
