"""Contour map of the objective over two design variables, with the optimum and the iterates."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from optlink.linkage.fourbar import LENGTHS
from optlink.optimization.constraints import rows as limit_rows
from optlink.optimization.output_derivatives import ErrorResiduals
from optlink.report.style import LIMIT, WANTED, heading, styled
from optlink.report.style import figure as new_figure
from optlink.solvers.contract import selectable
from optlink.tasks.function import FunctionResult

Array = NDArray[np.float64]
COLOURS = ("#e67e22", "#8e44ad", "#16a085", "#c0392b")  # of back ends, by their position in the registry
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit_of(result: FunctionResult) -> str:
    """Return the unit of the objective with typographic exponents."""
    return result.unit.replace("^2", "²")


@styled
def objective_map(result: FunctionResult) -> Figure | None:
    """Draw contours of the objective over two design variables, the feasible region, the iterates and the optimum."""
    problem, solution = result.problem.spec, result.solution
    if solution is None or len(problem.free) != 2:
        return None
    x_name, y_name = problem.free
    (x_low, x_high), (y_low, y_high) = (problem.quantities[name].bounds for name in problem.free)
    x, y = np.meshgrid(np.linspace(x_low, x_high, 241), np.linspace(y_low, y_high, 241))
    fixed = {name: quantity.value for name, quantity in problem.quantities.items()}
    flat: dict[str, Any] = {**fixed, x_name: x, y_name: y}
    with np.errstate(all="ignore"):
        objective = ErrorResiduals(problem).objective({**fixed, x_name: x[..., None], y_name: y[..., None]})
        inside = np.ones_like(x, dtype=bool)
        size = fixed["frame"]
        edges: list[tuple[str, Array]] = []
        for row in limit_rows(problem, flat, problem.reach(flat), size):
            value = np.broadcast_to(np.asarray(row.value, dtype=float), x.shape)
            slack = np.fmin(value - row.low, row.high - value)
            inside &= slack >= 0.0
            edges.append((row.label, slack))
    figure = new_figure(7.0, 5.8)
    axes = figure.subplots()
    scale_x, scale_y = (1e3 if name in LENGTHS else math.degrees(1.0) for name in problem.free)
    shown = np.where(np.isfinite(objective) & (objective > 0.0), objective, np.nan)
    furthest = math.pi if result.unit == "rad" else len(problem.law.offsets) * math.pi**2
    # limit to the largest possible angular error; near dead centres, first-order effects of tolerances would exceed it
    shown = np.minimum(shown, furthest)
    if not np.any(np.isfinite(shown)):
        return None
    low, high = max(float(np.nanmin(shown)), 1e-12), float(np.nanmax(shown))
    levels = np.geomspace(low * 1.0001, high, 22)
    filled = axes.contourf(x * scale_x, y * scale_y, np.log10(shown), levels=np.log10(levels), cmap="Blues_r", alpha=0.9)
    axes.contour(
        x * scale_x, y * scale_y, np.log10(shown), levels=np.log10(levels), colors="white", linewidths=0.4, linestyles="solid"
    )
    if inside.any() and not inside.all():
        outside = np.where(inside, np.nan, 1.0)
        axes.contourf(x * scale_x, y * scale_y, outside, levels=[0.5, 1.5], colors=["white"], alpha=0.62)
        worst = np.min([slack for _, slack in edges], axis=0)
        axes.contour(x * scale_x, y * scale_y, worst, levels=[0.0], colors=[LIMIT], linewidths=1.5)
        axes.plot([], [], color=LIMIT, linewidth=1.5, label="edge of the feasible region")
    _iterations(axes, result, scale_x, scale_y)
    at = (result.design[x_name] * scale_x, result.design[y_name] * scale_y)
    axes.plot(*at, "*", color="#f1c40f", markeredgecolor=WANTED, markersize=15, zorder=6, label="design")
    axes.set_xlim(x_low * scale_x, x_high * scale_x)
    axes.set_ylim(y_low * scale_y, y_high * scale_y)
    axes.grid(False)
    axes.set_xlabel(f"{x_name} [{'mm' if x_name in LENGTHS else 'deg'}]")
    axes.set_ylabel(f"{y_name} [{'mm' if y_name in LENGTHS else 'deg'}]")
    axes.legend(frameon=True, framealpha=0.9, fontsize=8.5, loc="upper right")
    bar = figure.colorbar(filled, ax=axes, pad=0.02)
    ticks = [t for t in range(math.floor(np.log10(low)), math.ceil(np.log10(high)) + 1) if np.log10(low) <= t <= np.log10(high)]
    bar.set_ticks(ticks, labels=[f"10{str(t).translate(RAISED)}" for t in ticks])
    bar.set_label(f"{result.measure} [{unit_of(result)}]")
    axes.set_title(heading(f"{problem.title}: {result.objective:.6g} at {at[0]:z.3f}, {at[1]:z.3f}", 6.8, 10.5), fontsize=10.5)
    return figure


def _iterations(axes: Axes, result: FunctionResult, scale_x: float, scale_y: float) -> None:
    colors = dict(zip(selectable(), itertools.cycle(COLOURS), strict=False))
    found = result.backends or ({result.backend: result.solution} if result.solution else {})
    sizes = [result.problem.spec.quantities["frame"].value if n in LENGTHS else 1.0 for n in result.problem.spec.free]
    for name, solution in found.items():
        if solution.path is not None and len(solution.path) > 1:
            path = solution.path[:, :2] * sizes * [scale_x, scale_y]
            axes.plot(path[:, 0], path[:, 1], "-o", markersize=3, linewidth=1.1, color=colors[name], label=f"{name}, iterations")
            axes.plot(*path[0], "s", color=colors[name], markersize=6)
