"""Pictures of a result: the mechanism in its telling positions, law and error, transmission angle, map of the objective, film."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon
from numpy.typing import NDArray
from PIL import Image

from optlink.linkage.fourbar import LENGTHS, dead_centre, lengths_of, reachable
from optlink.linkage.motion import Motion, sweep
from optlink.report.store import whole, write_json
from optlink.workflow import Result

Array = NDArray[np.float64]

CRANK, COUPLER, ROCKER, GROUND = "#c0392b", "#2c6fbb", "#2e8b57", "#444444"
QUIET, WANTED, FOUND, LIMIT = "#9a9a9a", "#111111", "#2c6fbb", "#c0392b"
HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]
STYLE: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
}


P = ParamSpec("P")
T = TypeVar("T")


def _styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Draw in the house's style, whatever the caller's is."""

    @functools.wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> T:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return styled


def write_all(result: Result, folder: Path) -> list[Path]:
    """Write result.json and every picture that the result has something for; return the files."""
    written = [folder / "result.json"]
    write_json(written[0], result.to_dict())
    for name, draw in PICTURES.items():
        figure = draw(result)
        if figure is not None:
            written.append(folder / f"{name}.png")
            with whole(written[-1]) as temporary, mpl.rc_context(STYLE):
                figure.savefig(temporary, dpi=150)
    film = frames(result)
    if film:
        written.append(folder / "motion.gif")
        with whole(written[-1]) as temporary:
            film[0].save(temporary, save_all=True, append_images=film[1:], duration=40, loop=0, optimize=False)
    return written


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _moved(result: Result, angles: Array) -> Motion:
    return sweep(result.problem.spec.linkage, result.sizes, angles)


def _range(result: Result) -> Array:
    """Crank angles [rad] of the whole motion: a revolution, or the reachable range that holds the start."""
    start = result.design["phi0"]
    for low, high in reachable(*lengths_of(result.sizes)):
        if high - low > 2.0 * np.pi - 1e-9:
            return np.linspace(0.0, 2.0 * np.pi, 721)
        for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi):
            if math.isfinite(start) and low + turn - 1e-9 <= start <= high + turn + 1e-9:
                return np.linspace(low + turn + 1e-6, high + turn - 1e-6, 721)
    return np.array([])


def _transmission(motion: Motion) -> Array:
    b, c, d = (motion.position(name) for name in "BCD")
    cosine = np.sum((b - c) * (d - c), axis=-1) / (np.linalg.norm(b - c, axis=-1) * np.linalg.norm(d - c, axis=-1))
    gamma: Array = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))  # for a drawing: beyond +-1 is rounding
    return gamma


# --- the mechanism ---------------------------------------------------------------------------------------------------


def _ground(axes: Axes, x: float, y: float, size: float) -> None:
    """A pivot on the ground: triangle and hatching."""
    corners = np.array([[0.0, 0.0], [-0.55, -1.0], [0.55, -1.0]]) * size + [x, y]
    axes.add_patch(Polygon(corners, closed=True, facecolor="white", edgecolor=GROUND, linewidth=1.1, zorder=2))
    axes.plot([x - 0.9 * size, x + 0.9 * size], [y - size, y - size], color=GROUND, linewidth=1.1, zorder=2)
    for k in np.linspace(-0.8, 0.7, 6):
        axes.plot([x + k * size, x + (k - 0.25) * size], [y - size, y - 1.35 * size], color=GROUND, linewidth=0.8, zorder=2)


def _pose(axes: Axes, motion: Motion) -> None:
    """One position of the four-bar, in mm."""
    a, b, c, d = (motion.position(name)[0] * 1e3 for name in "ABCD")
    size = 0.035 * motion.sizes["frame"] * 1e3
    for (p, q), color, width in (((b, c), COUPLER, 3.0), ((d, c), ROCKER, 3.0), ((a, b), CRANK, 3.8)):
        axes.plot([p[0], q[0]], [p[1], q[1]], color=color, linewidth=width, solid_capstyle="round", zorder=3)
    for point in (a, d):
        _ground(axes, point[0], point[1], size * 1.3)
    for name, point in zip("ABCD", (a, b, c, d), strict=True):
        axes.plot(*point, "o", markersize=5.5, markerfacecolor="white", markeredgecolor=GROUND, zorder=4)
        shift = {"B": _outside(b, a, c), "C": _outside(c, b, d)}.get(name, np.array([1.9, -0.9]))
        x, y = point + shift * size
        axes.text(x, y, name, color=GROUND, fontsize=9, zorder=5, ha="center", va="center", path_effects=HALO)


def _outside(joint: Array, p: Array, q: Array) -> Array:
    """Where a letter stands clear of the two links that meet at a joint: opposite to their bisector."""
    to_p, to_q = ((other - joint) / max(float(np.linalg.norm(other - joint)), 1e-12) for other in (p, q))
    bisector = to_p + to_q
    size = float(np.linalg.norm(bisector))
    away: Array = np.array([-to_p[1], to_p[0]]) if size < 0.2 else -bisector / size
    return 1.5 * away


def _frame(axes: Axes, motion: Motion) -> None:
    """Paths of crank pin and rocker end, equal scales and room around them."""
    points = np.concatenate([motion.position(name) for name in "ABCD"]) * 1e3
    for name, color in (("B", CRANK), ("C", ROCKER)):
        path = motion.position(name) * 1e3
        axes.plot(path[:, 0], path[:, 1], color=color, linewidth=0.9, alpha=0.45, zorder=1)
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    margin = 0.09 * max(high - low)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - 1.25 * margin, high[1] + margin)
    axes.set_aspect("equal")


def positions(result: Result) -> dict[str, float]:
    """The telling crank angles [rad] by name: start and end of the requirement, dead centres, transmission extremes."""
    problem, sizes = result.problem.spec, result.sizes
    found: dict[str, float] = {"start": result.design["phi0"], "end of the span": result.design["phi0"] + problem.span}
    whole_turn = [(low, high) for low, high in reachable(*lengths_of(sizes)) if high - low > 2.0 * np.pi - 1e-9]
    if whole_turn:
        for name, outer in (("outer dead centre", True), ("inner dead centre", False)):
            limit = dead_centre(*lengths_of(sizes), problem.side, outer=outer)
            if limit.margin >= 0.0:
                found[name] = float(limit.phi)
        found["smallest transmission angle"], found["largest transmission angle"] = 0.0, math.pi
    merged: dict[str, float] = {}
    for name, phi in found.items():
        same = next((k for k, v in merged.items() if abs(math.remainder(v - phi, 2.0 * math.pi)) < 1e-9), None)
        if same is None:
            merged[name] = phi
        else:
            merged = {f"{k} = {name}" if k == same else k: v for k, v in merged.items()}
    return merged


@_styled
def mechanism(result: Result) -> Figure | None:
    """The mechanism in its telling positions, side by side on one scale."""
    angles = _range(result)
    if angles.size == 0:
        return None
    motion = _moved(result, angles)
    named = positions(result)
    columns = 3 if len(named) > 4 else 2 if len(named) > 1 else 1
    rows = -(-len(named) // columns)
    spread = np.ptp(np.concatenate([motion.position(name) for name in "ABCD"]), axis=0)
    ratio = float(np.clip((spread[1] + 0.1) / (spread[0] + 0.1), 0.45, 1.3))
    figure = _figure(3.9 * columns, (3.3 * ratio + 0.95) * rows + 0.55)
    for axes, (name, phi) in zip(figure.subplots(rows, columns, squeeze=False).flat, named.items(), strict=False):
        here = _moved(result, np.array([phi]))
        _frame(axes, motion)
        _pose(axes, here)
        gamma = float(_transmission(here)[0])
        psi = math.degrees(float(here.body_angle("rocker").value[0]))
        axes.set_title(f"{name}\nφ {math.degrees(phi) % 360.0:.2f}°   ψ {psi:.2f}°   γ {gamma:.2f}°", fontsize=9.5)
        axes.set_xlabel("x [mm]")
        axes.set_ylabel("y [mm]")
    for axes in figure.axes[len(named) :]:
        axes.remove()
    lengths = "   ".join(f"{name} {value * 1e3:.3f}" for name, value in result.sizes.items())
    figure.suptitle(f"{result.problem.spec.title}\n{lengths} mm", fontsize=11)
    return figure


# --- what it does ----------------------------------------------------------------------------------------------------


@_styled
def law(result: Result) -> Figure | None:
    """Wanted and generated law over the span, the error below, the design positions marked."""
    problem, design = result.problem.spec, result.design
    offsets = problem.span * np.linspace(0.0, 1.0, 361)
    at = problem.law.offsets
    if not math.isfinite(design["phi0"]):
        return None
    crank = math.degrees(design["phi0"]) + np.degrees(offsets)
    wanted = np.degrees(problem.law.curve(offsets, design["phi0"], design["psi0"]))
    shift = 360.0 * np.round((wanted[0] - (found := _rocker(result, offsets))[0]) / 360.0)
    found = found + shift
    if not np.any(np.isfinite(found)):
        return None
    marks = np.degrees(problem.law.curve(at, design["phi0"], design["psi0"]))
    error, at_marks = np.degrees(result.error(offsets)), np.degrees(result.error())
    figure = _figure(7.2, 5.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    top.plot(crank, wanted, color=WANTED, linewidth=1.4, linestyle="--", label="wanted")
    top.plot(crank, found, color=FOUND, linewidth=1.8, label="generated")
    top.plot(math.degrees(design["phi0"]) + np.degrees(at), marks, ".", color=WANTED, markersize=4, label="design positions")
    top.set_ylabel("rocker angle ψ [deg]")
    top.legend(frameon=False, loc="best")
    worst = int(np.nanargmax(np.abs(error)))
    bottom.axhline(0.0, color=WANTED, linewidth=0.8)
    bottom.plot(crank, error, color=LIMIT, linewidth=1.5)
    bottom.plot(math.degrees(design["phi0"]) + np.degrees(at), at_marks, ".", color=LIMIT, markersize=4)
    room = 0.35 * float(np.nanmax(np.abs(error)))
    bottom.set_ylim(float(np.nanmin(error)) - room, float(np.nanmax(error)) + room)
    left = crank[worst] > 0.5 * (crank[0] + crank[-1])
    bottom.annotate(
        f"largest {error[worst]:+.3f}°",
        (crank[worst], error[worst]),
        xytext=(-8 if left else 8, 6 if error[worst] > 0 else -6),
        textcoords="offset points",
        ha="right" if left else "left",
        va="bottom" if error[worst] > 0 else "top",
        fontsize=9,
    )
    bottom.set_ylabel("error [deg]")
    bottom.set_xlabel("crank angle φ [deg]")
    top.set_title(f"{problem.title}: {result.measure} {result.objective:.6g} {_unit(result)}", fontsize=10.5)
    return figure


def _rocker(result: Result, offsets: Array) -> Array:
    psi: Array = np.degrees(np.asarray(_moved(result, result.design["phi0"] + offsets).body_angle("rocker").value))
    return psi


def _unit(result: Result) -> str:
    return result.unit.replace("^2", "²")


@_styled
def transmission(result: Result) -> Figure | None:
    """Transmission angle over the whole motion with its limits."""
    problem, angles = result.problem.spec, _range(result)
    if angles.size == 0:
        return None
    gamma, crank = _transmission(_moved(result, angles)), np.degrees(angles)
    figure = _figure(7.2, 3.8)
    axes = figure.subplots()
    start = math.degrees(result.design["phi0"])
    span = math.degrees(problem.span)
    for turn in (-360.0, 0.0, 360.0):
        low, high = sorted((start + turn, start + turn + span))
        low, high = max(low, crank[0]), min(high, crank[-1])
        if low < high:
            axes.axvspan(
                low, high, color=FOUND, alpha=0.08, linewidth=0, label="span of the requirement" if turn == 0.0 else None
            )
    axes.plot(crank, gamma, color=FOUND, linewidth=1.9, label="transmission angle γ")
    for bound, low in _transmission_limits(result):
        ends = (crank[0], crank[-1]) if problem.transmission_over == "revolution" else tuple(sorted((start, start + span)))
        axes.plot(ends, (bound, bound), color=LIMIT, linewidth=1.3, linestyle="--")
        text = f"{'at least' if low else 'at most'} {bound:.5g}°"
        label = axes.annotate(text, (ends[1], bound), (-4, -4 if low else 4), textcoords="offset points", ha="right", fontsize=9)
        label.set(color=LIMIT, path_effects=HALO, va="top" if low else "bottom")
    for index, word, place in ((int(np.argmin(gamma)), "least", -5), (int(np.argmax(gamma)), "largest", 5)):
        axes.plot(crank[index], gamma[index], "o", color=FOUND, markersize=4.5)
        axes.annotate(
            f"{word} {gamma[index]:.2f}°",
            (crank[index], gamma[index]),
            xytext=(9 if crank[index] < crank[-1] - 60 else -9, place * 1.2),
            textcoords="offset points",
            ha="left" if crank[index] < crank[-1] - 60 else "right",
            va="top" if place < 0 else "bottom",
            fontsize=9,
        )
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.12 * (high - low), high + 0.12 * (high - low))
    axes.set_xlim(crank[0], crank[-1])
    axes.set_xlabel("crank angle φ [deg]")
    axes.set_ylabel("γ [deg]")
    axes.set_title(f"{problem.title}: transmission angle", fontsize=10.5)
    figure.legend(frameon=False, fontsize=8.5, loc="outside lower center", ncols=2)
    return figure


def _transmission_limits(result: Result) -> list[tuple[float, bool]]:
    limits = result.problem.spec.limits
    if limits.transmission_angle is not None:
        both = (limits.transmission_angle.low, limits.transmission_angle.high)
    elif limits.transmission_cosine is not None:
        low, high = limits.transmission_cosine.low, limits.transmission_cosine.high
        both = (None if high is None else math.acos(high), None if low is None else math.acos(low))
    else:
        return []
    return [(math.degrees(bound), k == 0) for k, bound in enumerate(both) if bound is not None]


# --- where the optimum lies ------------------------------------------------------------------------------------------


@_styled
def objective_map(result: Result) -> Figure | None:
    """Contours of the objective over two free quantities, the feasible region, the iterations and the optimum."""
    problem, solution = result.problem.spec, result.solution
    if solution is None or len(problem.free) != 2:
        return None
    from optlink.design.constraints import rows as limit_rows
    from optlink.design.objectives import MEASURES, output_error

    x_name, y_name = problem.free
    (x_low, x_high), (y_low, y_high) = (problem.quantities[name].bounds for name in problem.free)
    x, y = np.meshgrid(np.linspace(x_low, x_high, 241), np.linspace(y_low, y_high, 241))
    fixed = {name: quantity.value for name, quantity in problem.quantities.items()}
    values: dict[str, Any] = {**fixed, x_name: x[..., None], y_name: y[..., None]}
    flat: dict[str, Any] = {**fixed, x_name: x, y_name: y}
    law = problem.law
    with np.errstate(all="ignore"):
        error = output_error(problem, values, problem.start_position(values), law.offsets, law.tabulated)
        if problem.requirement.measure == "max":
            objective = np.max(np.abs(error), axis=-1)
        else:
            objective = np.sum(error * error, axis=-1)
            if problem.requirement.measure == "rms":
                objective = np.sqrt(objective / error.shape[-1])
        inside = np.ones_like(x, dtype=bool)
        size = fixed["frame"]
        edges: list[tuple[str, Array]] = []
        for row in limit_rows(problem, flat, problem.start_position(flat), size):
            value = np.broadcast_to(np.asarray(row.value, dtype=float), x.shape)
            slack = np.fmin(value - row.low, row.high - value)
            inside &= slack >= 0.0
            edges.append((row.label, slack))
    assert MEASURES[problem.requirement.measure]
    figure = _figure(7.0, 5.8)
    axes = figure.subplots()
    scale_x, scale_y = (1e3 if name in LENGTHS else math.degrees(1.0) for name in problem.free)
    shown = np.where(np.isfinite(objective) & (objective > 0.0), objective, np.nan)
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
    bar.set_ticks(ticks, labels=[f"$10^{{{t}}}$" for t in ticks])
    bar.set_label(f"{result.measure} [{_unit(result)}]")
    axes.set_title(f"{problem.title}: {result.objective:.6g} at {at[0]:.3f}, {at[1]:.3f}", fontsize=10.5)
    return figure


def _iterations(axes: Axes, result: Result, scale_x: float, scale_y: float) -> None:
    colors = {"slsqp": "#e67e22", "ipopt": "#8e44ad"}
    found = result.backends or ({result.backend: result.solution} if result.solution else {})
    sizes = [result.problem.spec.quantities["frame"].value if n in LENGTHS else 1.0 for n in result.problem.spec.free]
    for name, solution in found.items():
        if solution.path is not None and len(solution.path) > 1:
            path = solution.path[:, :2] * sizes * [scale_x, scale_y]
            axes.plot(path[:, 0], path[:, 1], "-o", markersize=3, linewidth=1.1, color=colors[name], label=f"{name}, iterations")
            axes.plot(*path[0], "s", color=colors[name], markersize=6)


# --- film ------------------------------------------------------------------------------------------------------------


@_styled
def frames(result: Result, count: int = 90) -> list[Image.Image]:
    """One revolution (or there and back through the reachable range), with the rocker angle beside it, as pictures."""
    angles = _range(result)
    if angles.size == 0:
        return []
    full = angles[-1] - angles[0] > 2.0 * np.pi - 1e-6
    motion = _moved(result, angles)
    middle, half = 0.5 * (angles[0] + angles[-1]), 0.5 * (angles[-1] - angles[0])
    phase = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    steps = result.design["phi0"] + phase if full else middle - half * np.cos(phase)
    points = {name: _moved(result, steps).position(name) * 1e3 for name in "ABCD"}
    psi, crank = np.degrees(np.asarray(motion.body_angle("rocker").value)), np.degrees(angles)

    figure = _figure(8.4, 3.9)
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(80)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _frame(left, motion)
    size = 0.045 * motion.sizes["frame"] * 1e3
    for name in "AD":
        x, y = points[name][0]
        _ground(left, float(x), float(y), size)
    bars = [
        left.plot(
            [], [], color=color, linewidth=width, solid_capstyle="round", marker="o", markersize=6, mfc="white", mec=GROUND
        )[0]
        for color, width in ((COUPLER, 3.0), (ROCKER, 3.0), (CRANK, 3.8))
    ]
    left.set_xlabel("x [mm]")
    left.set_ylabel("y [mm]")
    begin, span = math.degrees(result.design["phi0"]), math.degrees(result.problem.spec.span)
    radius = 1.1 * result.design["crank"] * 1e3
    ends = {"theta1": min(begin, begin + span), "theta2": max(begin, begin + span)}
    left.add_patch(Arc((0.0, 0.0), radius, radius, color=QUIET, linewidth=1.3, **ends))
    right.plot(crank, psi, color=ROCKER, linewidth=1.6)
    dot = right.plot([], [], "o", color=CRANK, markersize=7)[0]
    right.set_xlabel("crank angle φ [deg]")
    right.set_ylabel("rocker angle ψ [deg]")
    right.set_xlim(crank[0], crank[-1])
    figure.suptitle(result.problem.spec.title, fontsize=10)
    moving = [*bars, dot]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()  # type: ignore[no-untyped-call] # all that stands still is drawn once
    still = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    pictures: list[Image.Image] = []
    for k, step in enumerate(steps):
        for bar, pair in zip(bars, ("BC", "DC", "AB"), strict=True):
            bar.set_data(*np.array([points[name][k] for name in pair]).T)
        phi = math.degrees(step)
        phi = (phi - crank[0]) % 360.0 + crank[0] if full else phi
        dot.set_data([phi], [float(np.interp(phi, crank, psi))])
        canvas.restore_region(still)  # type: ignore[no-untyped-call]
        for artist in moving:
            (left if artist is not dot else right).draw_artist(artist)
        drawn = canvas.buffer_rgba()  # type: ignore[no-untyped-call]
        picture = Image.fromarray(np.asarray(drawn)[..., :3].copy())
        pictures.append(picture.quantize(palette=pictures[0]) if pictures else picture.quantize(128))
    return pictures


PICTURES: dict[str, Callable[[Result], Figure | None]] = {
    "mechanism": mechanism,
    "law": law,
    "transmission": transmission,
    "map": objective_map,
}
