"""Figures of the driving torque, joint reactions, guide forces, work and shaking force of an analysis."""

from __future__ import annotations

import math
import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch
from numpy.typing import NDArray

from optlink.dynamics.inverse import shaking as shaken
from optlink.linkage import extrema
from optlink.report.labels import Label, place_labels
from optlink.report.style import (
    BODIES,
    COUPLER,
    CRANK,
    FOUND,
    QUIET,
    ROCKER,
    WANTED,
    Scale,
    degrees,
    figure,
    heading,
    scale,
    styled,
)
from optlink.report.views import analysis_curves
from optlink.report.views.analysis_curves import FONT, NOTHING, Course

Array = NDArray[np.float64]
TORQUE = "input.torque_Nm"
DASHES = ("-", "--", "-.")


@styled
def torque(course: Course) -> Figure | None:
    """Draw the driving torque, its inertia, gravity and load parts, and its mean, with extremes marked."""
    if not course.has(TORQUE):
        return None
    result = course.result
    unit = scale(course.peak(TORQUE), "N m")
    made = figure(7.6, 4.6)
    axes = made.subplots()
    parts = [name for name in ("inertia", "gravity", "load") if course.has(f"input.torque_{name}_Nm", [TORQUE])]
    lines = [analysis_curves.draw(axes, course, TORQUE, unit, CRANK, "driving torque", 2.6)]
    words = {"load": "loads and friction" if result.machine.friction else "loads"}
    for part, colour in zip(parts if len(parts) > 1 else [], (COUPLER, ROCKER, BODIES[2]), strict=False):
        lines.append(
            analysis_curves.draw(axes, course, f"input.torque_{part}_Nm", unit, colour, f"for {words.get(part, part)}", 1.2)
        )
    held = analysis_curves.fit(axes, course, *lines)
    analysis_curves.zero(axes)
    title = f"{result.problem.model.title}: driving torque"
    mean = result.work / (course.end - course.start)
    if math.isfinite(mean):
        mean = mean if abs(mean) > NOTHING * course.peak(TORQUE) else 0.0
        axes.axhline(
            mean * unit.factor,
            color=WANTED,
            linewidth=1.1,
            linestyle="--",
            label=f"mean {unit.text(mean) if mean else 0}",
            gid="mean",
        )
    labels = analysis_curves.extremes(axes, course, TORQUE, unit)
    analysis_curves.crank_axis(axes, course)
    axes.set_ylabel(f"torque on {result.machine.mechanism.crank.body} [{unit.unit}]" + ("" if held else ", cut off"))
    axes.set_title(f"{heading(title, 7.0, 10.5)}\n{_speed(result.speed)}", fontsize=10.5)
    made.legend(frameon=False, fontsize=8.5, loc="outside lower center", ncols=5)
    place_labels(made, labels)
    return made


def _speed(speed: float) -> str:
    return f"{abs(speed):.5g} rad/s = {abs(speed) * 30.0 / math.pi:.5g} rpm{'' if speed > 0.0 else ', clockwise'}"


def joints(course: Course) -> dict[str, str]:
    """Return the column of the force magnitude of every joint reaction, by label."""
    found = {}
    for point, bodies in course.result.machine.mechanism.pins.items():
        if len(bodies) == 2:
            found[point] = f"{point}.f_N"
        else:
            found |= {f"{point} on {body}": f"{point}.{body}.f_N" for body in bodies}
    return found


@styled
def reactions(course: Course) -> Figure | None:
    """Draw the crank-pivot reaction over the crank angle and as a hodograph, and the magnitudes of all joint reactions."""
    amounts = joints(course)
    if not any(course.has(name) for name in amounts.values()):
        return None
    crank = course.result.machine.mechanism.crank
    pivot = next(name for name in (f"{crank.start}.f_N", f"{crank.start}.{crank.body}.f_N") if name in course.columns)
    x, y = pivot.replace(".f_N", ".fx_N"), pivot.replace(".f_N", ".fy_N")
    made = figure(11.0, 8.2)
    halves = made.subfigures(2, 1, height_ratios=(1.1, 1.0), squeeze=False)[:, 0]
    top, side = halves[0].subplots(1, 2, width_ratios=(1.25, 1.0))
    bottom = halves[1].subplots()
    unit = scale(course.peak(pivot), "N")
    lines = [
        analysis_curves.draw(top, course, name, unit, colour, axis)
        for name, colour, axis in ((x, FOUND, "in x"), (y, CRANK, "in y"))
    ]
    held = analysis_curves.fit(top, course, *lines)
    labels = analysis_curves.extremes(top, course, x, unit, FOUND) + analysis_curves.extremes(top, course, y, unit, CRANK)
    analysis_curves.zero(top)
    analysis_curves.crank_axis(top, course)
    told = course.result.meanings.get(x, "").removesuffix(" in x")
    top.set_ylabel(f"force [{unit.unit}]" + ("" if held else ", cut off"))
    top.set_title(heading(f"crank pivot {crank.start}: {told}", 5.6, 9.5), fontsize=9.5)
    top.legend(frameon=True, framealpha=0.85, edgecolor="none", fontsize=8.5, loc="best")
    labels += hodograph(side, course, x, y, unit)
    side.set_title("the same as a hodograph, crank angle marked", fontsize=9.5)
    unit = scale(course.peak(*amounts.values()), "N")
    shown = _together(course, {label: name for label, name in amounts.items() if course.has(name, list(amounts.values()))})
    lines = []
    for k, (label, name) in enumerate(shown.items()):
        colour = (CRANK, *BODIES)[k % (len(BODIES) + 1)]
        dashes = DASHES[k // (len(BODIES) + 1) % len(DASHES)]
        extreme = course.result.extremes.get(name)
        amount = f"{unit.text(extreme.largest)} at {degrees(extreme.largest_at)}" if extreme else ""
        amount = "without bound" if name in course.result.unbounded else amount
        told = f"{label}:  {amount}" if len(label) < 25 else f"{textwrap.fill(label, 40)}:\n{amount}"
        width = 2.5 - 1.3 * k / max(1, len(shown) - 1)  # overlapping curves stay visible
        lines.append(analysis_curves.draw(bottom, course, name, unit, colour, told, width, dashes))
    held = analysis_curves.fit(bottom, course, *lines, room=0.06)
    bottom.set_ylim(bottom=min(0.0, bottom.get_ylim()[0]) if bottom.get_ylim()[0] < 0.0 else 0.0)
    analysis_curves.crank_axis(bottom, course)
    bottom.set_ylabel(f"amount of force [{unit.unit}]" + ("" if held else ", cut off"))
    bottom.set_title("all joint reactions, with their largest amounts", fontsize=9.5)
    bottom.legend(frameon=False, fontsize=8.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
    made.suptitle(heading(f"{course.result.problem.model.title}: joint reactions", 10.5), fontsize=11)
    place_labels(made, labels)
    return made


def _together(course: Course, names: dict[str, str]) -> dict[str, str]:
    """Merge columns with identical values under one combined label."""
    found: dict[str, str] = {}
    for label, name in names.items():
        same = next(
            (k for k, v in found.items() if np.allclose(course[v], course[name], NOTHING, NOTHING * course.peak(v), True)), None
        )
        if same is None:
            found[label] = name
        else:
            found = {f"{k}, {label}" if k == same else k: v for k, v in found.items()}
    return found


def hodograph(axes: Axes, course: Course, x: str, y: str, unit: Scale) -> list[Label]:
    """Draw the hodograph of a force with equal scales; mark the origin, the direction of motion and round crank angles.

    Parameters
    ----------
    axes : Axes
    course : Course
    x : str
        Column of the x component [N].
    y : str
        Column of the y component [N].
    unit : Scale
        Display unit of both axes.
    """
    breaks = [k + 1 for k in course.breaks(x, y)]
    xs, ys = (np.insert(course[name] * unit.factor, breaks, np.nan) for name in (x, y))
    axes.plot(xs, ys, color=FOUND, linewidth=1.6, zorder=3, gid=f"hodograph {x}")
    for k in course.breaks(x, y):
        ends = [course[name][k : k + 2] * unit.factor for name in (x, y)]
        axes.plot(*ends, color=FOUND, linewidth=0.9, linestyle=":", zorder=2.5, gid="jump")
    axes.plot([0.0], [0.0], "+", color=WANTED, markersize=9, zorder=4)
    labels = []
    known = np.isfinite(xs) & np.isfinite(ys)
    step = 60.0 if course.result.full else 10.0 * max(1.0, math.ceil(abs(math.degrees(course.end - course.start)) / 60.0))
    low, high = sorted((math.degrees(course.start), math.degrees(course.end)))
    middle = np.array([np.mean(xs[known]), np.mean(ys[known])]) if known.any() else np.zeros(2)
    for turned in np.arange(math.ceil(low / step - 1e-9) * step, high - (1e-6 if course.result.full else -1e-9), step):
        at = (course.at(math.radians(turned), x) * unit.factor, course.at(math.radians(turned), y) * unit.factor)
        if np.all(np.isfinite(at)):
            axes.plot([at[0]], [at[1]], "o", color=FOUND, markersize=4, zorder=4)
            away = np.array(at) - middle
            prefer = away / max(float(np.linalg.norm(away)), 1e-30)
            labels.append(Label(axes, at, f"{turned % 360.0:.0f}°", FOUND, FONT, 2.5, (float(prefer[0]), float(prefer[1]))))
    _window(axes, course, xs[known], ys[known])
    _sense(axes, xs, ys, labels)
    axes.set_xlabel(f"force in x [{unit.unit}]")
    axes.set_ylabel(f"force in y [{unit.unit}]")
    return labels


def _window(axes: Axes, course: Course, xs: Array, ys: Array) -> None:
    """Set equal scales that contain the curve and the origin; forces that grow without bound are cut off."""
    ends = [(min(0.0, low), max(0.0, high)) for low, high in (course.window(xs), course.window(ys))]
    size = max(high - low for low, high in ends) or 1.0
    halves = [max(0.62 * (high - low), 0.25 * size) for low, high in ends]
    middles = [0.5 * (low + high) for low, high in ends]
    axes.set_xlim(middles[0] - halves[0], middles[0] + halves[0], auto=True)  # may be widened to fill the panel
    axes.set_ylim(middles[1] - halves[1], middles[1] + halves[1], auto=True)
    axes.set_aspect("equal", adjustable="datalim")


def _sense(axes: Axes, xs: Array, ys: Array, marks: list[Label]) -> None:
    """Draw an arrow head on the longest piece of the curve, away from the labels."""
    pieces = [np.stack([xs, ys], axis=-1)[piece] for piece in np.split(np.arange(len(xs)), np.flatnonzero(~np.isfinite(xs + ys)))]
    paths = [piece[np.isfinite(piece).all(axis=1)] for piece in pieces]
    lengths = [np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)) if len(path) > 1 else np.zeros(1) for path in paths]
    k = int(np.argmax([length[-1] for length in lengths]))
    if lengths[k][-1] <= 0.0:
        return
    places = np.searchsorted(lengths[k], np.linspace(0.2, 0.8, 13) * lengths[k][-1])
    near = np.array([label.at for label in marks] or [(0.0, 0.0)])
    free = [float(np.min(np.linalg.norm(near - paths[k][place], axis=1))) for place in places]
    p, q = (paths[k][places[int(np.argmax(free))] + i] for i in (0, 1))
    tip = p + (q - p) / max(float(np.linalg.norm(q - p)), 1e-300) * 1e-3 * float(np.ptp(axes.get_xlim()))
    ends = (float(p[0]), float(p[1])), (float(tip[0]), float(tip[1]))
    axes.add_patch(FancyArrowPatch(*ends, arrowstyle="-|>", mutation_scale=13.0, color=FOUND, shrinkA=0, shrinkB=0, zorder=4))


@styled
def guides(course: Course) -> Figure | None:
    """Draw the normal force, friction force and moment of every guide on its slider."""
    every = course.result.machine.mechanism.guides
    normals = [f"{guide.name}.normal_N" for guide in every]
    moments = [f"{guide.name}.moment_Nm" for guide in every]
    shown = [guide for guide in every if course.has(f"{guide.name}.normal_N", normals)]
    lever = max((course.peak(name) for name in normals), default=0.0) * _extent(course)
    turned = [name for name in moments if course.peak(name) > NOTHING * lever and course.peak(name) > 0.0]
    if not shown and not turned:
        return None
    rows = shown or [guide for guide in every if f"{guide.name}.moment_Nm" in turned]
    columns = 2 if turned else 1
    width = 7.4 * (1.0 if columns == 1 else 1.5)
    made = figure(width, 2.7 * len(rows) + 1.1)
    grid = made.subplots(len(rows), columns, squeeze=False, sharex=True)
    labels: list[Label] = []
    for place, (row, guide) in enumerate(zip(grid, rows, strict=True), 1):
        names = [f"{guide.name}.normal_N", f"{guide.name}.friction_N"]
        unit = scale(course.peak(*names), "N")
        lines = [analysis_curves.draw(row[0], course, names[0], unit, FOUND, "normal force")]
        if course.has(names[1]):
            lines.append(analysis_curves.draw(row[0], course, names[1], unit, BODIES[2], "friction", 1.3))
            row[0].legend(frameon=True, framealpha=0.85, edgecolor="none", fontsize=8.5, loc="best")
        held = analysis_curves.fit(row[0], course, *lines)
        labels += analysis_curves.extremes(row[0], course, names[0], unit)
        row[0].set_ylabel(f"normal force [{unit.unit}]" + ("" if held else ", cut off"))
        row[0].set_title(
            heading(f"guide {guide.name}: {guide.on} on {guide.slider}, to the left of the line", 6.5, 9.5), fontsize=9.5
        )
        if columns == 2:
            name = f"{guide.name}.moment_Nm"
            if name in turned:
                unit = scale(course.peak(name), "N m")
                held = analysis_curves.fit(row[1], course, analysis_curves.draw(row[1], course, name, unit, BODIES[3]))
                labels += analysis_curves.extremes(row[1], course, name, unit)
                row[1].set_ylabel(f"moment [{unit.unit}]" + ("" if held else ", cut off"))
                row[1].set_title(heading(f"guide {guide.name}: moment on {guide.slider}", 4.5, 9.5), fontsize=9.5)
            else:
                row[1].set_axis_off()
        for axes in row:
            analysis_curves.zero(axes)
            analysis_curves.crank_axis(axes, course, named=place == len(rows))
    made.suptitle(heading(f"{course.result.problem.model.title}: guide forces", width), fontsize=11)
    place_labels(made, labels)
    return made


def _extent(course: Course) -> float:
    """Return a characteristic length of the machine [m]."""
    return max((course.peak(name) for name in course.columns if name.endswith((".x_m", ".y_m"))), default=1.0)


@styled
def work(course: Course) -> Figure | None:
    """Draw the work of the drive since the start with its extremes, and below it the kinetic and potential energy."""
    name, energies = "input.work_J", ("energy.kinetic_J", "energy.potential_J")
    if not course.has(name):
        return None
    stored = [energy for energy in energies if course.has(energy, energies)]
    made = figure(7.4, 6.0 if stored else 3.8)
    axes = made.subplots(2 if stored else 1, 1, squeeze=False, sharex=True)[:, 0]
    unit = scale(course.peak(name), "J")
    held = analysis_curves.fit(axes[0], course, analysis_curves.draw(axes[0], course, name, unit, FOUND, width=1.9))
    analysis_curves.zero(axes[0])
    labels = analysis_curves.extremes(axes[0], course, name, unit)
    axes[0].set_ylabel(f"work of the drive [{unit.unit}]" + ("" if held else ", cut off"))
    total = course.result.work if abs(course.result.work) > NOTHING * course.peak(name) else 0.0
    over = course.result.extent
    title = heading(f"{course.result.problem.model.title}: work of the drive", 7.0, 10.5)
    told = f"{title}\n{unit.text(total) if total else '0 J'} {over}"
    axes[0].set_title(told if math.isfinite(total) else title, fontsize=10.5)
    if stored:
        unit = scale(course.peak(*stored), "J")
        words = {energies[0]: ("kinetic", CRANK), energies[1]: ("potential", ROCKER)}
        lines = [analysis_curves.draw(axes[1], course, e, unit, words[e][1], words[e][0], 1.5) for e in stored]
        if len(stored) == 2:
            both = (course[energies[0]] + course[energies[1]]) * unit.factor
            lines += axes[1].plot(course.degrees, both, color=QUIET, linewidth=1.2, linestyle="--", label="both", gid="energy")
        analysis_curves.fit(axes[1], course, *lines, room=0.1)
        analysis_curves.zero(axes[1])
        axes[1].set_ylabel(f"energy [{unit.unit}]")
        made.legend(frameon=False, fontsize=8.5, loc="outside lower center", ncols=3)
    for one in axes:
        analysis_curves.crank_axis(one, course, named=one is axes[-1])
    place_labels(made, labels)
    return made


@styled
def shaking(course: Course) -> Figure | None:
    """Draw the hodograph of the shaking force and the shaking moment about the crank pivot."""
    x, y, moment = "frame.shaking_fx_N", "frame.shaking_fy_N", "frame.shaking_moment_Nm"
    forced = any(course.has(name, [x, y, *joints(course).values()]) for name in (x, y))
    if not forced and not course.has(moment):
        return None
    made = figure(10.6, 4.9)
    left, right = made.subplots(1, 2, width_ratios=(1.0, 1.25))
    labels: list[Label] = []
    if forced:
        unit = scale(course.peak(x, y), "N")
        labels += hodograph(left, course, x, y, unit)
        most = _largest_shaking(course)
        place = [most[0] * unit.factor], [most[1] * unit.factor]
        left.add_artist(Line2D(*place, marker="o", linestyle="none", color=CRANK, markersize=5, zorder=5, gid="largest"))
        left.set_title(f"shaking force, at most {unit.text(math.hypot(most[0], most[1]))} at {degrees(most[2])}", fontsize=9.5)
    else:
        left.set_axis_off()
        left.text(0.5, 0.5, "force-balanced: no shaking force", ha="center", va="center", transform=left.transAxes)
    unit = scale(course.peak(moment), "N m")
    held = analysis_curves.fit(right, course, analysis_curves.draw(right, course, moment, unit, BODIES[3]))
    analysis_curves.zero(right)
    labels += analysis_curves.extremes(right, course, moment, unit)
    analysis_curves.crank_axis(right, course)
    right.set_ylabel(f"moment [{unit.unit}]" + ("" if held else ", cut off"))
    right.set_title(f"shaking moment about the crank pivot {course.result.machine.mechanism.crank.start}", fontsize=9.5)
    made.suptitle(heading(f"{course.result.problem.model.title}: shaking force and moment", 10.2), fontsize=11)
    place_labels(made, labels)
    return made


def _largest_shaking(course: Course) -> tuple[float, float, float]:
    """Return the components [N] of the largest shaking force and its crank angle [rad]."""
    machine, speed = course.result.machine, course.result.speed

    def force(angles: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            wrench = shaken(machine.moving(angles, speed)).force
        return np.broadcast_to(np.asarray(wrench[0]), angles.shape), np.broadcast_to(np.asarray(wrench[1]), angles.shape)

    grid = np.unique(course.angles)
    at, _ = extrema.extremes(lambda angles: np.hypot(*force(angles))[None, :], grid)
    place = np.array([at[0, 1]])
    fx, fy = force(place)
    return float(fx[0]), float(fy[0]), float(place[0])
