"""Tables, charts and page of a sweep: curves over one parameter, a map over two, maps over three, extremes over more."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from optlink.presentation import chart_spec
from optlink.presentation.chart_spec import (
    BODIES,
    LIMIT,
    MUTED,
    RESULT,
    Array,
    ChartSpec,
    Curve,
    HeatMap,
    Line,
    Panel,
    Picks,
    Span,
    cells,
    charts_per_row,
    max_abs,
)
from optlink.presentation.format import (
    column_unit,
    figure,
    joined,
    number,
    scale,
)
from optlink.presentation.shapes import even
from optlink.presentation.table_spec import (
    Paragraph,
    Row,
    Summary,
    TableSpec,
    bad,
    quiet,
    summary,
    table,
    verdict,
)
from optlink.presentation.view import PageSection, StoredStudy, View
from optlink.presentation.views.revolutions import runs
from optlink.problem.file import ProblemFile
from optlink.studies.grid import Axis, column_name
from optlink.studies.sweep_task import FIGURES
from optlink.studies.sweeps import CHANGED, COMPLETE, MAX_ROWS, TEXT, Sweep
from optlink.units import count_noun

MAX_LISTED = 12  # largest number of active-set changes and of points listed
MAX_COLUMNS = 5  # largest number of quantities side by side
SHOWN_IN = {"m": (1e3, "mm"), "m²": (1e6, "mm²"), "rad": (math.degrees(1.0), "deg")}
"""Factor from SI and display unit, by the SI unit of a column; others are shown in SI."""

MAX_CURVE_POINTS = 4000  # largest number of points of a curve; larger sweeps are thinned evenly
MAX_SELECTABLE = 1500  # largest number of selectable points
MAX_MAPS = 6  # largest number of maps for three parameters
MAX_PANELS = 4  # largest number of stacked panels
MAX_LINES = 200  # largest number of active-set changes drawn
ACTIVE, OTHER = "active constraints", "other constraints become active"
NO_DESIGN = "#e4e4e4"  # colour of points without a design
WORDS = dict(zip(FIGURES, ("least", "largest", "rms"), strict=True))


@dataclass(frozen=True)
class SweepTable:
    """Table of a sweep over the parameters with several values, each in rising order; `fixed` are the other parameters."""

    axes: tuple[Axis, ...]
    fixed: tuple[str, ...]
    order: NDArray[np.int_]
    result: Sweep

    @classmethod
    def of(cls, result: Sweep) -> SweepTable:
        """Return the table of a sweep."""
        axes = [axis for axis in result.grid.axes if len(axis.values) > 1]
        fixed = [f"{axis.key} {axis.values[0]:g} {axis.unit}".rstrip() for axis in result.grid.axes if len(axis.values) == 1]
        numbers = np.arange(result.grid.count).reshape([len(axis.values) for axis in axes])
        for k, axis in enumerate(axes):
            numbers = np.take(numbers, np.argsort(axis.values), axis=k)
        return cls(tuple(Axis(a.key, a.unit, tuple(sorted(a.values))) for a in axes), tuple(fixed), numbers, result)

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of the table in display units, shaped like the grid."""
        values: NDArray[Any] = self.result.columns[name][self.order]
        factor = _display(name)[1]
        return values if factor == 1.0 else values * factor

    @property
    def states(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks of active-set changes and of points without a verified design; all false for a sweep of analyses."""
        if self.result.evaluated:
            nowhere = np.zeros(self.order.shape, dtype=bool)
            return nowhere, nowhere
        return self.column(CHANGED), ~self.column("valid")

    @property
    def designs(self) -> tuple[str, ...]:
        """Columns of the design variables."""
        names = self.result.names[len(self.result.grid.axes) :]
        return () if self.result.evaluated else names[: names.index(self.shown[0])]

    @property
    def best(self) -> int | None:
        """Row of the valid point with the least objective; None if there is none."""
        if self.result.evaluated:
            return None
        values = np.where(self.result.columns["valid"], self.result.columns[self.shown[0]], np.nan)
        return None if np.all(np.isnan(values)) else int(np.nanargmin(values))

    @property
    def empty(self) -> str:
        """Meaning of a point without a value."""
        return "no valid result" if self.result.evaluated else "no design"

    @property
    def shown(self) -> tuple[str, ...]:
        """Columns to draw: the objective, or the analysed quantities, without those that have one value at all points."""
        names = tuple(n for n in self.result.names[len(self.result.grid.axes) :] if n not in (*TEXT, "valid"))
        if self.result.evaluated:
            return tuple(name for name in names if len(np.unique(self.result.columns[name])) > 1) or names
        return tuple(name for name in names if name.startswith("objective"))


# --- the page ----------------------------------------------------------------------------------------------------------------


def page(result: Sweep) -> StoredStudy:
    """Return the page of a sweep."""
    problem, table, shown = result.problem, SweepTable.of(result), overview(result)
    if result.evaluated:
        counted = ", ".join(f"{count:,} {status}" for status, count in result.statuses.items()) or "analysed"
        by = f"{'simulation' if result.mode == 'simulate' else 'analysis'} of every point"
    else:
        counted_points = f"{count_noun(result.valid_points, 'point')} verified, {result.grid.count - result.valid_points:,} not"
        counted = "every point a verified local optimum" if result.status == COMPLETE else counted_points
        by = f"a local optimum at every point, verified by the validator; {searches(result)}"
    return StoredStudy(
        problem=problem,
        kind="sweep",
        verdict=counted[0].upper() + counted[1:],
        valid=result.valid,
        conclusion=conclusion(result),
        status=shown.status.lines,
        sections=[PageSection("Sweep", charts(result)), PageSection("Figures", (shown.parts,))],
        design=None if table.best is None else _design(table, table.best),
        by=by,
        drawn="The best point of the sweep.",
        after=1,
    )


def _design(table: SweepTable, row: int) -> tuple[ProblemFile, dict[str, float]]:
    """Return the problem and the design [SI] of a row."""
    problem, columns = table.result.problem.override(table.result.grid.changes(row)), table.result.columns
    names = {name: column_name(name, quantity.display[1]) for name, quantity in problem.model.quantities.items()}
    return problem, {name: float(columns[own][row]) for name, own in names.items() if own in table.designs}


# --- labels ----------------------------------------------------------------------------------------------------------------


def _column_text(name: str) -> str:
    """Return the display name of a column with its measure and display unit."""
    words, _, unit = _display(name)
    return with_unit(words, unit)


def _display(name: str) -> tuple[str, float, str]:
    """Return the display name of a column with its measure, the factor from SI to its display unit, and that unit."""
    stem, kind = _column_and_measure(name)
    words, unit = column_unit(stem)
    factor, shown = SHOWN_IN.get(unit, (1.0, unit))
    return f"{WORDS.get(kind, '')} {words}".strip(), factor, shown


def _axis_of(axis: Axis, limits: tuple[float, float] | None = None) -> chart_spec.Axis:
    return chart_spec.Axis(with_unit(axis.key, axis.unit), limits, _axis_scale(axis))


def _axis_scale(axis: Axis) -> Literal["linear", "log"]:
    """Return the scale of an axis: logarithmic if the ratios of its values are constant."""
    values = np.array(axis.values)
    even = len(values) > 2 and values[0] > 0.0 and np.allclose(np.diff(np.log(values)), np.log(values[1] / values[0]), rtol=1e-6)
    return "log" if even and not np.allclose(np.diff(values), values[1] - values[0], rtol=1e-6) else "linear"


def _measures_by_column(table: SweepTable) -> dict[str, tuple[str, ...]]:
    """Return the analysed columns, each with the names of its measures."""
    columns: dict[str, tuple[str, ...]] = {}
    for name in table.shown:
        column = _column_and_measure(name)[0]
        columns[column] = (*columns.get(column, ()), name)
    return dict(list(columns.items())[:MAX_PANELS])


def _column_and_measure(name: str) -> tuple[str, str]:
    """Split a name into column and measure; the measure is empty if there is none."""
    stem, _, kind = name.rpartition(".")
    return (stem, kind) if kind in FIGURES else (name, "")


# --- charts ------------------------------------------------------------------------------------------------------------------


def charts(result: Sweep) -> list[ChartSpec]:
    """Return the charts over the parameters that have several values."""
    table = SweepTable.of(result)
    if not table.axes or result.grid.count > MAX_ROWS:
        return _extreme_charts(table)
    if len(table.axes) == 1:
        return [_curves(table)]
    if len(table.axes) == 2:
        return _maps(table)
    return [*(_slices(table) if len(table.axes) == 3 else []), *_extreme_charts(table)]


def _heading(table: SweepTable, what: str) -> str:
    fixed = f", {', '.join(table.fixed)}" if table.fixed else ""
    return f"{table.result.problem.model.title}: {what}{fixed}"


def _picks(table: SweepTable, rows: NDArray[np.intp], x: Array, y: Array) -> Picks:
    """Tabulate the design of every selectable row (n,) of the table of the sweep, with its place."""
    columns, result = table.result.columns, table.result
    names = [*table.shown, *table.designs]
    factors = [_display(name)[1] for name in names]
    heads = [with_unit(axis.key, axis.unit) for axis in result.grid.axes]
    heads += map(_column_text, names)
    words = {"status": "status", "reason": "reason"} if result.evaluated else {ACTIVE: "active", "status": "status"}
    blank = np.full(result.grid.count, "")
    texts = [columns.get(name, blank) for name in words.values()]
    point_texts = []
    for k in rows:
        values = [*result.grid.values(int(k))]
        values += [float(columns[name][k]) * factor for name, factor in zip(names, factors, strict=True)]
        point_texts.append(
            (*(number(value, 7) for value in values), *(str(column[k]) or "none" * (ACTIVE in words) for column in texts))
        )
    first = 0 if table.best is None else int(np.argmin(np.abs(rows - table.best)))
    return Picks("point", (*heads, *words), tuple(point_texts), x, y, first, [int(k) for k in rows])


def _selectable(table: SweepTable, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the selectable rows: all, or an even selection with the best."""
    if len(rows) <= MAX_SELECTABLE:
        return np.sort(rows)
    selection = np.sort(rows)[even(len(rows), MAX_SELECTABLE)]
    return np.unique([*selection, *([] if table.best is None else [table.best])]).astype(np.intp)


# --- one parameter -----------------------------------------------------------------------------------------------------------


def _curves(table: SweepTable) -> ChartSpec:
    """Plot the objective and below it the design variables, one panel per unit; or the analysed quantities."""
    (axis,), x = table.axes, np.array(table.axes[0].values)
    kept = np.arange(len(x))
    changed, unverified = table.states
    values = table.column(table.shown[0])
    if len(x) > MAX_CURVE_POINTS:
        marked = np.flatnonzero(changed | (table.order == table.best))
        kept = np.unique([*even(len(x), MAX_CURVE_POINTS), *marked[:MAX_CURVE_POINTS]]).astype(np.intp)
    picked = _selectable(table, table.order[kept])
    places = np.searchsorted(picked, table.order[kept]).clip(max=len(picked) - 1)
    picks = [int(k) if picked[k] == row else None for k, row in zip(places, table.order[kept], strict=True)]
    at = np.argsort(table.order)[picked]
    valid = np.isfinite(values)
    panels: list[Panel] = []
    for label, curves in _analysis_panels(table) if table.result.evaluated else _design_panels(table):
        colours = (RESULT, *BODIES[1:]) * len(curves)
        style: dict[str, Any] = {"mode": "lines+markers" if len(x) <= 30 else "lines", "picks": () if panels else picks}
        style["legend"] = len(curves) > 1
        coloured = zip(curves.items(), colours, strict=False)
        traces = [Curve(x[kept], column[kept], name, colour, **style) for (name, column), colour in coloured]
        panels.append(Panel(chart_spec.Axis(label), traces, 1.2))
    if np.any(unverified & valid):
        crosses = _marked(x, values, unverified & valid, "not verified", LIMIT, symbol="cross")
        panels[0] = replace(panels[0], traces=[*panels[0].traces, crosses])
    lines = [Line(at, "" if k else OTHER, MUTED, 1.0, "dot") for k, at in enumerate(x[valid & changed][:MAX_LINES].tolist())]
    edges = cells(x, log=_axis_scale(axis) == "log")
    empty = [(edges[first], edges[last + 1], "" if k else table.empty) for k, (first, last) in enumerate(runs(~valid))]
    spans = [Span(*ends, NO_DESIGN, 1.0, "no design") for ends in empty]
    across, picks_ = _axis_of(axis, (edges[0], edges[-1]) if spans else None), _picks(table, picked, x[at], values[at])
    heading, more = _heading(table, f"over {axis.key}"), dict[str, Any](lines=lines, spans=spans, picks=picks_)
    more["designs"] = partial(_design, table)
    return ChartSpec("sweep", f"Over {axis.key}", panels, across, heading, cursor=False, width=8.0, **more)


def _marked(x: Array, y: Array, mask: NDArray[np.bool_], name: str, colour: str, **style: Any) -> Curve:
    """Return markers at the places of a mask."""
    return Curve(x[mask][:MAX_CURVE_POINTS], y[mask][:MAX_CURVE_POINTS], name, colour, mode="markers", gid=name, **style)


def _design_panels(table: SweepTable) -> Iterator[tuple[str, dict[str, Array]]]:
    """Yield the label of each panel with its curves by name."""
    yield _column_text(table.shown[0]), {"objective": table.column(table.shown[0])}
    by_unit: dict[str, dict[str, Array]] = {}
    for column in table.designs:
        name, _, unit = _display(column)
        by_unit.setdefault(unit, {})[name] = table.column(column)
    for unit, curves in by_unit.items():
        yield with_unit("design variables" if len(curves) > 1 else next(iter(curves)), unit), curves


def _analysis_panels(table: SweepTable) -> Iterator[tuple[str, dict[str, Array]]]:
    for column, names in _measures_by_column(table).items():
        curves = {WORDS.get(_column_and_measure(name)[1], name): table.column(name) for name in names}
        words, factor, unit = _display(column)
        if unit in ("mm", "mm²"):  # deviations may be far smaller
            square, largest = unit == "mm²", max_abs(np.stack(list(curves.values()))) / factor
            length = scale(math.sqrt(largest) if square else largest, "m")
            ratio = (length.factor**2 if square else length.factor) / factor
            unit, curves = f"{length.unit}²" if square else length.unit, {word: ratio * one for word, one in curves.items()}
        yield with_unit(words, unit), curves


# --- two and three parameters ------------------------------------------------------------------------------------------------


def _maps(table: SweepTable) -> list[ChartSpec]:
    """Return maps of all columns; the picture has the objective, or the measures of the first analysed column."""
    in_picture = next(iter(_measures_by_column(table).values())) if table.result.evaluated else table.shown
    up, side = table.axes
    heading = _heading(table, f"over {up.key} and {side.key}")
    specs = []
    for name in (*table.shown, *table.designs):
        picks = None
        if name == table.shown[0]:
            rows = _selectable(table, table.order.ravel())
            i, j = np.unravel_index(np.argsort(table.order.ravel())[rows], table.order.shape)
            picks = _picks(table, rows, np.array(side.values)[j], np.array(up.values)[i])
            positions = {int(row): k for k, row in enumerate(rows)}
        pick = [[positions.get(int(row)) for row in line] for line in table.order] if picks else ()
        width, height = (8.0, 2.2) if len(in_picture) == 1 else (4.4, 1.7)
        words = _column_text(name)
        panel = _map(table, name, ..., words, height, picks=pick)
        more: dict[str, Any] = {"picks": picks, "designs": partial(_design, table), "width": width}
        file = "sweep" if name in in_picture else ""
        specs.append(ChartSpec(file, words, [panel], _axis_of(side), heading, cursor=False, **more))
    return specs


def _map(
    table: SweepTable,
    name: str,
    at: Any,
    words: str,
    height: float,
    limits: tuple[float, float] | None = None,
    picks: Sequence[Sequence[int | None]] = (),
) -> Panel:
    """Return a map of a column over the last two parameters with its marks."""
    up, side = table.axes[-2:]
    values, rows = np.asarray(table.column(name), dtype=float)[at], table.order[at]
    valid = np.isfinite(values)
    x, y = np.meshgrid(side.values, up.values)
    changed, unverified = (valid & mask[at] for mask in table.states)
    best = valid & (rows == (-1 if table.best is None else table.best))
    traces: list[Any] = [HeatMap(np.array(side.values), np.array(up.values), values, words, limits, picks)]
    mark_styles: tuple[tuple[Any, str, str, Any, Any], ...] = (
        (changed, OTHER, "#ffffff", "circle", 1.5 if max(values.shape) > 30 else 2.5),
        (unverified, "not verified", LIMIT, "cross", 5.0),
        (best, "best", LIMIT, "star", 9.0),
    )
    for mask, word, colour, symbol, size in mark_styles:
        if np.any(mask):
            traces.append(_marked(x, y, mask, word, colour, symbol=symbol, size=size, hover=False))
    if not np.all(valid):
        traces.append(Curve.entry(table.empty, NO_DESIGN, mode="markers", symbol="square", size=7.0, hover=False))
    return Panel(_axis_of(up), traces, height)


def _slices(table: SweepTable) -> list[ChartSpec]:
    """Return maps over the second and third parameter for some values of the first, with a common colour scale."""
    slow, up, side = table.axes
    chosen = even(len(slow.values), MAX_MAPS)
    columns = charts_per_row(len(chosen))
    names = next(iter(_measures_by_column(table).values())) if table.result.evaluated else table.shown
    name = next((name for name in names if name.endswith(".rms")), names[0])
    values = np.asarray(table.column(name), dtype=float)[chosen]
    limits = (np.nanmin(values), np.nanmax(values)) if np.any(np.isfinite(values)) else (0.0, 1.0)
    selection = "" if len(chosen) == len(slow.values) else f" ({len(chosen)} of its {len(slow.values)} values)"
    heading = _heading(table, f"{_column_text(name)} over {slow.key}{selection}, {up.key} and {side.key}")
    specs = []
    for k, at in enumerate(chosen):
        last = (k + 1) % columns == 0  # with the colour bar of its row
        panel = _map(table, name, int(at), _column_text(name) if last else "", 1.3, limits)
        title = f"{slow.key} {slow.values[at]:.6g} {slow.unit}".rstrip()
        width = 12.0 / columns + 1.0 * last
        specs.append(ChartSpec("sweep", title, [panel], _axis_of(side), heading, page=False, row=k // columns, width=width))
    return specs


def _extreme_charts(table: SweepTable) -> list[ChartSpec]:
    """Return the least and largest value of each quantity over each of many parameters, taken over the others."""
    specs = []
    for k, axis in enumerate(table.axes):
        other_axes = tuple(i for i in range(len(table.axes)) if i != k)
        panels: list[Panel] = []
        for name in table.shown[:MAX_PANELS]:
            values = np.asarray(table.column(name), dtype=float)
            valid = np.any(np.isfinite(values), axis=other_axes)
            x, extremes = np.array(axis.values)[valid], np.compress(valid, values, axis=k)
            low, high = np.nanmin(extremes, axis=other_axes), np.nanmax(extremes, axis=other_axes)
            least = Curve(x, low, "least of all points with that value", RESULT, mode="lines+markers", legend=not panels)
            largest = Curve(x, high, "largest of them", MUTED, 1.0, "dash", legend=not panels)
            panels.append(Panel(chart_spec.Axis(_column_text(name)), [least, largest]))
        specs.append(ChartSpec("", f"Over {axis.key}", panels, _axis_of(axis), cursor=False))
    return specs


def overview(result: Sweep) -> Summary:
    """Summarise a parameter sweep."""
    every = " x ".join(f"{len(axis.values):,}" for axis in result.grid.axes)
    counted = count_noun(result.grid.count, "point") + (f" ({every})" if len(result.grid.axes) > 1 else "")
    conflict = "Conflicting limits at a point without a design: `optlink solve` with --set at that point"
    status = [
        (f"{counted}, ", verdict(_point_counts(result), result.status == COMPLETE)),
        *([conflict] if result.infeasible else []),
    ]
    axes = []
    for axis in result.grid.axes:
        ends = dict.fromkeys(f"{end:g}" for end in (min(axis.values), max(axis.values)))
        axes.append((axis.key, f"{' ... '.join(ends)} {axis.unit}".rstrip(), quiet(count_noun(len(axis.values), "point"))))
    parts = [table("Varied", "<<>", axes)]
    if result.best is not None:
        own = SweepTable.of(result)
        rows: list[Row] = [
            (with_unit(axis.key, axis.unit), number(float(result.best[axis.column]) / axis.si_per_unit))
            for axis in result.grid.axes
        ]
        for name in (*own.designs, *own.shown):
            rows.append((_column_text(name), number(float(result.best[name]) * _display(name)[1])))
        parts.append(table("Best", "<>", [*rows, ("active constraints", str(result.best["active"]) or "none")]))
    if result.changes:
        parts.append(_changes(result))
    parts += _rows(result) if result.evaluated else []
    rate = result.points_done_now / result.seconds if result.seconds else 0.0
    pace = f"{rate:z,.0f}" if rate >= 10.0 else number(rate, 2)
    line = f"{count_noun(result.points_done_now, 'point')} done in {result.seconds:z.1f} s ({pace} a second"
    line += (
        f"; {1e3 * result.processor_seconds / result.points_done_now:z.2f} ms of processor time each)"
        if result.points_done_now
        else ")"
    )
    if not result.evaluated:
        line += f"; {searches(result)}"
    return summary(result.problem.model.title, status, *parts, Paragraph(quiet(line), appendix=True))


def searches(result: Sweep) -> str:
    """Return how the optima of a sweep were computed."""
    if result.searched_points >= result.grid.count:
        return "all by a search"
    return f"{result.searched_points:,} by a search, the others from a neighbouring optimum"


def _point_counts(result: Sweep) -> str:
    """Count the points by outcome."""
    if not result.evaluated:
        if result.status == COMPLETE:
            return "every point a verified local optimum"
        missed = result.grid.count - result.valid_points - result.infeasible
        counts = {"verified": result.valid_points, "without a feasible design": result.infeasible, "not verified": missed}
    else:
        counts = dict(result.statuses)
    return ", ".join(f"{count:,} {words}" for words, count in counts.items() if count)


def _rows(result: Sweep) -> Iterator[TableSpec]:
    """Yield the first points of a sweep of analyses; for larger sweeps, the extremes of each quantity."""
    axes = result.grid.axes
    names = [name for name in result.names[len(axes) :] if name not in TEXT and name != "valid"]
    columns = result.columns
    all_points = result.grid.count <= MAX_LISTED and len(names) <= MAX_COLUMNS
    if not all_points and result.valid_points:
        valid, rows = np.flatnonzero(columns["valid"]), []
        for name in names:
            if np.all(np.isnan(columns[name][valid])):
                continue
            ends = [int(valid[of(columns[name][valid])]) for of in (np.nanargmin, np.nanargmax)]
            rows.append((name, *(text for k in ends for text in (number(columns[name][k]), _place(result, k)))))
        yield table("Extremes over all valid points", ["", ">least", ">at", ">largest", ">at"], rows)
    varied = [f">{_short(axis.key, axis.unit)}" for axis in axes]
    if all_points:
        heads = [">" + name.replace(".", ".\n") for name in names]
        table_rows: list[Row] = []
        for k in range(result.grid.count):
            status = columns["status"][k] if columns["valid"][k] else bad(columns["status"][k])
            table_rows.append((*_values(result, k), *(number(float(columns[name][k])) for name in names), status))
        yield table("Points", [*varied, *heads, "status"], table_rows)
    invalid = np.flatnonzero(~columns["valid"])
    if invalid.size:
        failed = [(*_values(result, k), columns["reason"][k]) for k in map(int, invalid[:MAX_LISTED])]
        more = invalid.size - MAX_LISTED
        notes = [quiet(f"and {more:,} more; the table of the sweep has all")] if more > 0 else []
        yield table(f"Points that are not valid: {invalid.size:,}", [*varied, "reason"], failed, notes=notes)


def _values(result: Sweep, point: int) -> list[str]:
    return [f"{value:g}" for value in result.grid.values(point)]


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit, if it has one."""
    return f"{name} [{unit}]" if unit else name


def _short(key: str, unit: str) -> str:
    """Abbreviate a key by the section of its mechanism, with its unit below."""
    name = key.removeprefix("mechanism.").removeprefix("links.")
    return name.replace(".", ".\n") + (f"\n[{unit}]" if unit else "")


def _place(result: Sweep, point: int) -> str:
    values = zip(result.grid.axes, result.grid.values(point), strict=True)
    return ", ".join(f"{value:g} {axis.unit}".rstrip() for axis, value in values)


def _changes(result: Sweep) -> TableSpec:
    rows = [
        (
            *(f"{change.at[axis.column] / axis.si_per_unit:g}" for axis in result.grid.axes),
            change.before or "none",
            change.after or "none",
        )
        for change in result.changes[:MAX_LISTED]
    ]
    columns = [*(f">{_short(axis.key, axis.unit)}" for axis in result.grid.axes), "before", "from there on"]
    return table(f"Changes of the active constraints: {result.active_set_changes}", columns, rows)


def conclusion(result: Sweep) -> str:
    """Return the conclusion of a sweep: number of valid points, and the best of them."""
    total = result.grid.count
    if result.evaluated or result.best is None:
        done = result.statuses.get("analysed", result.valid_points) if result.evaluated else result.valid_points
        tail = "" if result.evaluated else " No point has a valid design: relax the limits or change the range."
        return f"{done:,} of {total:,} points have valid results.{tail}"
    name = next(column for column in result.best if column.startswith("objective"))
    _, factor, unit = _display(name)
    where = [f"{axis.key} = {figure(float(result.best[axis.column]) / axis.si_per_unit, axis.unit)}" for axis in result.grid.axes]
    value = figure(float(result.best[name]) * factor, unit)
    extreme = "largest" if result.problem.model.objective_display[0] < 0.0 else "least"
    verified = f"{result.valid_points:,} of {total:,} points have a verified design"
    active = str(result.best.get("active", ""))
    limits = f" Active limits of the best: {active}." if active else ""
    return f"The objective is {extreme}, {value}, at {joined(where)}; {verified}.{limits}"


VIEW = View(overview, charts=charts, page=page)
