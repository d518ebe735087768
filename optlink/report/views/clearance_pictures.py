"""Files and figures of a simulation with joint clearance: output deviation, driving torque, energy balance."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from optlink.dynamics.columns import MotionColumns
from optlink.report.files import write_csv, write_json
from optlink.report.style import (
    BODIES,
    CRANK,
    FOUND,
    LIMIT,
    QUIET,
    ROCKER,
    SHADE,
    WANTED,
    figure,
    save,
    save_film,
    scale,
    styled,
)
from optlink.report.views import journal_orbit, magnified_joints, poincare_map
from optlink.report.views.control_comparison_pictures import compensation, trials
from optlink.report.views.revolutions import (
    FULL,
    TITLE,
    TORQUE,
    WINDOW,
    Turns,
    crank_axis,
    from_zero,
    hold,
    legend,
    overlay,
    rough,
    time_axis,
    turn_axis,
    zero,
)
from optlink.tasks.control_comparison import Comparison
from optlink.tasks.results.clearance import ClearanceSimulation

Array = NDArray[np.float64]
MARKED = 60  # number of revolutions up to which each has a marker
ZOOM = 4.0  # ratio to the ideal torque beyond which a second panel enlarges the latter


def write_all(result: ClearanceSimulation, folder: Path) -> list[Path]:
    """Write result.json, play.csv (rows of the last revolutions), the applicable figures and the animation; return the paths.

    Parameters
    ----------
    result : ClearanceSimulation
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json"]
    write_json(written[0], result.to_dict())
    if result.columns:
        written.append(folder / "play.csv")
        write_csv(written[-1], result.columns)
    for name, draw in PICTURES.items():
        drawn = draw(result)
        if drawn is not None:
            written.append(folder / f"{name}.png")
            save(drawn, written[-1])
    pictures = magnified_joints.frames(result)
    if pictures:
        written.append(folder / "motion.gif")
        save_film(pictures, written[-1])
    return written


def write_comparison(found: Comparison, folder: Path) -> list[Path]:
    """Write result.json and the figures of a control comparison; return the paths.

    Parameters
    ----------
    found : Comparison
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json"]
    write_json(written[0], found.to_dict())
    for name, drawn in (("compensation", compensation(found.examples)), ("trials", trials(found))):
        if drawn is not None:
            written.append(folder / f"{name}.png")
            save(drawn, written[-1])
    return written


# --- output --------------------------------------------------------------------------------------------------------------


@styled
def displacement(result: ClearanceSimulation) -> Figure | None:
    """Draw the output with and without clearance and its deviation over the last revolutions, over time and crank angle."""
    turns = Turns(result)
    if not turns:
        return None
    made = figure(11.0, 6.0)
    value, error, rows, advance = turns.output, turns.error, turns.rows(WINDOW), turns.advance
    # over the crank angle, a fully rotating output is shown within one turn
    same: Literal["none", "row"] = "none" if advance else "row"
    grid = made.subplots(2, 2, sharex="col", sharey=same, height_ratios=(1.35, 1.0), width_ratios=(1.15, 1.0))
    unit = turns.shares(float(np.max(np.abs(value))))
    small = turns.shares(float(np.max(np.abs(error[turns.rows(turns.shown)]))))
    time, ideal = turns.time[rows] * turns.times(rows).factor, value - error
    grid[0, 0].plot(time, value[rows] * unit.factor, color=ROCKER, linewidth=1.7, label="with clearance", gid="output")
    grid[0, 0].plot(time, ideal[rows] * unit.factor, "--", color=WANTED, linewidth=1.1, label="ideal machine", gid="ideal")
    grid[1, 0].plot(time, error[rows] * small.factor, color=LIMIT, linewidth=1.3, gid="error")
    if advance:
        lowest = float(np.nanmin(turns.fold(value, turns.rows(1), advance)[1]))
        value, ideal = (part - 2.0 * math.pi * math.floor(lowest / (2.0 * math.pi) + 1e-6) for part in (value, ideal))
    overlay(grid[0, 1], turns, value, unit, ROCKER, advance=advance)
    x, y = turns.fold(ideal * unit.factor, turns.rows(1), advance * unit.factor)
    grid[0, 1].plot(x, y, "--", color=WANTED, linewidth=1.1, gid="ideal")
    overlay(grid[1, 1], turns, error, small, LIMIT)
    what = f"{result.output.name}: {'slide' if result.output.guide else 'angle'}"
    grid[0, 0].set_ylabel(f"{what} [{unit.unit}]")
    grid[1, 0].set_ylabel(f"deviation [{small.unit}]")
    for axes in grid[1]:
        hold(axes, error[turns.rows(max(turns.shown, WINDOW))] * small.factor)
    for k, row in enumerate(grid):
        time_axis(row[0], turns, rows, named=k == 1)
        crank_axis(row[1], turns, named=k == 1)
    for axes in grid[1]:
        zero(axes)
    grid[0, 0].set_title(turns.span(WINDOW), fontsize=9.5)
    more = f"{turns.span(turns.shown)}, the last one bold" if turns.shown > 1 else turns.span(1)
    grid[0, 1].set_title(more, fontsize=9.5)
    made.suptitle(turns.title(f"motion of {result.output.name}", 10.6), fontsize=TITLE)
    legend(made, grid[0, 0])
    return made


@styled
def error(result: ClearanceSimulation) -> Figure | None:
    """Draw the RMS and peak deviation of every revolution and the RMS over all revolutions after the running-in."""
    turns = Turns(result)
    if not turns or not result.turns:
        return None
    unit = result.output.unit
    numbers = result.turns["revolution"]
    rms, peak = result.turns[f"rms_{unit}"], result.turns[f"peak_{unit}"]
    shown = turns.shares(float(np.max(peak)))
    made = figure(7.6, 4.4)
    axes = made.subplots()
    mark = "o" if len(numbers) <= MARKED else ""
    axes.plot(numbers, peak * shown.factor, color=CRANK, marker=mark, markersize=3.5, linewidth=1.1, label="peak", gid="peak")
    axes.plot(
        numbers, rms * shown.factor, color=FOUND, marker=mark, markersize=3.5, linewidth=1.5, label="root mean square", gid="rms"
    )
    whole = turns.rms
    ends = (turns.begin - 0.5, turns.last + 0.5)
    axes.plot(ends, [whole * shown.factor] * 2, "--", color=WANTED, linewidth=1.1, label=f"RMS over {turns.counted}", gid="whole")
    low, high = float(numbers[0]) - 0.5, float(numbers[-1]) + 0.5
    if turns.begin - 0.5 > low:
        axes.axvspan(low, turns.begin - 0.5, color=SHADE, alpha=0.55, linewidth=0.0, zorder=0.5, label="running-in, left out")
    turn_axis(axes, low, high)
    from_zero(axes, float(np.max(peak)) * shown.factor)
    axes.set_ylabel(f"deviation of {result.output.name} [{shown.unit}]")
    counted = numbers >= turns.begin
    si = "m" if unit == "m" else "deg"
    told = f"RMS {rough(whole, si)}, peak {rough(float(np.max(peak[counted])), si)}"
    if int(np.sum(counted)) > 1:
        scatter = float(np.std(rms[counted], ddof=1)) * shown.factor
        told += f", RMS of single revolutions ±{scatter:.2g}{'°' if si == 'deg' else ' ' + shown.unit}"
    made.suptitle(turns.title(f"deviation of {result.output.name}", 7.2, turns.counted, told), fontsize=TITLE)
    legend(made, axes)
    return made


# --- drive ---------------------------------------------------------------------------------------------------------------


def _ideal_torque(turns: Turns) -> tuple[Array, Array] | None:
    """Return crank angles [deg] and the driving torque [N m] of the machine without clearance at constant speed."""
    if turns.free:
        return None
    angles = np.linspace(0.0, FULL, 721)
    torque = MotionColumns(turns.result.machine.moving(np.radians(angles), turns.result.speed))[TORQUE]
    return angles, np.broadcast_to(np.asarray(torque, dtype=float), angles.shape)


@styled
def torque(result: ClearanceSimulation) -> Figure | None:
    """Draw the driving torque of the last revolution with and without clearance; a small ideal torque is enlarged below."""
    turns = Turns(result)
    if not turns:
        return None
    own, ideal = result[TORQUE], _ideal_torque(turns)
    last = own[turns.rows(1)]
    largest, near = turns.peak(TORQUE, 1), 0.0
    if ideal is not None:
        near = float(np.nanmax(np.abs(ideal[1]), initial=0.0))
    two = 0.0 < ZOOM * near < largest
    made = figure(7.6, 6.4 if two else 4.4)
    panels = made.subplots(2 if two else 1, 1, squeeze=False, sharex=True)[:, 0]
    rms = math.sqrt(float(np.mean(last[-turns.points :] ** 2)))
    for axes, size in zip(panels, (max(largest, near), near), strict=False):
        unit = scale(size, "N m")
        close = two and axes is panels[1]
        told = f"with clearance: RMS {rough(rms, 'N m')}, largest {rough(largest, 'N m')}"
        if close:
            x, y = turns.fold(own * unit.factor, turns.rows(1))
            axes.plot(x, y, color=CRANK, linewidth=1.0, zorder=3, gid="last revolution")
        else:
            x, y = turns.fold(own * unit.factor, turns.rows(1))
            axes.plot(x, y, color=CRANK, linewidth=1.4, zorder=3, gid="last revolution", label=told)
        if ideal is not None:
            even = math.sqrt(float(np.mean(ideal[1] ** 2)))
            words = f"ideal machine: RMS {rough(even, 'N m')}, largest {rough(near, 'N m')}"
            axes.plot(
                ideal[0],
                ideal[1] * unit.factor,
                "--",
                color=WANTED,
                linewidth=1.4,
                zorder=4,
                gid="ideal",
                label=words if not close else None,
            )
        if close:
            axes.set_ylim(-1.6 * near * unit.factor, 1.6 * near * unit.factor)
            axes.set_title("near the ideal machine's torque, cut off", fontsize=9.5)
        if float(np.ptp(last)) < 1e-6 * largest:  # constant torque: start at zero instead of showing rounding errors
            axes.set_ylim(*sorted((0.0, 1.15 * float(last[0]) * unit.factor)))
        zero(axes)
        crank_axis(axes, turns, named=axes is panels[-1])
        axes.set_ylabel(f"torque on {result.machine.mechanism.crank.body} [{unit.unit}]")
    made.suptitle(turns.title("driving torque", 7.2, turns.span(1)), fontsize=TITLE)
    legend(made, panels[0], columns=1)
    return made


# --- energy --------------------------------------------------------------------------------------------------------------


def _works(turns: Turns) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the work of drive and loads, and the energy lost at the joints, since the first stored row [J]."""
    names = [name.removesuffix(".work_J") for name in turns.result.figures if name.endswith(".work_J")]
    points = {gap.point for gap in turns.result.gaps}
    fed: dict[str, Array] = {}
    lost: dict[str, Array] = {}
    for name in names:
        work = turns.result[f"work.{name}_J"]
        point, _, kind = name.rpartition(".")
        into = lost if point in points and kind in ("impact", "friction") else fed
        into[name] = work - work[0]
    return fed, lost


@styled
def energy(result: ClearanceSimulation) -> Figure | None:
    """Draw the work of drive and loads, the energy gained, the losses at each joint, and the imbalance of the energy account."""
    turns = Turns(result)
    largest = result.figures["largest_energy_J"]
    if not turns or largest <= 0.0:
        return None
    made = figure(7.6, 7.6)
    top, middle, bottom = made.subplots(3, 1, sharex=True, height_ratios=(1.5, 1.3, 0.9))
    every = slice(0, len(turns.time))
    unit_of_time = turns.times(every)
    time = turns.time * unit_of_time.factor
    stored = result["energy.kinetic_J"] + result["energy.potential_J"] + result["energy.contact_J"]
    gained = stored - stored[0]
    fed, lost = _works(turns)
    unit = scale(max(float(np.max(np.abs(work))) for work in (*fed.values(), gained)), "J")
    for k, (name, work) in enumerate(fed.items()):
        words, colour = ("drive", CRANK) if name == "drive" else (name, BODIES[(k + 1) % len(BODIES)])
        top.plot(time, work * unit.factor, color=colour, linewidth=1.3, label=f"work of {words}", gid=f"work {name}")
    top.plot(time, gained * unit.factor, "--", color=WANTED, linewidth=1.0, label="energy gained", gid="gained")
    top.set_ylabel(f"energy [{unit.unit}]")
    total = sum(fed.values()) - gained
    most = max([float(np.max(np.abs(total))), *(float(np.max(np.abs(work))) for work in lost.values())])
    unit = scale(most, "J")
    for name, work in lost.items():
        point, _, kind = name.rpartition(".")
        index = next(i for i, gap in enumerate(result.gaps) if gap.point == point)
        if float(np.max(np.abs(work))) > 1e-9 * most or kind == "impact":
            middle.plot(
                time,
                work * unit.factor,
                color=BODIES[index % len(BODIES)],
                linestyle="-" if kind == "friction" else "-.",
                linewidth=1.5,
                label=f"lost at {point} {'by friction' if kind == 'friction' else 'in contact'}",
                gid=f"lost {name}",
            )
    middle.plot(time, total * unit.factor, ":", color=WANTED, linewidth=1.4, label="works minus energy gained", gid="total")
    middle.set_ylabel(f"losses [{unit.unit}]")
    missing = np.abs(total - sum(lost.values())) / largest
    bottom.semilogy(time, np.maximum(missing, 1e-17), color=QUIET, linewidth=1.0, gid="imbalance")
    low = 10.0 ** math.floor(math.log10(max(float(np.percentile(missing[1:], 5.0)), 1e-16)) - 1.0)
    bottom.set_ylim(low, max(1e-8, 10.0 * float(np.max(missing))))
    bottom.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{share:.0e}"))
    bottom.set_ylabel("imbalance / largest")
    for axes in (top, middle):
        zero(axes)
    for axes in (top, middle, bottom):
        axes.set_xlim(time[0], time[-1])
    bottom.set_xlabel(f"time [{unit_of_time.unit}]")
    share = result.figures["imbalance_J"] / largest
    told = f"imbalance at most {share:.1e} of the largest energy, {rough(largest, 'J')}"
    made.suptitle(turns.title("energy account", 7.2, turns.span(turns.kept), told), fontsize=TITLE)
    legend(made, top, middle, columns=3)
    return made


PICTURES: dict[str, Callable[[ClearanceSimulation], Figure | None]] = {
    "mechanism": magnified_joints.mechanism,
    "displacement": displacement,
    "error": error,
    "orbit": journal_orbit.orbit,
    "force": journal_orbit.force,
    "impacts": journal_orbit.impacts,
    "section": poincare_map.section,
    "torque": torque,
    "energy": energy,
}
