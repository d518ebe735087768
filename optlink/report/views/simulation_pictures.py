"""Files and figures of a forward dynamics simulation: speed and torque, output, energy balance."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from optlink.dynamics.columns import slider_names
from optlink.report.files import write_csv, write_json
from optlink.report.style import BODIES, CRANK, QUIET, WANTED, figure, heading, save, scale, styled
from optlink.tasks.simulate import Simulation

Array = NDArray[np.float64]


def write_all(result: Simulation, folder: Path) -> list[Path]:
    """Write result.json, course.csv and the applicable figures; return the paths.

    Parameters
    ----------
    result : Simulation
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json", folder / "course.csv"]
    write_json(written[0], result.to_dict())
    write_csv(written[1], result.columns)
    for name, draw in PICTURES.items():
        drawn = draw(result)
        if drawn is not None:
            written.append(folder / f"{name}.png")
            save(drawn, written[-1])
    return written


def _curve(axes: Axes, time: Array, values: Array, unit: str, what: str, color: str = CRANK) -> None:
    shown = scale(float(np.nanmax(np.abs(values), initial=0.0)), unit)
    axes.plot(time, values * shown.factor, color=color, linewidth=1.6)
    axes.set_ylabel(f"{what} [{shown.unit}]")


@styled
def drive(result: Simulation) -> Figure | None:
    """Draw crank speed and driving torque over time, and the mean speed of the last revolution if it was completed."""
    if len(result.run.time) < 2:
        return None
    drawn = figure(7.2, 5.2)
    top, bottom = drawn.subplots(2, 1, sharex=True, height_ratios=(1.4, 1.0))
    time, speed = result.run.time, result.run.speed
    top.plot(time, speed, color=CRANK, linewidth=1.7)
    top.set_ylabel("crank speed [rad/s]")
    other = top.secondary_yaxis("right", functions=(lambda w: w * 30.0 / math.pi, lambda n: n * math.pi / 30.0))
    other.set_ylabel("[rpm]")
    figures = result.figures
    if "last_turn.mean_speed_rad_s" in figures:
        mean = math.copysign(figures["last_turn.mean_speed_rad_s"], speed[-1])
        turned = np.abs(result.run.crank_angle - result.run.crank_angle[-1]) <= 2.0 * math.pi
        top.plot(time[turned], np.full(int(np.sum(turned)), mean), "--", color=WANTED, linewidth=1.2)
        share = figures["last_turn.fluctuation"]
        label = f"last turn: mean over time {mean:.4g} rad/s, fluctuation {share:.2%}"
        room = 0.16 * float(np.ptp(speed)) or 0.1 * abs(mean) or 1.0
        top.set_ylim(float(np.min(speed)) - room, float(np.max(speed)) + 0.4 * room)
        top.text(0.99, 0.03, label, transform=top.transAxes, ha="right", va="bottom", fontsize=9)
    torque = result.run.torque
    _curve(bottom, time, torque, "N m", "driving torque", BODIES[0])
    size = float(np.max(np.abs(torque)))
    if float(np.ptp(torque)) < 1e-6 * size:  # constant torque: start at zero instead of showing rounding errors
        ends = sorted((0.0, 1.15 * float(torque[0]) * scale(size, "N m").factor))
        bottom.set_ylim(ends[0], ends[1])
    bottom.set_xlabel("time [s]")
    words = f"{result.problem.model.title}: driven by {result.driven}, {result.run.ending.value}"
    drawn.suptitle(heading(words, 7.2))
    return drawn


@styled
def output(result: Simulation) -> Figure | None:
    """Draw displacement and velocity of the last slider over time, or angle and angular velocity of the last body."""
    if len(result.run.time) < 2:
        return None
    names = list(slider_names(result.machine).values())
    drawn = figure(7.2, 4.8)
    top, bottom = drawn.subplots(2, 1, sharex=True)
    time = result.run.time
    if names:
        what, color = names[-1], BODIES[1]
        _curve(top, time, result[f"{what}.s_m"], "m", f"{what}: slide", color)
        _curve(bottom, time, result[f"{what}.v_m_s"], "m/s", f"{what}: velocity", color)
    else:
        what, color = list(result.machine.mechanism.bodies)[-1], BODIES[1]
        top.plot(time, np.degrees(np.unwrap(result[f"{what}.angle_rad"])), color=color, linewidth=1.6)
        top.set_ylabel(f"{what}: angle [deg]")
        bottom.plot(time, result[f"{what}.omega_rad_s"], color=color, linewidth=1.6)
        bottom.set_ylabel(f"{what}: angular velocity [rad/s]")
    bottom.axhline(0.0, color=QUIET, linewidth=0.8)
    bottom.set_xlabel("time [s]")
    drawn.suptitle(heading(f"{result.problem.model.title}: {what}", 7.2))
    return drawn


@styled
def energy(result: Simulation) -> Figure | None:
    """Draw the work of drive, loads and friction and the energy gained over time; below, the imbalance of the energy account."""
    run = result.run
    if len(run.time) < 2 or run.turnover == 0.0:
        return None
    drawn = figure(7.2, 5.2)
    top, bottom = drawn.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    shown = scale(run.turnover, "J")
    gained = run.energy - run.energy[0]
    for k, (name, work) in enumerate(run.works.items()):
        words, color = ("drive", CRANK) if name == "input" else (name, BODIES[(k - 1) % len(BODIES)])
        top.plot(run.time, work * shown.factor, color=color, linewidth=1.6, label=f"work of {words}")
    top.plot(run.time, gained * shown.factor, "--", color=WANTED, linewidth=1.4, label="kinetic and gravity's energy gained")
    top.set_ylabel(f"energy [{shown.unit}]")
    top.axhline(0.0, color=QUIET, linewidth=0.8)
    missing = np.abs(gained - sum(run.works.values())) / run.turnover
    bottom.semilogy(run.time, np.maximum(missing, 1e-17), color=QUIET, linewidth=1.2)
    bottom.set_ylim(1e-17, max(1e-8, 10.0 * float(np.max(missing))))
    bottom.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{share:.0e}"))
    bottom.set_ylabel("imbalance / largest")
    bottom.set_xlabel("time [s]")
    drawn.suptitle(heading(f"{result.problem.model.title}: energy account", 7.2))
    drawn.legend(frameon=False, fontsize=8.5, loc="outside lower center", ncols=3)
    return drawn


PICTURES = {"drive": drive, "output": output, "energy": energy}
