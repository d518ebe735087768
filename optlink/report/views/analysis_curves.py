"""Curves of an analysis over the crank angle, with exact extremes and gaps at load jumps, and the axes for them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.work import Work
from optlink.linkage.stroke import TURN, Travel
from optlink.report.labels import Label
from optlink.report.style import LIMIT, QUIET, SHADE, WANTED, Scale, degrees
from optlink.tasks.results.analysis import Analysis, Extreme

Array = NDArray[np.float64]
POINTS = 720
TABLE = 2000  # largest number of analysis rows that are added to the points of the curves
NOTHING = 1e-9  # share of the largest value below which a value is rounding error
FONT = 8.5
MANY = 12  # largest number of dead centres to draw; a body at rest has spurious ones due to rounding


class Course:
    """Time history of a machine over the crank angle, in the order of the motion.

    It contains every row of the analysis table (unless there are more than `TABLE`), points between them, the crank angles of all
    extremes, and two points at each jump of a load: the values just before and just after it.
    """

    def __init__(self, result: Analysis) -> None:
        self.result = result
        self.way = 1.0 if result.speed > 0.0 else -1.0
        table = np.radians(result["crank_angle_deg"])
        self.start = float(table[0])
        self.end = self.start + self.way * result.cycle if result.full else float(table[-1])
        low, high = sorted((self.start, self.end))
        marks = [self.inside(at) for extreme in result.extremes.values() for at in (extreme.least_at, extreme.largest_at)]
        grid = np.concatenate([np.linspace(low, high, POINTS + 1), table if len(table) <= TABLE else [], marks])
        grid = np.unique(grid[(grid >= low) & (grid <= high)])
        jumps = np.asarray(result.jumps, dtype=float)
        if jumps.size:
            grid = grid[np.min(np.abs(grid[:, None] - jumps), axis=1) > 1e-9]
        everywhere = np.concatenate([grid, jumps, jumps])
        order = np.argsort(self.way * everywhere, kind="stable")
        self.angles: Array = everywhere[order]
        self.degrees = np.degrees(self.angles)
        machine, speed = result.machine, result.speed
        records = [MotionColumns(machine.moving(grid, speed))]
        if jumps.size:
            records += [MotionColumns(machine.moving(jumps, speed, side=side)) for side in (-1, 1)]
        self.columns = {name: np.concatenate([record[name] for record in records])[order] for name in records[0].columns}
        for name in self.columns:
            if name.endswith(".angle_rad"):
                self.columns[name] = _unwrapped(self.columns[name])
        self.columns["input.work_J"] = Work(machine, self.start, low, high, speed)(self.angles)
        for point, bodies in machine.mechanism.pins.items():
            for name in [point] if len(bodies) == 2 else [f"{point}.{body}" for body in bodies]:
                self.columns[f"{name}.f_N"] = np.hypot(self.columns[f"{name}.fx_N"], self.columns[f"{name}.fy_N"])
        self._pairs = np.flatnonzero(np.diff(self.angles) == 0.0)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def steady(self) -> bool:
        """Whether the crank turns fully and no quantity grows without bound."""
        return self.result.sound and self.result.full

    def peak(self, *names: str) -> float:
        """Return the largest absolute value of the columns [SI], restricted to the range of values that is drawn."""
        windows = [self.window(self.columns[name]) for name in names if name in self.columns]
        return max((max(abs(low), abs(high)) for low, high in windows), default=0.0)

    def window(self, values: Array) -> tuple[float, float]:
        """Return the least and largest value to draw.

        At singular positions or ends of the crank range, where values grow without bound, outliers are cut off.
        """
        known = values[np.isfinite(values)]
        if known.size == 0:
            return 0.0, 0.0
        low, high = float(known.min()), float(known.max())
        if not self.steady:
            first, last = (float(end) for end in np.percentile(known, [8.0, 92.0]))
            if 0.0 < last - first < (high - low) / 8.0:
                low, high = max(low, 2.0 * first - last), min(high, 2.0 * last - first)
        return low, high

    def has(self, name: str, among: Sequence[str] = ()) -> bool:
        """Return whether a column exists and exceeds the rounding error of the other columns.

        Parameters
        ----------
        name : str
            Column name.
        among : sequence of str, optional
            Columns that set the level of rounding.
        """
        return self.peak(name) > NOTHING * self.peak(name, *among) and self.peak(name) > 0.0

    def breaks(self, *names: str) -> list[int]:
        """Return the indices after which one of the columns jumps."""
        found = []
        for k in self._pairs:
            for name in names:
                values = self.columns[name]
                if abs(values[k + 1] - values[k]) > 1e-6 * self.peak(name):
                    found.append(int(k))
                    break
        return found

    def line(self, name: str, factor: float = 1.0) -> tuple[Array, Array]:
        """Return crank angles [deg] and scaled values, with NaN inserted at jumps.

        Parameters
        ----------
        name : str
            Column name.
        factor : float, optional
            Factor from SI to the display unit.
        """
        at = [k + 1 for k in self.breaks(name)]
        return np.insert(self.degrees, at, np.nan), np.insert(self.columns[name] * factor, at, np.nan)

    def inside(self, crank_angle: float) -> float:
        """Return the crank angle [rad] shifted by whole periods into the range of the course."""
        low = min(self.start, self.end)
        return low + (crank_angle - low) % self.result.cycle if self.result.full else crank_angle

    def in_order(self, crank_angles: Sequence[float]) -> list[float]:
        """Return crank angles [rad] shifted into the range of the course, in the order of the motion."""
        return sorted((self.inside(at) for at in crank_angles), key=lambda at: self.way * at)

    def at(self, crank_angle: float, name: str) -> float:
        """Interpolate a column at a crank angle.

        Parameters
        ----------
        crank_angle : float [rad]
            Within the range of the course.
        name : str
            Column name.
        """
        rising = slice(None) if self.way > 0.0 else slice(None, None, -1)
        return float(np.interp(crank_angle, self.angles[rising], self.columns[name][rising]))


def _unwrapped(angles: Array) -> Array:
    found, known = np.array(angles), np.isfinite(angles)
    found[known] = np.unwrap(found[known])
    return found


# --- axes ----------------------------------------------------------------------------------------------------------------


def draw(
    axes: Axes, course: Course, name: str, scale: Scale, colour: str, label: str = "", width: float = 1.7, line: str = "-"
) -> Line2D:
    """Draw a column as a curve; at jumps the curve has a gap, bridged by a dotted line.

    Parameters
    ----------
    axes : Axes
    course : Course
    name : str
        Column name; also the identifier (gid) of the line.
    scale : Scale
        Display unit of the axis.
    colour : str
    label : str, optional
        Entry in the legend; empty for none.
    width : float [pt], optional
    line : str, optional
        Line style of matplotlib.
    """
    x, y = course.line(name, scale.factor)
    drawn = axes.plot(x, y, color=colour, linewidth=width, linestyle=line, label=label or None, gid=name, zorder=3)[0]
    for k in course.breaks(name):
        ends = course.columns[name][k : k + 2] * scale.factor
        axes.plot([course.degrees[k]] * 2, ends, color=colour, linewidth=0.9, linestyle=":", zorder=2.5, gid=f"jump {name}")
    return drawn


def crank_axis(axes: Axes, course: Course, *, named: bool = True) -> None:
    """Set up the crank angle as the x axis, with time increasing to the right, and mark singular positions.

    Parameters
    ----------
    axes : Axes
    course : Course
    named : bool, optional
        Label the axis and the singular positions.
    """
    first, last = math.degrees(course.start), math.degrees(course.end)
    axes.set_xlim(first, last)
    for position in course.result.ranges.singular:
        at = math.degrees(course.inside(position.crank_angle))
        axes.axvline(at, color=LIMIT, linewidth=1.2, linestyle="--", zorder=1.5, gid="singular position")
        if named:
            words = "not determined beyond "
            axes.text(
                at, 1.0, words, transform=axes.get_xaxis_transform(), ha="right", va="top", rotation=90, fontsize=8, color=LIMIT
            )
    if course.result.full:
        axes.xaxis.set_major_locator(MultipleLocator(60.0))
    if named:
        axes.set_xlabel("crank angle φ [deg]" + ("" if course.way > 0.0 else ", clockwise to the right"))


def fit(axes: Axes, course: Course, *lines: Line2D, room: float = 0.16, least: float = 0.0) -> bool:
    """Set the limits of y to the lines, leaving room for labels; values that grow without bound are cut off.

    Parameters
    ----------
    axes : Axes
    course : Course
    *lines : Line2D
        Lines on `axes`.
    room : float, optional
        Margin above and below, as a share of the range.
    least : float, optional
        Smallest range of y, in the unit of the axis.

    Returns
    -------
    bool
        Whether the limits contain all values.
    """
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in lines] or [np.zeros(1)])
    low, high = course.window(values)
    whole = bool(np.all((values >= low) & (values <= high) | np.isnan(values)))
    amount = max(abs(low), abs(high))
    width = high - low if high - low > NOTHING * amount else amount or 1.0
    if width < least:
        low, high, width = 0.5 * (low + high - least), 0.5 * (low + high + least), least
    axes.set_ylim(low - room * width, high + room * width)
    return whole


def extremes(
    axes: Axes, course: Course, name: str, scale: Scale, colour: str = WANTED, extreme: Extreme | None = None
) -> list[Label]:
    """Mark the least and largest value of a column with markers at their exact crank angles and return the labels.

    Parameters
    ----------
    axes : Axes
    course : Course
    name : str
        Column name.
    scale : Scale
        Display unit of the axis.
    colour : str, optional
    extreme : Extreme or None, optional
        Values to mark [SI]; default: the extremes of the column in the analysis.
    """
    extreme = course.result.extremes.get(name) if extreme is None else extreme
    if extreme is None or not math.isfinite(extreme.least) or extreme.largest - extreme.least <= NOTHING * course.peak(name):
        return []
    found = []
    low, high = axes.get_ylim()
    for value, at, way in ((extreme.least, extreme.least_at, -1.0), (extreme.largest, extreme.largest_at, 1.0)):
        x, y = math.degrees(course.inside(at)), value * scale.factor
        held = min(max(y, low), high)
        marker = "o" if held == y else "^" if y > high else "v"
        axes.plot(
            [x],
            [held],
            marker=marker,
            color=colour,
            markersize=4.5,
            linestyle="none",
            clip_on=False,
            zorder=5,
            gid=f"extreme {name}",
        )
        found.append(
            Label(axes, (x, held), f"{scale.text(value)} at {degrees(at)}", colour, FONT, 3.0, (0.0, way if held == y else -way))
        )
    return found


def zero(axes: Axes) -> None:
    """Draw a thin line at zero if zero is within the limits of y."""
    low, high = axes.get_ylim()
    if low < 0.0 < high:
        axes.axhline(0.0, color=QUIET, linewidth=0.8, zorder=1)


def strokes(axes: Axes, course: Course, travel: Travel | None, *, named: bool = False) -> None:
    """Draw dead centres as vertical lines and shade the quick stroke.

    Parameters
    ----------
    axes : Axes
    course : Course
    travel : Travel or None
        Stroke or swing of the output; None draws nothing.
    named : bool, optional
        Write the crank rotation of both strokes below the curve.
    """
    if travel is None:
        return
    centres = course.in_order(travel.dead_centres)
    for at in centres if len(centres) <= MANY else []:
        axes.axvline(math.degrees(at), color=QUIET, linewidth=1.0, linestyle="--", zorder=1.5, gid="dead centre")
    if not (course.result.full and len(centres) == 2 and travel.time_ratio > 1.0 + 1e-6):
        return
    one = abs(centres[1] - centres[0])
    between, around = [(centres[0], centres[1])], [(course.start, centres[0]), (centres[1], course.end)]
    quick, slow = (between, around) if one < TURN - one else (around, between)
    for a, b in quick:
        axes.axvspan(*sorted((math.degrees(a), math.degrees(b))), color=SHADE, linewidth=0.0, alpha=0.55, zorder=0.5, gid="shade")
    if named:
        low, high = axes.get_ylim()
        axes.set_ylim(low - 0.13 * (high - low), high)
        for word, pieces in (("quick", quick), ("slow", slow)):
            a, b = max(pieces, key=lambda piece: abs(piece[1] - piece[0]))
            if abs(b - a) > math.radians(100.0):
                turned = math.degrees(sum(abs(end - begin) for begin, end in pieces))
                x = (0.5 * math.degrees(a + b), 0.03)
                axes.text(
                    *x, f"{word} {turned:.2f}°", transform=axes.get_xaxis_transform(), ha="center", fontsize=8, color="#7a6a45"
                )
