"""Figures of a control comparison: deviation under each kind of control, and trials from several starts."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from optlink.report.style import BODIES, COUPLER, CRANK, FOUND, QUIET, ROCKER, WANTED, figure, heading, scale, styled
from optlink.report.views.revolutions import FULL, TITLE, Turns, crank_axis, fold, legend, zero
from optlink.tasks.control_comparison import Comparison
from optlink.tasks.results.clearance import ClearanceSimulation

Array = NDArray[np.float64]


def _mean_turn(turns: Turns, values: Array) -> tuple[Array, Array, Array, Array]:
    """Return crank angles [deg] and the mean, least and largest values over the revolutions after the running-in."""
    count = max(1, min(turns.whole // turns.points, turns.last - turns.begin + 1))
    rows = slice(turns.whole - count * turns.points, turns.whole)
    table = values[rows].reshape(count, turns.points)
    numbers = np.arange(turns.last - count, turns.last)[:, None]
    angles = np.mean(turns.angle[rows].reshape(count, turns.points) - turns.way * FULL * numbers, axis=0)
    before = angles[-1] - turns.way * FULL
    closed = np.concatenate([[before], angles])
    return closed, _closed(np.mean(table, axis=0)), _closed(np.min(table, axis=0)), _closed(np.max(table, axis=0))


def _closed(values: Array) -> Array:
    """Prepend the last value of a periodic course."""
    return np.concatenate([values[-1:], values])


def _standstills(turns: Turns) -> list[float]:
    """Return the crank angles [deg] at which the ideal output reverses, where crank corrections have no effect."""
    angles, ideal, _, _ = _mean_turn(turns, turns.output - turns.error)
    if turns.advance:
        return []
    slope, at = np.diff(ideal), 0.5 * (angles[1:] + angles[:-1])
    turned = np.flatnonzero(slope[:-1] * slope[1:] < 0.0)
    places = at[turned] + (at[turned + 1] - at[turned]) * slope[turned] / (slope[turned] - slope[turned + 1])
    return sorted(float(place) % FULL for place in places)


@styled
def compensation(results: Mapping[str, ClearanceSimulation]) -> Figure | None:
    """Draw the deviation over the crank angle under several kinds of control, and the corrections of the crank command."""
    every = {name: Turns(result) for name, result in results.items()}
    every = {name: turns for name, turns in every.items() if turns and turns.last}
    if not every:
        return None
    first = next(iter(every.values()))
    corrected = {name: turns for name, turns in every.items() if turns.result.figures["correction_max_rad"] > 0.0}
    made = figure(8.4, 6.6 if corrected else 4.4)
    panels = made.subplots(
        2 if corrected else 1, 1, squeeze=False, sharex=True, height_ratios=(1.5, 1.0)[: 2 if corrected else 1]
    )[:, 0]
    means = {name: _mean_turn(turns, turns.error) for name, turns in every.items()}
    shown = first.shares(max(float(np.max(np.abs(course[1:]))) for course in means.values()))
    colours = dict(zip(every, (QUIET, COUPLER, BODIES[2], ROCKER, *BODIES[3:]), strict=False))
    before = every["none"].rms if "none" in every else None
    for name, (angles, mean, least, most) in means.items():
        rms = every[name].rms
        gain = "" if name == "none" or not before else f" ({(rms / before - 1.0) * 100.0:+.0f} %)".replace("-", "−")
        colour = WANTED if name == "none" else colours[name]
        label = f"{'no control' if name == 'none' else name}: RMS {rms * shown.factor:.4g} {shown.unit}{gain}"
        x, y = fold(angles, mean * shown.factor)
        panels[0].plot(x, y, color=colour, linewidth=1.7, label=label, zorder=3, gid=f"mean {name}")
        _band(panels[0], angles, least * shown.factor, most * shown.factor, colour)
    panels[0].set_ylabel(f"deviation of {first.result.output.name} [{shown.unit}]")
    for name, turns in corrected.items():
        angles, mean, least, most = _mean_turn(turns, np.degrees(turns.result["command.correction_rad"]))
        x, y = fold(angles, mean)
        panels[1].plot(x, y, color=colours[name], linewidth=1.5, zorder=3, gid=f"correction {name}")
        _band(panels[1], angles, least, most, colours[name])
    if corrected:
        panels[1].set_ylabel("correction of the\ncrank's command [deg]")
    for axes in panels:
        axes.margins(y=0.08)
        zero(axes)
        for at in _standstills(first):
            word = "the output reverses"
            axes.axvline(at, color=QUIET, linewidth=1.0, linestyle="--", zorder=1.5, label=word, gid="standstill")
        crank_axis(axes, first, named=axes is panels[-1])
    rpm = f"{abs(first.result.speed) * 30.0 / math.pi:.5g} rpm{'' if first.way > 0.0 else ' clockwise'}"
    lines = [f"{first.result.problem.model.title}: compensation of the clearance", f"{rpm}, means of {first.counted}"]
    if first.shown > 1:
        lines[1] += ", shaded from least to largest"
    made.suptitle("\n".join(heading(line, 8.0, TITLE) for line in lines), fontsize=TITLE)
    legend(made, panels[0], columns=2)
    return made


def _band(axes: Axes, angles: Array, least: Array, most: Array, colour: str) -> None:
    x, low = fold(angles, least)
    high = fold(angles, most)[1]
    axes.fill_between(x, low, high, color=colour, alpha=0.12, linewidth=0.0, zorder=2)


@styled
def trials(found: Comparison) -> Figure | None:
    """Draw the RMS and peak deviation of every start under each kind of control, and their means."""
    kinds = list(found.trials)
    shown = scale(float(max(np.max(one.peak) for one in found.trials.values())), "m" if found.unit == "m" else "deg")
    made = figure(7.6, 0.55 * len(kinds) + 2.0)
    axes = made.subplots()
    for k, name in enumerate(kinds):
        one = found.trials[name]
        for values, colour, word in ((one.rms, FOUND, "root mean square"), (one.peak, CRANK, "peak")):
            places = np.full(len(values), k) + (0.12 if colour == CRANK else -0.12)
            axes.plot(
                values * shown.factor,
                places,
                "o",
                color=colour,
                markersize=5,
                alpha=0.55,
                mew=0.0,
                label=word if k == 0 else None,
                gid=word,
            )
        axes.plot(
            [one.mean * shown.factor] * 2,
            [k - 0.34, k + 0.1],
            color=WANTED,
            linewidth=1.6,
            label="mean" if k == 0 else None,
            gid="mean",
        )
    axes.set_yticks(range(len(kinds)), ["no control" if name == "none" else name for name in kinds])
    axes.set_ylim(len(kinds) - 0.4, -0.6)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(f"deviation [{shown.unit}]")
    count = f"{found.revolutions} revolutions from each of {len(found.starts)} starts"
    made.suptitle(f"{heading(f'{found.problem.model.title}: kinds of control', 7.2)}\n{count}", fontsize=10.5)
    legend(made, axes)
    return made
