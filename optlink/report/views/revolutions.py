"""Simulation with clearance by revolutions, folded onto the crank angle, and the axes shared by its figures."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from optlink.clearance.joint import Gap
from optlink.report.style import FOUND, QUIET, SHADE, Scale, heading, scale
from optlink.tasks.results.clearance import ClearanceSimulation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FULL = 360.0
TORQUE = "input.torque_Nm"
WINDOW = 3  # number of revolutions drawn over time
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
BULK = 99.8  # percentile of the values that the limits of y include
THIN = 0.6  # line width of a revolution among many
FONT = 8.5
TITLE = 10.5
TIMES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


class Turns:
    """Stored rows of a simulation with clearance, assigned to revolutions.

    If the simulation stopped early, its last rows belong to no complete revolution; "last revolution" then means the last period
    of rows.
    """

    def __init__(self, result: ClearanceSimulation) -> None:
        self.result = result
        self.time: Array = np.asarray(result.columns.get("time_s", np.zeros(0)))
        self.way = 1.0 if result.speed > 0.0 else -1.0
        self.period = 2.0 * math.pi / abs(result.speed)
        step = float(self.time[1] - self.time[0]) if len(self.time) > 1 else self.period
        self.points = max(1, round(self.period / step))
        self.kept = -(-len(self.time) // self.points)
        self.last = result.revolutions
        self.whole = int(np.searchsorted(self.time, self.last * self.period * (1.0 + 1e-9), side="right"))
        """How many rows belong to whole revolutions."""
        settled = int(result.figures["settled_revolutions"])
        self.begin = self.last - settled + 1 if settled else 1
        """The first revolution that the statistics count."""

    def __bool__(self) -> bool:
        return len(self.time) > 1

    @property
    def angle(self) -> Array:
        """Crank angle [deg], continuous over revolutions."""
        return self.result["crank_angle_deg"]

    @property
    def free(self) -> bool:
        """Whether the crank is driven by a torque; revolutions are then periods of the nominal speed."""
        return self.result.problem.model.drive.torque is not None

    @property
    def broken(self) -> bool:
        """Whether the last rows belong to an incomplete revolution."""
        return self.whole < len(self.time)

    @property
    def shown(self) -> int:
        """Number of revolutions after the running-in with stored rows."""
        return max(1, min(self.kept, self.last - self.begin + 1 + self.broken))

    def rows(self, count: int) -> slice:
        """Return the rows of the last revolutions and the row before them, if there is one."""
        return slice(max(0, len(self.time) - count * self.points - 1), len(self.time))

    def span(self, count: int) -> str:
        """Describe the last revolutions."""
        count = min(count, self.kept)
        if self.broken:
            return "the last revolution" if count == 1 else f"the last {count} revolutions"
        return f"revolution {self.last}" if count == 1 else f"revolutions {self.last - count + 1} to {self.last}"

    @property
    def counted(self) -> str:
        """Description of the revolutions that the statistics include."""
        return f"revolution {self.last}" if self.begin == self.last else f"revolutions {self.begin} to {self.last}"

    # --- output --------------------------------------------------------------------------------------------------------

    @property
    def output(self) -> Array:
        """Output [m, rad]; angles are unwrapped and start within the first turn."""
        values = self.result[self.result.output.column]
        if self.result.output.guide:
            return values
        values = np.unwrap(values)
        lifted: Array = values - 2.0 * math.pi * math.floor(float(np.min(values[self.rows(WINDOW)])) / (2.0 * math.pi) + 0.5)
        return lifted

    @property
    def error(self) -> Array:
        """Deviation of the output from that of the ideal machine [m, rad]."""
        return self.result[f"{self.result.output.name}.error_{self.result.output.unit}"]

    @property
    def rms(self) -> float:
        """RMS deviation [m, rad] over the revolutions after the running-in, or over all if too few were simulated."""
        settled, unit = self.result.figures["settled_revolutions"], self.result.output.unit
        return self.result.figures[f"rms_{unit}" if settled else f"rms_from_start_{unit}"]

    @property
    def advance(self) -> float:
        """Increase of the output in every crank revolution [m, rad]: whole turns for a body that turns fully."""
        if self.result.output.guide:
            return 0.0
        rows = self.rows(1)
        values, turned = self.output[rows], (self.angle[rows.stop - 1] - self.angle[rows.start]) / FULL
        return 2.0 * math.pi * round(float(values[-1] - values[0]) / (2.0 * math.pi * (turned or 1.0)))

    def shares(self, largest: float) -> Scale:
        """Return the display unit of the output or its deviation."""
        return scale(largest, "m" if self.result.output.guide else "deg")

    def peak(self, name: str, count: int) -> float:
        """Return the largest torque magnitude, normal force or penetration of the last revolutions, including peaks between rows.

        Parameters
        ----------
        name : str
            Column name.
        count : int
            Number of revolutions.
        """
        values = self.result[name][self.rows(count)]
        found = float(np.nanmax(np.abs(values) if name == TORQUE else values, initial=0.0))
        stem, _, unit = name.rpartition("_")
        exact = self.result.turns.get(f"{stem}_max_{unit}".removeprefix("input."), np.zeros(0))
        whole = min(count - self.broken, len(exact))
        return max(found, float(np.max(exact[-whole:]))) if whole else found

    # --- the crank angle as abscissa -----------------------------------------------------------------------------------

    def fold(self, values: Array, rows: slice, advance: float = 0.0) -> tuple[Array, Array]:
        """Return crank angles within a revolution [deg] and values, with NaN between revolutions.

        Parameters
        ----------
        values : array (n,)
            Values at all rows.
        rows : slice
        advance : float, optional
            Amount subtracted from the values for every whole turn of the crank.
        """
        return fold(self.angle[rows], values[rows], advance)

    def times(self, rows: slice) -> Scale:
        """Return the display unit of time for the rows."""
        span = float(self.time[rows][-1] - self.time[rows][0])
        size, unit = next(((size, unit) for size, unit in TIMES if span >= 0.5 * size), TIMES[-1])
        return Scale(1.0 / size, unit)

    # --- titles --------------------------------------------------------------------------------------------------------

    def title(self, what: str, width: float, *more: str) -> str:
        """Compose the title of a figure: machine and subject, then speed, control and further lines.

        Parameters
        ----------
        what : str
            ReportModel of the figure.
        width : float [inch]
        *more : str
            Addition to the second line, then further lines.
        """
        result = self.result
        nominal, sense = "nominal " if self.free else "", "" if self.way > 0.0 else " clockwise"
        parts = [f"{nominal}{abs(result.speed) * 30.0 / math.pi:.5g} rpm{sense}"]
        if result.control != "none":
            parts.append(f"control {result.control}")
        if not result.finished:
            parts.append(f"{result.ending.value} after {self.last} revolution{'s' if self.last != 1 else ''}")
        lines = [f"{result.problem.model.title}: {what}", ", ".join([*parts, *filter(None, more[:1])]), *more[1:]]
        return "\n".join(heading(line, width, TITLE) for line in lines)


def fold(angle: Array, values: Array, advance: float = 0.0) -> tuple[Array, Array]:
    """Return crank angles within a revolution [deg] and values, with NaN between revolutions.

    Parameters
    ----------
    angle : array (n,) [deg]
        Continuous crank angles.
    values : array (n,)
    advance : float, optional
        Amount subtracted from the values for every whole turn of the crank.
    """
    turn = np.floor(angle / FULL + 1e-9)
    x, y = angle - FULL * turn, values - advance * turn
    at = np.flatnonzero(np.diff(turn) != 0.0)
    if not at.size:
        return x, y
    border = FULL * np.maximum(turn[at], turn[at + 1])
    share = (border - angle[at]) / (angle[at + 1] - angle[at])
    there = values[at] + share * (values[at + 1] - values[at])
    nothing = np.full(len(at), np.nan)
    at_ends = [(border - FULL * turn[at + side], there - advance * turn[at + side]) for side in (0, 1)]
    places = np.repeat(at + 1, 3)
    xs, ys = (np.stack([before, nothing, after], axis=1).ravel() for before, after in zip(*at_ends, strict=True))
    return np.insert(x, places, xs), np.insert(y, places, ys)


def rough(value: float, unit: str) -> str:
    """Format a value with four significant digits and its unit.

    Parameters
    ----------
    value : float [SI]
    unit : str
        SI unit, or "deg" for an angle in rad.
    """
    shown = scale(value, unit)
    return f"{value * shown.factor:.4g}{'°' if unit == 'deg' else ' ' + shown.unit}"


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def round_below(value: float) -> float:
    """Return the next lower value of the series 1, 2, 3, 4, 5, 6, 8, 10, 20, ...; zero if the value is not positive."""
    if not 0.0 < value < math.inf:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0) if step * power <= value)


def named(gap: Gap) -> str:
    """Format the name of a joint with clearance."""
    return f"{gap.point}: {gap.journal} in {gap.bearing}"


def beside(count: int) -> int:
    """Return the number of panels in a row."""
    return 2 if count in (2, 4) else min(count, 3)


# --- axes ----------------------------------------------------------------------------------------------------------------


def crank_axis(axes: Axes, turns: Turns, *, named: bool = True) -> None:
    """Set up the crank angle within a revolution as the x axis, with time increasing to the right.

    Parameters
    ----------
    axes : Axes
    turns : Turns
    named : bool, optional
        Label the axis.
    """
    axes.set_xlim((0.0, FULL) if turns.way > 0.0 else (FULL, 0.0))
    axes.xaxis.set_major_locator(MultipleLocator(60.0))
    if named:
        axes.set_xlabel("crank angle φ [deg]" + ("" if turns.way > 0.0 else ", clockwise to the right"))


def time_axis(axes: Axes, turns: Turns, rows: slice, *, named: bool = True) -> None:
    """Set up time as the x axis and mark the ends of the revolutions.

    Parameters
    ----------
    axes : Axes
    turns : Turns
    rows : slice
        Rows to show.
    named : bool, optional
        Label the axis.
    """
    unit = turns.times(rows)
    first, last = (float(turns.time[rows][k]) * unit.factor for k in (0, -1))
    axes.set_xlim(first, last)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=STEPS))
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")
    for k in range(math.ceil(turns.time[rows][0] / turns.period - 1e-9), turns.last + 1):
        at = k * turns.period * unit.factor
        if first < at < last - 1e-6 * (last - first):
            axes.axvline(at, color=QUIET, linewidth=0.9, linestyle=":", zorder=1, gid="revolution")
    if named:
        axes.set_xlabel(f"time [{unit.unit}]")


def turn_axis(axes: Axes, first: float, last: float) -> None:
    """Set up revolution numbers as the x axis.

    Parameters
    ----------
    axes : Axes
    first : float [revolutions]
        Lower limit.
    last : float [revolutions]
        Upper limit.
    """
    axes.set_xlim(first, last)
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True, min_n_ticks=1, steps=STEPS))
    axes.set_xlabel("revolution")


def overlay(
    axes: Axes, turns: Turns, values: Array, unit: Scale, colour: str = FOUND, *, advance: float = 0.0, label: str = ""
) -> Line2D:
    """Draw every revolution after the running-in as a thin line and the last one bold; return the bold line.

    Parameters
    ----------
    axes : Axes
    turns : Turns
    values : array (n,) [SI]
        Values at all rows.
    unit : Scale
        Display unit of the axis.
    colour : str, optional
    advance : float [SI], optional
        Amount subtracted from the values for every whole turn of the crank.
    label : str, optional
        Entry in the legend; empty for none.
    """
    if turns.shown > 1:
        rows = turns.rows(turns.shown)
        x, y = turns.fold(values * unit.factor, slice(rows.start, turns.rows(1).start + 1), advance * unit.factor)
        strength = min(0.9, max(0.25, 6.0 / turns.shown))
        axes.plot(x, y, color=QUIET, linewidth=THIN, alpha=strength, zorder=2, gid="revolutions")
    x, y = turns.fold(values * unit.factor, turns.rows(1), advance * unit.factor)
    return axes.plot(x, y, color=colour, linewidth=1.7, zorder=3, label=label or None, gid="last revolution")[0]


def bands(axes: Axes, turns: Turns, contact: Array, rows: slice, label: str = "") -> None:
    """Shade the crank angles at which journal and bearing are in contact.

    Parameters
    ----------
    axes : Axes
    turns : Turns
    contact : array (n,)
        1 in contact, 0 apart, at all rows.
    rows : slice
    label : str, optional
        Entry in the legend; empty for none.
    """
    x, touching = turns.fold(contact, rows)
    for piece in np.split(np.arange(len(x)), np.flatnonzero(np.isnan(x))):
        own = piece[np.isfinite(x[piece])]
        at = x[own]
        for a, b in runs(touching[own] > 0.5):
            begin = 0.5 * (at[a] + at[max(0, a - 1)])
            end = 0.5 * (at[b] + at[min(len(at) - 1, b + 1)])
            if begin != end:
                axes.axvspan(
                    *sorted((begin, end)), color=SHADE, linewidth=0.0, alpha=0.75, zorder=0.5, label=label or None, gid="contact"
                )


def zero(axes: Axes) -> None:
    """Draw a thin line at zero if zero is within the limits of y."""
    low, high = axes.get_ylim()
    if low < 0.0 < high:
        axes.axhline(0.0, color=QUIET, linewidth=0.8, zorder=1)


def from_zero(axes: Axes, largest: float) -> None:
    """Set the limits of y from zero to slightly above the largest value.

    Parameters
    ----------
    axes : Axes
    largest : float
        In the unit of the axis.
    """
    axes.set_ylim(0.0, 1.08 * largest if 0.0 < largest < math.inf else 1.0)


def crown(axes: Axes, turns: Turns, values: Array, low: float = 0.0, high: float = 0.0) -> str:
    """Set the limits of y to the last revolution and most of the others; return ", cut off" if values exceed them.

    Parameters
    ----------
    axes : Axes
    turns : Turns
    values : array (n,)
        Values at all rows, in the unit of the axis.
    low : float, optional
        Least value to include, in the unit of the axis.
    high : float, optional
        Largest value to include, in the unit of the axis.
    """
    every = values[turns.rows(turns.shown)]
    top = max(high, float(np.max(values[turns.rows(1)])), float(np.percentile(every, BULK)))
    top = top if top > 0.0 else 1.0
    axes.set_ylim(1.08 * low, 1.08 * top)
    return ", cut off" if float(np.max(every)) > 1.08 * top else ""


def hold(axes: Axes, *values: Array, least: float = 0.0) -> None:
    """Set the limits of y to all finite values with a margin.

    Parameters
    ----------
    axes : Axes
    *values : array
        In the unit of the axis.
    least : float, optional
        Smallest range, as a share of the largest absolute value.
    """
    known = np.concatenate([value[np.isfinite(value)] for value in values])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    width = max(high - low, least * max(abs(low), abs(high))) or 1.0
    axes.set_ylim(0.5 * (low + high) - 0.58 * width, 0.5 * (low + high) + 0.58 * width)


def legend(made: Figure, *axes: Axes, columns: int = 4) -> None:
    """Draw one legend of all labelled artists below a figure; equal labels appear once.

    Parameters
    ----------
    made : Figure
    *axes : Axes
        Axes with labelled artists.
    columns : int, optional
        Largest number of columns.
    """
    found: dict[str, Artist] = {}
    for one in axes:
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if found:
        longest = max(len(label) for label in found)
        fitting = int(made.get_figwidth() / (0.58 * FONT / 72.0 * longest + 0.55))
        columns = max(1, min(columns, fitting, len(found)))
        made.legend(found.values(), found, frameon=False, fontsize=FONT, loc="outside lower center", ncols=columns)


def square(axes: Axes, reach: float, unit: Scale) -> None:
    """Set equal scales and axis labels for an eccentricity.

    Parameters
    ----------
    axes : Axes
    reach : float
        Half width, in the unit of the axes.
    unit : Scale
        Display unit of the axes.
    """
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel=f"e in x [{unit.unit}]", ylabel=f"e in y [{unit.unit}]")
    axes.set_aspect("equal")
    for side in (axes.xaxis, axes.yaxis):
        side.set_major_locator(MaxNLocator(6, steps=STEPS))
