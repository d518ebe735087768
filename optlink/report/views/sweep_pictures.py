"""Files and figures of a parameter sweep: curves over one parameter, a map over two, several maps over three."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from optlink.report.files import write_json
from optlink.report.style import BODIES, FOUND, LIMIT, QUIET, WANTED, figure, heading, save, styled
from optlink.studies.analysis_task import FIGURES
from optlink.studies.grid import Axis
from optlink.studies.sweep import CHANGED, TEXT, Sweep

Array = NDArray[np.float64]

LARGE = 200_000  # largest number of points drawn
SLICES = 6  # largest number of maps for three parameters
PANELS = 4  # largest number of analysed columns drawn
EMPTY = "#e4e4e4"  # colour of points without a design
_UNIT = re.compile(r"(.+)_((?:rad|m)_s2?|(?:rad|mm|m|deg)2?|N|Nm|W|J)")


@dataclass(frozen=True)
class Grid:
    """Table of a sweep over the parameters with several values, each in rising order; `given` are the other parameters."""

    axes: tuple[Axis, ...]
    given: tuple[str, ...]
    order: NDArray[np.int_]
    result: Sweep

    @classmethod
    def of(cls, result: Sweep) -> Grid:
        """Return the grid of a sweep."""
        axes = [axis for axis in result.grid.axes if len(axis.values) > 1]
        given = [f"{axis.key} {axis.values[0]:g} {axis.unit}".rstrip() for axis in result.grid.axes if len(axis.values) == 1]
        numbers = np.arange(result.grid.count).reshape([len(axis.values) for axis in axes])
        for k, axis in enumerate(axes):
            numbers = np.take(numbers, np.argsort(axis.values), axis=k)
        return cls(tuple(Axis(a.key, a.unit, tuple(sorted(a.values))) for a in axes), tuple(given), numbers, result)

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of the table, shaped like the grid."""
        found: NDArray[Any] = self.result.columns[name][self.order]
        return found

    @property
    def states(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks of active-set changes and of unproven designs; all false for a sweep of analyses."""
        if self.result.evaluated:
            nowhere = np.zeros(self.order.shape, dtype=bool)
            return nowhere, nowhere
        return self.column(CHANGED), ~self.column("valid")

    @property
    def empty(self) -> str:
        """Meaning of a point without a value."""
        return "no valid figures" if self.result.evaluated else "no design"

    @property
    def shown(self) -> tuple[str, ...]:
        """Columns to draw: the objective, or the analysed quantities."""
        names = tuple(n for n in self.result.names[len(self.result.grid.axes) :] if n not in (*TEXT, "valid"))
        return names if self.result.evaluated else tuple(name for name in names if name.startswith("objective"))


def write_all(result: Sweep, folder: Path) -> list[Path]:
    """Write result.json and the figure (if one to three parameters have several values); return the paths.

    The table of the points exists already.

    Parameters
    ----------
    result : Sweep
    folder : Path
        Existing folder to write to.
    """
    written = [folder / "result.json"]
    write_json(written[0], result.to_dict())
    several = sum(len(axis.values) > 1 for axis in result.grid.axes)
    if 1 <= several <= 3 and result.grid.count <= LARGE:
        written.append(folder / "sweep.png")
        save(picture(result), written[-1])
    return written


@styled
def picture(result: Sweep) -> Figure:
    """Draw curves over one parameter, a map over two, or maps for some values of the first of three."""
    grid = Grid.of(result)
    return (_curves, _maps, _slices)[len(grid.axes) - 1](grid)


# --- labels ----------------------------------------------------------------------------------------------------------------


def named(column: str) -> tuple[str, str]:
    """Return display name and unit of a column."""
    match = _UNIT.fullmatch(column)
    if match is None:
        return column, ""
    name, unit = match.groups()
    return name, unit.replace("_", "/").replace("Nm", "N m").removesuffix("2") + ("²" if unit.endswith("2") else "")


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _title(grid: Grid, what: str, width: float) -> str:
    given = f", {', '.join(grid.given)}" if grid.given else ""
    return heading(f"{grid.result.problem.model.title}: {what}{given}", width)


def _spread(axis: Axis) -> str:
    """Return the scale of an axis: logarithmic if the ratios of its values are constant."""
    values = np.array(axis.values)
    even = len(values) > 2 and values[0] > 0.0 and np.allclose(np.diff(np.log(values)), np.log(values[1] / values[0]), rtol=1e-6)
    return "log" if even and not np.allclose(np.diff(values), values[1] - values[0], rtol=1e-6) else "linear"


def _scaled(axis: XAxis | YAxis, scale: str) -> None:
    """Set the scale of an axis; a logarithmic one has ticks at 1, 2 and 5 of every decade."""
    (axis.axes.set_xscale if axis.axis_name == "x" else axis.axes.set_yscale)(scale)
    if scale == "log":
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def _analysed(grid: Grid) -> dict[str, tuple[str, ...]]:
    """Return the analysed columns, each with the names of its measures."""
    found: dict[str, tuple[str, ...]] = {}
    for name in grid.shown:
        column = _parted(name)[0]
        found[column] = (*found.get(column, ()), name)
    return dict(list(found.items())[:PANELS])


def _parted(name: str) -> tuple[str, str]:
    """Split a name into column and measure; the measure is empty if there is none."""
    stem, _, kind = name.rpartition(".")
    return (stem, kind) if kind in FIGURES else (name, "")


WORDS = {"min": "least", "max": "largest", "rms": "rms"}
assert set(WORDS) == set(FIGURES)


# --- one parameter -----------------------------------------------------------------------------------------------------------


def _curves(grid: Grid) -> Figure:
    """Draw the objective and below it the design variables, one panel per unit; or the analysed quantities."""
    (axis,) = grid.axes
    panels = list(_analysis_panels(grid)) if grid.result.evaluated else list(_design_panels(grid))
    drawn = figure(8.0, 1.2 + 2.5 * len(panels))
    rows: Any = drawn.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    x = np.array(axis.values)
    marker = "." if len(x) <= 30 else ""
    for axes, (label, curves) in zip(rows, panels, strict=True):
        for (name, values), colour in zip(curves.items(), (FOUND, *BODIES[1:]) * len(curves), strict=False):
            axes.plot(x, values, color=colour, marker=marker, label=name)
        axes.set_ylabel(label)
        _scaled(axes.xaxis, _spread(axis))
        if len(curves) > 1:
            axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    rows[-1].set_xlabel(_label(axis.key, axis.unit))
    _marked_curves(grid, drawn, rows, x)
    drawn.suptitle(_title(grid, f"over {axis.key}", 7.6), x=0.01, ha="left", fontsize=11)
    return drawn


def _design_panels(grid: Grid) -> Iterator[tuple[str, dict[str, Array]]]:
    """Yield the label of each panel with its curves by name."""
    (objective,) = grid.shown
    yield _label(*named(objective)), {"objective": grid.column(objective)}
    names = grid.result.names[len(grid.result.grid.axes) : grid.result.names.index(objective)]
    by_unit: dict[str, dict[str, Array]] = {}
    for column in names:
        name, unit = named(column)
        by_unit.setdefault(unit, {})[name] = grid.column(column)
    for unit, curves in by_unit.items():
        yield _label("free sizes" if len(curves) > 1 else next(iter(curves)), unit), curves


def _analysis_panels(grid: Grid) -> Iterator[tuple[str, dict[str, Array]]]:
    for column, names in _analysed(grid).items():
        yield _label(*named(column)), {WORDS.get(_parted(name)[1], name): grid.column(name) for name in names}


def _marked_curves(grid: Grid, drawn: Figure, rows: Sequence[Axes], x: Array) -> None:
    """Mark active-set changes, unproven designs and points without a design."""
    handles: list[Any] = []
    values = grid.column(grid.shown[0])
    there = np.isfinite(values)
    changed, missed = (there & mask for mask in grid.states)
    if np.any(changed):
        for axes in rows:
            for at in x[changed]:
                axes.axvline(at, color=QUIET, linestyle=":", linewidth=1.0)
        handles.append(Line2D([], [], color=QUIET, linestyle=":", linewidth=1.0, label="other limits begin to hold"))
    if np.any(missed):
        rows[0].plot(x[missed], values[missed], "x", color=LIMIT, gid="not proven")
        handles.append(Line2D([], [], color=LIMIT, marker="x", linestyle="none", label="not proven"))
    if not np.all(there):
        edges = _edges(x, log=rows[0].get_xscale() == "log")
        for axes in rows:
            for k in np.flatnonzero(~there):
                axes.axvspan(edges[k], edges[k + 1], color=EMPTY, linewidth=0.0, zorder=0.5, gid="no design")
            axes.set_xlim(edges[0], edges[-1])
        handles.append(Patch(color=EMPTY, label=grid.empty))
    if handles:
        drawn.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)


def _edges(x: Array, *, log: bool) -> Array:
    """Return the cell borders around rising values, shape (n + 1,)."""
    own = np.log(x) if log else x
    middle = 0.5 * (own[1:] + own[:-1])
    found = np.concatenate([[1.5 * own[0] - 0.5 * own[1]], middle, [1.5 * own[-1] - 0.5 * own[-2]]])
    return np.exp(found) if log else found


# --- two and three parameters ------------------------------------------------------------------------------------------------


def _maps(grid: Grid) -> Figure:
    """Draw a map of the objective, or maps of the least, largest and RMS value of the first analysed column."""
    names = next(iter(_analysed(grid).values())) if grid.result.evaluated else grid.shown
    width, height = (8.0, 5.6) if len(names) == 1 else (13.0, 4.6)
    drawn = figure(width, height)
    panels: Any = drawn.subplots(1, len(names), squeeze=False, sharey=True)[0]
    handles: dict[str, Any] = {}
    for axes, name in zip(panels, names, strict=True):
        values = np.asarray(grid.column(name), dtype=float)
        shaded = _field(grid, axes, values, None, ...)
        what, kind = _parted(name) if grid.result.evaluated else (name, "")
        drawn.colorbar(shaded, ax=axes, label=" ".join(filter(None, [WORDS.get(kind, ""), _label(*named(what))])))
        axes.set_xlabel(_label(grid.axes[1].key, grid.axes[1].unit))
        handles |= _marks(grid, axes, values, ...)
    panels[0].set_ylabel(_label(grid.axes[0].key, grid.axes[0].unit))
    return _finished(grid, drawn, handles, f"over {grid.axes[0].key} and {grid.axes[1].key}", width)


def _slices(grid: Grid) -> Figure:
    """Draw maps over the second and third parameter for some values of the first, with a common colour scale."""
    slow, side, up = grid.axes[0], grid.axes[2], grid.axes[1]
    count = min(SLICES, len(slow.values))
    chosen = np.unique(np.linspace(0, len(slow.values) - 1, count).round().astype(int))
    columns = 2 if len(chosen) in (2, 4) else min(3, len(chosen))
    lines = math.ceil(len(chosen) / columns)
    names = next(iter(_analysed(grid).values())) if grid.result.evaluated else grid.shown
    name = next((name for name in names if name.endswith(".rms")), names[0])
    values = np.asarray(grid.column(name), dtype=float)
    known = values[chosen][np.isfinite(values[chosen])]
    span = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    drawn = figure(13.0, 1.2 + 3.4 * lines)
    panels: Any = drawn.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    handles: dict[str, Any] = {}
    shaded: Any = None
    for k, axes in enumerate(panels.ravel()):
        if k >= len(chosen):
            axes.set_axis_off()
            continue
        at = int(chosen[k])
        shaded = _field(grid, axes, values[at], span, at)
        handles |= _marks(grid, axes, values[at], at)
        axes.set_title(f"{slow.key} {slow.values[at]:.6g} {slow.unit}".rstrip(), fontsize=9.5)
        if k + columns >= len(chosen):
            axes.set_xlabel(_label(side.key, side.unit))
            axes.tick_params(labelbottom=True)
        if k % columns == 0:
            axes.set_ylabel(_label(up.key, up.unit))
    what, kind = _parted(name) if grid.result.evaluated else (name, "")
    words = " ".join(filter(None, [WORDS.get(kind, ""), _label(*named(what))]))
    drawn.colorbar(shaded, ax=panels.ravel().tolist(), label=words)
    some = "" if len(chosen) == len(slow.values) else f" ({len(chosen)} of its {len(slow.values)} values)"
    return _finished(grid, drawn, handles, f"over {slow.key}{some}, {up.key} and {side.key}", 13.0)


def _field(grid: Grid, axes: Axes, values: Array, span: tuple[float, float] | None, at: Any) -> Any:
    """Draw a map over the last two parameters, grey where there is no design."""
    up, side = grid.axes[-2:]
    scales = _spread(side), _spread(up)
    edges = [_edges(np.array(axis.values), log=s == "log") for axis, s in zip((side, up), scales, strict=True)]
    axes.set_facecolor(EMPTY)
    low, high = (None, None) if span is None else span
    shaded = axes.pcolormesh(*edges, np.ma.masked_invalid(values), cmap="viridis", vmin=low, vmax=high, rasterized=True)
    _scaled(axes.xaxis, scales[0])
    _scaled(axes.yaxis, scales[1])
    axes.grid(visible=False)
    return shaded


def _marks(grid: Grid, axes: Axes, values: Array, at: Any) -> dict[str, Any]:
    """Draw the marks of a map and return their legend entries."""
    found: dict[str, Any] = {}
    there = np.isfinite(values)
    x, y = np.meshgrid(grid.axes[-1].values, grid.axes[-2].values)
    if not np.all(there):
        found[grid.empty] = Patch(color=EMPTY)
    many = 3.0 if max(values.shape) > 30 else 5.0
    changed, missed = (there & mask[at] for mask in grid.states)
    styles: tuple[tuple[NDArray[np.bool_], str, dict[str, Any]], ...] = (
        (changed, "other limits begin to hold", {"marker": ".", "color": "white", "markersize": many, "markeredgewidth": 0.0}),
        (missed, "not proven", {"marker": "x", "color": LIMIT, "markersize": 5.0}),
    )
    for mask, word, style in styles:
        if np.any(mask):
            axes.plot(x[mask], y[mask], linestyle="none", gid=word, **style)
            outlined = {"color": "white", "markeredgecolor": WANTED, "markeredgewidth": 0.5, "markersize": 6.0}
            found[word] = Line2D([], [], linestyle="none", **{**style, **(outlined if style["marker"] == "." else {})})
    return found


def _finished(grid: Grid, drawn: Figure, handles: dict[str, Any], what: str, width: float) -> Figure:
    if handles:
        drawn.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=3, frameon=False)
    drawn.suptitle(_title(grid, what, 0.95 * width), x=0.01, ha="left", fontsize=11)
    return drawn
