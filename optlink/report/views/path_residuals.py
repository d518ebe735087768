"""Figure of the deviations of a path or motion synthesis at every point."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from optlink.report.style import FOUND, HALO, LIMIT, QUIET, WANTED, figure, styled
from optlink.report.views.path_captions import entitle, figures, fitting, length, title_of, wrapped
from optlink.report.views.path_closeup import ALLOWED, NUMBERED
from optlink.report.views.path_tables import exact_angles
from optlink.report.views.path_view import Track, best
from optlink.tasks.results.path import LEVEL, PathResult

Array = NDArray[np.float64]
BARS = 40  # number of points up to which each has a bar
CUT = 4.0  # points without tolerance are cut off beyond this multiple of the deviations with tolerance
NOTHING = 1e-3  # components below this share of the largest deviation are not shown


@styled
def errors(result: PathResult) -> Figure | None:
    """Draw the deviation at every point: distance, components, and for poses the angle."""
    track = best(result)
    if track is None or not track.task.pointed:
        return None
    turned = track.design.measured.turned
    count = 1 + (not track.exact) + (turned is not None)
    made = figure(7.6, 1.5 + 1.95 * count)
    panels = made.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    _distances(panels[0], track)
    if not track.exact:
        _directions(panels[1], track)
    if turned is not None:
        _turned(panels[-1], track)
    numbers = len(track.wanted)
    panels[-1].set_xlim(0.4, numbers + 0.6)
    every = FixedLocator(range(1, numbers + 1)) if numbers <= NUMBERED else MaxNLocator(12, integer=True)
    panels[-1].xaxis.set_major_locator(every)
    panels[-1].set_xlabel("pose" if turned is not None else "point")
    title = title_of(track, 7.2, f"{track.task.title}: deviations", wrapped(figures(track), 7.2, "; "))
    entitle(made, track, title)
    made.align_ylabels()
    return made


def _bars(
    axes: Axes, values: Array, colour: str, gid: str, label: str | None = None, place: float = 0.0, wide: float = 0.6
) -> None:
    """Draw a bar for each point, or a stepped line if there are many."""
    numbers = np.arange(1.0, len(values) + 1.0)
    if len(values) <= BARS:
        drawn = axes.bar(numbers + place, values, width=wide, color=colour, label=label, zorder=2)
        for bar in drawn:
            bar.set_gid(gid)
    else:
        axes.plot(numbers, values, drawstyle="steps-mid", color=colour, linewidth=1.2, label=label, gid=gid)


def _rounding(axes: Axes, values: Array, level: float, unit: str) -> None:
    """Draw deviations that are rounding error on a logarithmic axis, with the level of rounding."""
    numbers = np.arange(1.0, len(values) + 1.0)
    low = 1e-9 * level
    axes.plot(numbers, np.maximum(values, low), linestyle="none", marker="o", markersize=4, color=QUIET, gid="exact")
    axes.axhline(level, color=FOUND, linewidth=1.1, linestyle="--", gid="level")
    told = f"exact to rounding: all below {level:.1e} {unit}"
    axes.annotate(
        told, (0.99, level), (0, 4), xycoords=("axes fraction", "data"), textcoords="offset points", ha="right", fontsize=9
    )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0e}"))
    axes.set_ylim(low / 3.0, 1e4 * level)


def _bulk(track: Track) -> NDArray[np.bool_]:
    """Return the points whose bars set the scale.

    These are all points, or only those with a tolerance if the others deviate so far that they would hide them.
    """
    distances, known = track.design.measured.distances, np.isfinite(track.tolerances)
    if not np.any(known) or np.all(known):
        return np.ones(len(known), dtype=bool)
    near = max(float(np.nanmax(distances[known])), float(np.max(track.tolerances[known])))
    return known if float(np.nanmax(distances[~known])) > CUT * near else np.ones(len(known), dtype=bool)


def _legend(axes: Axes) -> None:
    """Place the legend above the axes."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, frameon=False, fontsize=8.5, ncols=2)


def _cut(axes: Axes, values: Array, place: float = 0.0) -> None:
    """Annotate bars that exceed the axes with their values."""
    low, high = axes.get_ylim()
    for k, value in enumerate(values):
        if not low <= value <= high:
            up = value > high
            told = f"{'↑' if up else '↓'} {value:.4g}".replace("-", "−")
            at = (k + 1.0 + place, high if up else low)
            drawn = axes.annotate(told, at, (0, -3 if up else 3), textcoords="offset points", ha="center", fontsize=8.0)
            drawn.set(va="top" if up else "bottom", path_effects=HALO, gid="cut off", zorder=5)


def _distances(axes: Axes, track: Track) -> None:
    distances, tolerances = track.design.measured.distances, track.tolerances
    if track.exact:
        unit = track.sketch.scale
        _rounding(axes, distances * unit.factor, LEVEL * track.task.size * unit.factor, unit.unit)
        axes.set_ylabel(f"distance [{unit.unit}]")
        return
    largest = float(np.nanmax(distances))
    unit = fitting(largest, track.sketch.scale)
    _bars(axes, distances * unit.factor, FOUND, "distances")
    known = np.isfinite(tolerances)
    bulk = _bulk(track)
    top = float(np.nanmax(distances[bulk]))
    for bar, distance, tolerance in zip(axes.patches, distances, tolerances, strict=False):
        if distance > tolerance * (1.0 + 1e-6):
            bar.set_facecolor(LIMIT)
    if np.any(known):
        seen = known & (tolerances <= 4.0 * largest)
        top = max(top, float(np.max(tolerances[seen], initial=0.0)))
        numbers = np.arange(1.0, len(distances) + 1.0)[seen]
        edges = np.stack([numbers - 0.5, numbers + 0.5, np.full_like(numbers, np.nan)], axis=1).ravel()
        heights = np.repeat(tolerances[seen] * unit.factor, 3)
        axes.plot(edges, heights, color=ALLOWED, linewidth=1.8, label="tolerance", gid="tolerance")
        if not np.all(seen[known]):
            least = length(float(np.min(tolerances[known & ~seen])), track.sketch.scale)
            axes.plot(
                [],
                [],
                linestyle="none",
                label=f"tolerances from {least} on lie above" if np.any(seen) else f"tolerance, {least}, lies above",
            )
        _legend(axes)
    axes.set_ylim(0.0, 1.1 * top * unit.factor)
    _cut(axes, distances * unit.factor)
    axes.set_ylabel(f"distance [{unit.unit}]")


def _directions(axes: Axes, track: Track) -> None:
    """Draw the components along and across the curve, to the left of the motion; x and y where the velocity vanishes."""
    miss = track.generated - track.wanted
    speed = track.way * track.at.velocity(track.task.requirement.point)
    fast = np.linalg.norm(speed, axis=1)
    largest = float(np.nanmax(np.linalg.norm(miss, axis=1)))
    unit = fitting(largest, track.sketch.scale)
    parts = {"in x": miss[:, 0], "in y": miss[:, 1]}
    if np.all(np.isfinite(fast)) and float(np.min(fast)) > 1e-9 * track.task.size:
        (tx, ty), (x, y) = (speed / fast[:, None]).T, miss.T
        parts = {"along the curve": tx * x + ty * y, "across, to the left": tx * y - ty * x}
        along, across = parts.values()
        if float(np.max(np.abs(along))) < NOTHING * largest:
            parts = {"across the curve, to the left; along it none": across}
        elif float(np.max(np.abs(across))) < NOTHING * largest:
            parts = {"along the curve; across it none": along}
    two, bulk = len(parts) > 1, _bulk(track)
    for k, (name, values) in enumerate(parts.items()):
        place, wide = ((k - 0.5) * 0.36, 0.34) if two else (0.0, 0.6)
        _bars(axes, values * unit.factor, QUIET if two and k == 0 else FOUND, name, name, place, wide)
    axes.axhline(0.0, color=WANTED, linewidth=0.8)
    every = np.array([values[bulk] for values in parts.values()]) * unit.factor
    low, high = min(0.0, float(np.nanmin(every))), max(0.0, float(np.nanmax(every)))
    axes.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))
    for k, values in enumerate(parts.values()):
        _cut(axes, values * unit.factor, (k - 0.5) * 0.36 if two else 0.0)
    axes.set_ylabel(f"generated\nminus wanted [{unit.unit}]")
    _legend(axes)


def _turned(axes: Axes, track: Track) -> None:
    turned = track.design.measured.turned
    assert turned is not None
    if exact_angles(track.design):
        _rounding(axes, np.degrees(np.abs(turned)), math.degrees(LEVEL), "deg")
    else:
        _bars(axes, np.degrees(turned), FOUND, "turned")
        axes.axhline(0.0, color=WANTED, linewidth=0.8)
    axes.set_ylabel("generated minus\nwanted angle [deg]")
