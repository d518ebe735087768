"""Figures of the joints with clearance: journal orbits, contact forces, impacts."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.report.style import BODIES, FOUND, GROUND, LIMIT, QUIET, WANTED, figure, heading, scale, styled
from optlink.report.views.revolutions import (
    FULL,
    STEPS,
    TITLE,
    WINDOW,
    Turns,
    bands,
    beside,
    crank_axis,
    crown,
    from_zero,
    legend,
    named,
    overlay,
    rough,
    round_below,
    square,
    turn_axis,
    zero,
)
from optlink.tasks.results.clearance import ClearanceSimulation

Array = NDArray[np.float64]
DEEP = 0.22  # largest magnified penetration, as a share of the clearance
MOST = 50.0  # largest magnification
SOME = 6  # number of revolutions up to which the axis has fractional ticks


def _panels(made: Figure, count: int, rows: int = 1) -> list[list[Axes]]:
    """Create axes for `count` joints, `rows` below one another for each."""
    columns = beside(count)
    deep = -(-count // columns)
    grid = made.subplots(rows * deep, columns, squeeze=False, height_ratios=(1.5, 1.0)[:rows] * deep)
    for k in range(count, deep * columns):
        for i in range(rows):
            grid[rows * (k // columns) + i, k % columns].remove()
    return [[grid[rows * (k // columns) + i, k % columns] for i in range(rows)] for k in range(count)]


# --- orbits --------------------------------------------------------------------------------------------------------------


def exaggeration(gap: Gap, deepest: float) -> float:
    """Return the factor by which penetrations are magnified: a round number, 1 if they are visible to scale.

    Parameters
    ----------
    gap : Gap
        Joint with clearance.
    deepest : float [m]
        Largest penetration.
    """
    return max(1.0, min(round_below(DEEP * gap.clearance / deepest), MOST)) if deepest > 0.0 else 1.0


def _path(turns: Turns, k: int, rows: slice, factor: float) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.intp]]:
    """Return the journal centre relative to the bearing centre [m], with penetrations magnified by `factor`.

    Where a contact begins or ends between two rows, the path has a point on the clearance circle. Also returned: which segments
    are in contact, and the indices of the points where a contact begins.
    """
    result, gap = turns.result, turns.result.gaps[k]
    time = turns.time[rows]
    x, y = (result[f"{gap.point}.e{axis}_m"][rows] for axis in "xy")
    touching = result[f"{gap.point}.contact"][rows]
    events = [(at, 1.0 - end) for one in _own(turns, k, -math.inf) for end, at in enumerate((one.begin, one.end))]
    events = [(at, mode) for at, mode in events if time[0] < at < time[-1]]
    apart = [at for at, mode in events if not mode] + list(time[touching < 0.5][-1:])
    # a contact at the end of the run has no impact record yet
    if touching[-1] > 0.5 and apart and not any(at > max(apart) for at, _ in events):
        i = int(np.searchsorted(time, max(apart), side="right"))
        left = gap.clearance - np.hypot(x, y)[i - 1 : i + 1]
        share = left[0] / (left[0] - left[1]) if touching[i - 1] < 0.5 else 0.0
        events.append((max(apart) + share * (time[i] - max(apart)), 1.0))
    at, modes = np.array(events).reshape(-1, 2).T
    ex, ey = np.interp(at, time, x), np.interp(at, time, y)
    length = np.maximum(np.hypot(ex, ey), 1e-300)
    every = np.concatenate([time, at])
    order = np.argsort(every, kind="stable")
    x, y = (np.concatenate([a, b / length * gap.clearance])[order] for a, b in ((x, ex), (y, ey)))
    closed = np.concatenate([touching, modes])[order] > 0.5
    is_event = np.concatenate([np.zeros(len(time)), np.ones(len(at))])[order] > 0.5
    away = np.hypot(x, y)
    more = np.where(away > gap.clearance, (gap.clearance + factor * (away - gap.clearance)) / np.maximum(away, 1e-300), 1.0)
    # the state after a point holds until the next; a contact of unknown start counts from its first row
    return x * more, y * more, closed[:-1] & (closed[1:] | is_event[1:]), np.flatnonzero(is_event & closed)


def _own(turns: Turns, k: int, since: float) -> list[Impact]:
    return [impact for impact in turns.result.impacts if impact.gap == k and impact.begin >= since]


@styled
def orbit(result: ClearanceSimulation) -> Figure | None:
    """Draw the orbit of every journal centre over the last revolutions with contacts and impacts; penetrations are magnified."""
    turns = Turns(result)
    if not turns:
        return None
    count = len(result.gaps)
    columns = beside(count)
    width = max(6.2, 4.0 * columns + 0.4)
    made = figure(width, (4.6 if count > 1 else 5.6) * -(-count // columns) + 0.9)
    rows = turns.rows(WINDOW)
    panels = [pair[0] for pair in _panels(made, count)]
    for k, (gap, axes) in enumerate(zip(result.gaps, panels, strict=True)):
        contact = result[f"{gap.point}.contact"][rows] > 0.5
        deepest = turns.peak(f"{gap.point}.penetration_m", WINDOW)
        factor = exaggeration(gap, deepest)
        unit = scale(gap.clearance, "m")
        x, y, both, begins = _path(turns, k, rows, factor)
        x, y = x * unit.factor, y * unit.factor
        size = gap.clearance * unit.factor
        axes.add_patch(
            Circle(
                (0.0, 0.0), size, facecolor="none", edgecolor=GROUND, linewidth=1.2, zorder=2, label="clearance", gid="clearance"
            )
        )
        for mask, colour, line, word in ((~both, FOUND, 1.0, "apart"), (both, LIMIT, 1.2, "in contact")):
            xs, ys = _masked(x, y, mask)
            axes.plot(xs, ys, color=colour, linewidth=line, zorder=3, label=word if len(xs) else None, gid=word)
        if begins.size:
            axes.plot(
                x[begins],
                y[begins],
                linestyle="none",
                marker="o",
                markersize=4.0 if len(begins) < 60 else 2.5,
                mfc="white",
                mec=WANTED,
                mew=0.9,
                zorder=5,
                label="impact",
                gid="impact",
            )
        axes.plot([0.0], [0.0], "+", color=QUIET, markersize=8, zorder=1)
        reach = 1.08 * max(size, float(np.max(np.hypot(x, y))))
        square(axes, reach, unit)
        share = float(np.mean(contact))
        told = [named(gap), f"clearance {rough(gap.clearance, 'm')}, in contact {share:.0%}"]
        if deepest > 0.0:
            told.append(f"deepest {rough(deepest, 'm')}" + (f", beyond the circle {factor:g}-fold" if factor > 1.0 else ""))
        axes.set_title("\n".join(heading(line, width / columns - 0.7, 9.5) for line in told), fontsize=9.5)
    made.suptitle(turns.title("journals in their bearings", width - 0.4, turns.span(WINDOW)), fontsize=TITLE)
    legend(made, *panels)
    return made


def _masked(x: Array, y: Array, segments: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the selected segments of a path, separated by NaN."""
    ends = np.concatenate([segments, [False]]) | np.concatenate([[False], segments])
    whole = np.flatnonzero(ends)
    breaks = np.flatnonzero(~np.concatenate([segments, [False]])[whole[:-1]]) + 1
    return np.insert(x[whole], breaks, np.nan), np.insert(y[whole], breaks, np.nan)


# --- forces --------------------------------------------------------------------------------------------------------------


@styled
def force(result: ClearanceSimulation) -> Figure | None:
    """Draw the normal force, friction and penetration of every joint over the crank angle; contact phases are shaded."""
    turns = Turns(result)
    if not turns:
        return None
    count = len(result.gaps)
    columns = beside(count)
    width = 7.6 if columns == 1 else 4.6 * columns
    made = figure(width, 5.6 * -(-count // columns) + 0.6)
    panels = _panels(made, count, 2)
    rows, last = turns.rows(turns.shown), turns.rows(1)
    for k, (gap, (top, bottom)) in enumerate(zip(result.gaps, panels, strict=True)):
        normal, rub, depth = (result[f"{gap.point}.{name}"] for name in ("normal_N", "rub_N", "penetration_m"))
        strongest = turns.peak(f"{gap.point}.normal_N", turns.shown)
        unit, small = scale(strongest, "N"), scale(float(np.max(depth[rows])), "m")
        overlay(top, turns, normal, unit, FOUND, label="normal force")
        if gap.friction or gap.damping:
            x, y = turns.fold(rub * unit.factor, last)
            top.plot(
                x,
                y,
                color=BODIES[2],
                linewidth=1.1,
                zorder=3.5,
                label="friction on the journal, counter-clockwise",
                gid="friction",
            )
        overlay(bottom, turns, np.maximum(depth, 0.0), small, FOUND)
        deepest = 0.0
        own = _own(turns, k, float(turns.time[last.start]))
        if own:
            at = [math.degrees(impact.crank_angle) % FULL for impact in own]
            depths = [impact.penetration * small.factor for impact in own]
            deepest = max([deepest, *(impact.penetration for impact in own)])
            word = "deepest of an impact, where it begins"
            bottom.plot(
                at,
                depths,
                linestyle="none",
                marker="o",
                markersize=3.5,
                mfc="white",
                mec=WANTED,
                mew=0.9,
                zorder=5,
                label=word,
                gid="impact",
            )
        cut = crown(top, turns, normal * unit.factor, float(np.min(rub[last])) * unit.factor)
        cut_below = crown(bottom, turns, depth * small.factor, 0.0, deepest * small.factor)
        for axes in (top, bottom):
            bands(
                axes, turns, result[f"{gap.point}.contact"], last, "in contact" + (", last revolution" if turns.shown > 1 else "")
            )
            crank_axis(axes, turns, named=axes is bottom)
        top.tick_params(labelbottom=False)
        zero(top)
        top.set_ylabel(f"force [{unit.unit}]{cut}")
        bottom.set_ylabel(f"penetration [{small.unit}]{cut_below}")
        share = float(np.mean(result[f"{gap.point}.contact"][last][-turns.points :]))
        told = f"in contact {share:.0%}, at most {rough(strongest, 'N')}"
        top.set_title("\n".join(heading(line, width / columns - 0.6, 9.5) for line in (named(gap), told)), fontsize=9.5)
    more = f"{turns.span(turns.shown)}, the last one bold" if turns.shown > 1 else turns.span(1)
    made.suptitle(turns.title("contact forces", width - 0.4, more), fontsize=TITLE)
    legend(made, *(axes for pair in panels for axes in pair), columns=3 if columns == 1 else 4)
    return made


# --- impacts -------------------------------------------------------------------------------------------------------------


@styled
def impacts(result: ClearanceSimulation) -> Figure | None:
    """Draw the approach speed and the largest penetration of every contact over the revolutions."""
    turns = Turns(result)
    if not turns or not result.impacts:
        return None
    made = figure(7.6, 5.4)
    top, bottom = made.subplots(2, 1, sharex=True)
    fastest = max(impact.approach for impact in result.impacts)
    deepest = max(impact.penetration for impact in result.impacts)
    unit, small = scale(fastest, "m/s"), scale(deepest, "m")
    size = 4.5 if len(result.impacts) < 400 else 2.5
    for k, gap in enumerate(result.gaps):
        own = _own(turns, k, -math.inf)
        if own:
            at = np.array([impact.begin for impact in own]) / turns.period
            style = {
                "linestyle": "none",
                "marker": "o",
                "markersize": size,
                "alpha": 0.6,
                "mew": 0.0,
                "color": BODIES[k % len(BODIES)],
            }
            approach = np.array([impact.approach for impact in own])
            top.plot(at, approach * unit.factor, label=f"{named(gap)}: {len(own)}", gid=f"approach {gap.point}", **style)
            depth = np.array([impact.penetration for impact in own])
            bottom.plot(at, depth * small.factor, gid=f"penetration {gap.point}", **style)
    times = [impact.begin / turns.period for impact in result.impacts]
    begin = math.floor(min(times))
    turn_axis(bottom, begin, max(math.ceil(max(times)), begin + 1))
    if max(times) - begin < SOME:
        bottom.xaxis.set_major_locator(MaxNLocator(8, steps=STEPS))
    bottom.set_xlabel("revolutions since the start")
    from_zero(top, fastest * unit.factor)
    from_zero(bottom, deepest * small.factor)
    top.set_ylabel(f"approach speed [{unit.unit}]")
    bottom.set_ylabel(f"largest penetration [{small.unit}]")
    told = f"{len(result.impacts)} contacts, the last begins in revolution {math.floor(max(times)) + 1} of {turns.last}"
    lasting = [gap.point for gap in result.gaps if result[f"{gap.point}.contact"][-1] > 0.5]
    if lasting:
        told += f"; still touching at the end: {', '.join(lasting)}"
    made.suptitle(turns.title("impacts", 7.2, "", told), fontsize=TITLE)
    legend(made, top, columns=3)
    return made
