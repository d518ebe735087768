"""Figures and animation of a function synthesis result: mechanism, error, transmission angle, objective map."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc
from numpy.typing import NDArray
from PIL import Image

from optlink.linkage.fourbar import dead_centre, lengths_of, reachable
from optlink.linkage.motion import Motion, sweep
from optlink.optimization.output_derivatives import ErrorResiduals
from optlink.report.animation import film, there_and_back
from optlink.report.drawing import Sketch
from optlink.report.files import verdict, write_design, write_json
from optlink.report.labels import place_labels
from optlink.report.report_model import machine_found
from optlink.report.style import (
    COUPLER,
    CRANK,
    FOUND,
    GROUND,
    HALO,
    LIMIT,
    QUIET,
    ROCKER,
    STYLE,
    WANTED,
    heading,
    save,
    save_film,
    styled,
)
from optlink.report.style import figure as new_figure
from optlink.report.views.function_landscape import objective_map, unit_of
from optlink.report.views.path_captions import failed
from optlink.tasks.function import FunctionResult

Array = NDArray[np.float64]
__all__ = [
    "COUPLER",
    "CRANK",
    "FOUND",
    "GROUND",
    "LIMIT",
    "ROCKER",
    "STYLE",
    "WANTED",
    "frames",
    "law",
    "mechanism",
    "objective_map",
    "positions",
    "transmission",
    "write_all",
]


def write_all(result: FunctionResult, folder: Path) -> list[Path]:
    """Write result.json, the linkage as design.toml, the applicable figures and the animation; return the paths.

    Parameters
    ----------
    result : FunctionResult
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json"]
    write_json(written[0], result.to_dict())
    machine = None if result.conflict else machine_found(result)
    if machine is not None:
        written += write_design(folder, machine, verdict(result.status.value, result.valid, failed(result)))
    for name, draw in PICTURES.items():
        figure = draw(result)
        if figure is not None:
            written.append(folder / f"{name}.png")
            save(figure, written[-1])
    pictures = frames(result)
    if pictures:
        written.append(folder / "motion.gif")
        save_film(pictures, written[-1])
    return written


def _moved(result: FunctionResult, angles: Array) -> Motion:
    return sweep(result.problem.spec.linkage, result.problem.spec.sizes(result.design), angles)


def _range(result: FunctionResult) -> Array:
    """Return crank angles [rad] of a revolution, or of the reachable range that contains the starting angle."""
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
    gamma: Array = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))  # clipped, since values beyond +-1 are rounding errors
    return gamma


# --- mechanism -------------------------------------------------------------------------------------------------------


def positions(result: FunctionResult) -> dict[str, float]:
    """Return the characteristic crank angles [rad] by name: start and end of the span, dead centres, transmission extremes."""
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


@styled
def mechanism(result: FunctionResult) -> Figure | None:
    """Draw the mechanism at its characteristic positions side by side, on one scale."""
    angles = _range(result)
    if angles.size == 0:
        return None
    sketch = Sketch(_moved(result, angles))
    named = positions(result)
    columns = 3 if len(named) > 4 else 2 if len(named) > 1 else 1
    rows = -(-len(named) // columns)
    figure = new_figure(3.9 * columns, (3.3 * min(max(sketch.ratio, 0.45), 1.3) + 0.95) * rows + 0.55)
    letters = []
    for axes, (name, phi) in zip(figure.subplots(rows, columns, squeeze=False).flat, named.items(), strict=False):
        here = _moved(result, np.array([phi]))
        sketch.stage(axes)
        sketch.pose(axes, here)
        letters += sketch.letters(axes, here)
        gamma = float(_transmission(here)[0])
        psi = math.degrees(float(here.body_angle("rocker").value[0]))
        axes.set_title(f"{name}\nφ {math.degrees(phi) % 360.0:.2f}°   ψ {psi:.2f}°   γ {gamma:.2f}°", fontsize=9.5)
    for axes in figure.axes[len(named) :]:
        axes.remove()
    lengths = "   ".join(f"{name} {value * sketch.scale.factor:.3f}" for name, value in result.sizes.items())
    title = heading(result.problem.spec.title, 3.9 * columns)
    figure.suptitle(f"{title}\n{heading(f'{lengths} {sketch.scale.unit}', 3.9 * columns)}", fontsize=11)
    place_labels(figure, letters)
    return figure


# --- output ----------------------------------------------------------------------------------------------------------


@styled
def law(result: FunctionResult) -> Figure | None:
    """Draw the prescribed and the generated function over the span, with the precision points, and the error below."""
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
    figure = new_figure(7.2, 5.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    top.plot(crank, wanted, color=WANTED, linewidth=1.4, linestyle="--", label="wanted")
    top.plot(crank, found, color=FOUND, linewidth=1.8, label="generated")
    top.plot(math.degrees(design["phi0"]) + np.degrees(at), marks, ".", color=WANTED, markersize=4, label="design positions")
    top.set_ylabel("rocker angle ψ [deg]")
    top.legend(frameon=False, loc="best")
    worst = int(np.nanargmax(np.abs(error)))
    bottom.axhline(0.0, color=WANTED, linewidth=0.8)
    low, high, beside = float(np.nanmin(error)), float(np.nanmax(error)), float(error[worst])
    robust = problem.requirement.robust
    if robust is not None:
        built = np.degrees(ErrorResiduals(problem).band(design, offsets))
        bottom.fill_between(crank, *built, color=LIMIT, alpha=0.15, linewidth=0, label=f"built, {robust.band}")
        low, high, beside = float(np.nanmin(built)), float(np.nanmax(built)), float(built[int(error[worst] > 0.0), worst])
    bottom.plot(crank, error, color=LIMIT, linewidth=1.5, label="as drawn")
    bottom.plot(math.degrees(design["phi0"]) + np.degrees(at), at_marks, ".", color=LIMIT, markersize=4)
    room = (0.35 if robust is None else 0.45) * max(abs(low), abs(high))
    bottom.set_ylim(low - room, high + room)
    if robust is not None:
        bottom.legend(frameon=False, loc="best", fontsize=8.5, ncols=2)
    left = crank[worst] > 0.5 * (crank[0] + crank[-1])
    bottom.annotate(
        f"largest {error[worst]:+.3f}°{'' if robust is None else ' as drawn'}",
        (crank[worst], beside),
        xytext=(-8 if left else 8, 6 if error[worst] > 0 else -6),
        textcoords="offset points",
        ha="right" if left else "left",
        va="bottom" if error[worst] > 0 else "top",
        fontsize=9,
    )
    bottom.set_ylabel("error [deg]")
    bottom.set_xlabel("crank angle φ [deg]")
    title = f"{problem.title}: {result.measure} {result.objective:.6g} {unit_of(result)}"
    top.set_title(heading(title, 6.8, 10.5), fontsize=10.5)
    return figure


def _rocker(result: FunctionResult, offsets: Array) -> Array:
    psi: Array = np.degrees(np.asarray(_moved(result, result.design["phi0"] + offsets).body_angle("rocker").value))
    return psi


@styled
def transmission(result: FunctionResult) -> Figure | None:
    """Draw the transmission angle over the whole motion with its limits."""
    problem, angles = result.problem.spec, _range(result)
    if angles.size == 0:
        return None
    gamma, crank = _transmission(_moved(result, angles)), np.degrees(angles)
    figure = new_figure(7.2, 3.8)
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
    for bound, low in transmission_limits(result):
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
    axes.set_title(heading(f"{problem.title}: transmission angle", 6.8, 10.5), fontsize=10.5)
    figure.legend(frameon=False, fontsize=8.5, loc="outside lower center", ncols=2)
    return figure


def transmission_limits(result: FunctionResult) -> list[tuple[float, bool]]:
    """Return the limits of the transmission angle [deg], each with whether it is the lower one."""
    limits = result.problem.spec.limits
    if limits.transmission_angle is not None:
        both = (limits.transmission_angle.low, limits.transmission_angle.high)
    elif limits.transmission_cosine is not None:
        low, high = limits.transmission_cosine.low, limits.transmission_cosine.high
        both = (None if high is None else math.acos(high), None if low is None else math.acos(low))
    else:
        return []
    return [(math.degrees(bound), k == 0) for k, bound in enumerate(both) if bound is not None]


# --- animation -------------------------------------------------------------------------------------------------------


@styled
def frames(result: FunctionResult, count: int = 90) -> list[Image.Image]:
    """Draw the frames of the animation: one revolution, or back and forth over the reachable range.

    Beside the mechanism, the rocker angle is drawn.

    Parameters
    ----------
    result : FunctionResult
    count : int, optional
        Number of frames.
    """
    angles = _range(result)
    if angles.size == 0:
        return []
    full = angles[-1] - angles[0] > 2.0 * np.pi - 1e-6
    motion = _moved(result, angles)
    sketch = Sketch(motion)
    once = result.design["phi0"] + np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    steps = once if full else there_and_back(float(angles[0]), float(angles[-1]), count)
    psi, crank = np.degrees(np.asarray(motion.body_angle("rocker").value)), np.degrees(angles)
    at = (np.degrees(steps) - crank[0]) % 360.0 + crank[0] if full else np.degrees(steps)
    begin, span = math.degrees(result.design["phi0"]), math.degrees(result.problem.spec.span)

    def curve(axes: Axes) -> None:
        axes.plot(crank, psi, color=ROCKER, linewidth=1.6)
        axes.set(xlabel="crank angle φ [deg]", ylabel="rocker angle ψ [deg]", xlim=(crank[0], crank[-1]))

    def required(axes: Axes) -> None:
        ends = {"theta1": min(begin, begin + span), "theta2": max(begin, begin + span)}
        size = 1.1 * result.design["crank"] * sketch.scale.factor
        axes.add_patch(Arc((0.0, 0.0), size, size, color=QUIET, linewidth=1.3, **ends))

    marks = np.stack([at, np.interp(at, crank, psi)], axis=-1)
    return film(sketch, _moved(result, steps), curve, marks, result.problem.spec.title, more=required)


PICTURES: dict[str, Callable[[FunctionResult], Figure | None]] = {
    "mechanism": mechanism,
    "law": law,
    "transmission": transmission,
    "map": objective_map,
}
