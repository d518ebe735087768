"""HTML sections of a parameter sweep: objective and designs over the parameters, active-set changes, best point."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Fault, InputError
from optlink.problem.file import ProblemFile
from optlink.record import AGAIN, LARGEST, Contradiction
from optlink.report.format import number, points
from optlink.report.html.chart_plotly import Chart, Panel, Picks, Trace, axis, line, mark, sheet, short, stacked
from optlink.report.html.shell import Section
from optlink.report.stored.stored_study import Studied, figures_of, named_si, still, turning
from optlink.report.style import BODIES, FOUND, LIMIT, QUIET
from optlink.report.table_spec import TableSpec, quiet, table
from optlink.studies.execution.store import TABLE
from optlink.studies.grid import Axis, AxisRecord, Grid
from optlink.studies.sweep import CHANGED, SweepRecord

Array = NDArray[np.float64]
MOST = 4000  # largest number of points in a chart; larger sweeps are thinned evenly
PICKED = 1500  # largest number of selectable points
PANELS = 4  # largest number of stacked panels
ENDS = {"min": "least", "max": "largest", "rms": "rms"}
LISTED = 12  # largest number of listed active-set changes
TEXTS = ("status", "failed", "active", "found", "reason")
FLAGS = ("valid", CHANGED)


@dataclass(frozen=True, eq=False)
class Swept:
    """A stored sweep: parameter grid, table as text by column, names of the objective (or quantities) and design variables."""

    grid: Grid
    evaluated: bool
    table: Mapping[str, list[str]]
    figures: tuple[str, ...]
    designs: tuple[str, ...]

    def numbers(self, name: str) -> Array:
        """Return a column as numbers, NaN where a cell is empty."""
        return np.array([float(text) if text else np.nan for text in self.table[name]])

    def flags(self, name: str) -> NDArray[np.bool_]:
        """Return a column of booleans; all false if the column does not exist."""
        return np.array([text == "true" for text in self.table.get(name, [""] * self.grid.count)])

    @property
    def best(self) -> int | None:
        """Index of the valid point with the least objective; None if there is none."""
        if self.evaluated:
            return None
        values = np.where(self.flags("valid"), self.numbers(self.figures[0]), np.nan)
        return None if np.all(np.isnan(values)) else int(np.nanargmin(values))


# --- reading -----------------------------------------------------------------------------------------------------------------


def read(record: SweepRecord, file: Path) -> Swept:
    """Read the table of a stored sweep, beside its file or otherwise where the record locates it.

    Parameters
    ----------
    record : SweepRecord
    file : Path
        File of the record.

    Raises
    ------
    InputError
        If the table is missing or belongs to another sweep.
    """
    path = file.parent / TABLE
    path = path if path.is_file() or record.table is None else Path(record.table)
    names, count, mode = record.columns, record.points, record.mode
    try:
        with path.open(encoding="utf-8", newline="") as table_file:
            rows = csv.reader(table_file)
            head = next(rows, [])
            columns = list(zip(*rows, strict=True))
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "its rows differ in length"
        raise InputError(Fault(f"cannot read the table of the sweep: {reason}", AGAIN, str(path))) from None
    if tuple(head) != names or len(columns) != len(names) or len(columns[0]) != count:
        raise InputError(Fault("the table is not that of this sweep", AGAIN, str(path)))
    table = dict(zip(names, map(list, columns), strict=True))
    for name in names:
        if name not in TEXTS + FLAGS:
            _check_numbers(path, name, table[name])
    axes = tuple(_axis(one, k, table) for k, one in enumerate(record.axes))
    whole = Grid(axes)
    if whole.count != count:
        raise Contradiction("axes", f"their values make {whole.count} points, the table has {count}")
    rest = [name for name in names[len(axes) :] if name not in TEXTS + FLAGS]
    if mode != "optimise":
        return Swept(whole, True, table, tuple(rest), ())
    objective = next((name for name in rest if name.startswith("objective")), None)
    if objective is None:
        raise Contradiction("columns", "there is no objective")
    return Swept(whole, False, table, (objective,), tuple(rest[: rest.index(objective)]))


def _check_numbers(path: Path, name: str, texts: list[str]) -> None:
    for row, text in enumerate(texts):
        try:
            sound = not abs(float(text or "nan")) > LARGEST
        except ValueError:
            sound = False
        if not sound:
            raise InputError(Fault(f"row {row + 1} of the table holds no number", AGAIN, str(path), name, text))


def _axis(record: AxisRecord, k: int, table: Mapping[str, list[str]]) -> Axis:
    bare = Axis(record.key, record.unit, ())
    values = tuple(dict.fromkeys(float(text) for text in table.get(bare.column, [])))
    if len(values) != record.values:
        raise Contradiction(f"axes[{k}].values", f"the table has {len(values)} values of it", record.values)
    return Axis(bare.key, bare.unit, values)


# --- the page ----------------------------------------------------------------------------------------------------------------


def studied(record: SweepRecord, file: ProblemFile, path: Path) -> Studied:
    """Build the report of a stored sweep.

    Parameters
    ----------
    record : SweepRecord
    file : ProblemFile
        The problem of the study.

    Raises
    ------
    InputError
        If the record is damaged, or its table is missing or belongs to another sweep.
    """
    found, mode = read(record, path), record.mode
    valid = int(np.sum(found.flags("valid")))
    complete = valid == found.grid.count
    every = " x ".join(f"{len(one.values):,}" for one in found.grid.axes)
    line_ = points(found.grid.count) + (f" ({every})" if len(found.grid.axes) > 1 else "") + f" over {_and(found.grid.axes)}"
    if found.evaluated:
        counts = Counter(found.table.get("status", []))
        proven = ", ".join(f"{count:,} {status}" for status, count in counts.items()) or "analysed"
    else:
        proven = "every optimum proven" if complete else f"{valid:,} proven, {found.grid.count - valid:,} not"
    searched = "" if found.evaluated else f"; {record.searched_points or 0:,} needed a search, the others followed a neighbour"
    best = found.best
    return Studied(
        problem=file,
        kind="sweep",
        verdict=proven[0].upper() + proven[1:],
        valid=complete or (found.evaluated and valid > 0),
        status=[line_],
        sections=[Section("Sweep", tuple(_charts(found))), *figures_of(_tables(found, best))],
        moving=still if best is None else turning(*_best(file, found, best)),
        by=(
            f"{'simulation' if mode == 'simulate' else 'analysis'} of every point"
            if found.evaluated
            else f"an optimum at every point, each proven by the validator{searched}"
        ),
        drawn="The best point of the sweep.",
        after=1,
    )


def _and(axes: tuple[Axis, ...]) -> str:
    names = [one.key for one in axes]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _best(file: ProblemFile, found: Swept, best: int) -> tuple[ProblemFile, dict[str, float]]:
    """Return the problem and the design [SI] of the best point."""
    there = file.override(found.grid.changes(best))
    return there, named_si(there, {name: float(found.table[name][best]) for name in found.designs})


def _tables(found: Swept, best: int | None) -> Iterator[TableSpec]:
    varied = []
    for one in found.grid.axes:
        span = f"{min(one.values):g} ... {max(one.values):g} {one.unit}".rstrip()
        varied.append((one.key, span, f"{len(one.values):,} value{'s' * (len(one.values) != 1)}"))
    yield table("Varied", "<<>", varied)
    active = found.table.get("active", [])
    if best is not None:
        rows = [(words, number(float(found.table[name][best]), 8)) for name, words in _columns(found).items()]
        yield table("Best point", "<>", rows, notes=[quiet(f"held by: {active[best] or 'nothing'}")])
    places = np.flatnonzero(found.flags(CHANGED))
    if len(places):
        changes = [
            (
                *(f"{value:g}" for value in found.grid.values(int(k))),
                *(active[i].replace("; ", "\n") or "none" for i in (k - 1, k)),
            )
            for k in places[:LISTED]
        ]
        more = len(places) - LISTED
        notes = [quiet(f"and {more:,} more; the table of the sweep marks all")] if more > 0 else []
        columns = [*(f">{_varied(one)}" for one in found.grid.axes), "before", "from there on"]
        yield table(f"Where other limits begin to hold the design: {len(places):,}", columns, changes, notes=notes)


def _columns(found: Swept) -> dict[str, str]:
    """Return the numeric columns with their display names."""
    return {one.column: _varied(one) for one in found.grid.axes} | {
        name: named(name) for name in (*found.figures, *found.designs)
    }


def _varied(one: Axis) -> str:
    """Format a parameter with its unit."""
    return f"{one.key} [{one.unit}]" if one.unit else one.key


def named(column: str) -> str:
    """Return the display name of a column, with its unit in brackets."""
    stem, _, how = column.rpartition(".")
    if how in ENDS:
        return f"{ENDS[how]} {named(stem)}"
    name, _, unit = column.rpartition("_")
    unit = unit.replace("rad2", "rad²").replace("m2", "m²")
    return f"{name} [{unit}]" if name else column


# --- charts ------------------------------------------------------------------------------------------------------------------


def _charts(found: Swept) -> Iterator[Chart]:
    if len(found.grid.axes) == 1:
        yield _curves(found)
    elif len(found.grid.axes) == 2:
        yield from (_map(found, name) for name in (*found.figures, *found.designs))
    else:
        yield from (_least(found, one) for one in found.grid.axes)


def _kept(found: Swept) -> NDArray[np.intp]:
    """Return the indices of the points to draw: all, or an even selection with all active-set changes."""
    count = found.grid.count
    if count <= MOST:
        return np.arange(count)
    marked = np.flatnonzero(found.flags(CHANGED))[:MOST]
    best = [] if found.best is None else [found.best]
    return np.unique(np.concatenate([np.linspace(0, count - 1, MOST).round(), marked, best])).astype(np.intp)


def _picks(found: Swept, places: NDArray[np.intp], x: Array, y: Array) -> Picks:
    """Tabulate the design of every point."""
    columns = _columns(found)
    words = ["status", "reason"] if found.evaluated else ["held by", "status"]
    rows = []
    for k in places:
        told = [number(float(found.table[name][k] or "nan"), 7) for name in columns]
        status = found.table["status"][k] if "status" in found.table else ""
        if found.evaluated:
            told += [status, found.table["reason"][k] if "reason" in found.table else ""]
        else:
            told += [found.table["active"][k] or "nothing", status]
        rows.append(tuple(told))
    best = found.best
    first = int(np.argmin(np.abs(places - best))) if best is not None else 0
    return Picks("point", (*columns.values(), *words), tuple(rows), short(x), short(y), first)


def _picked(found: Swept, kept: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the indices of the drawn points that can be selected."""
    if len(kept) <= PICKED:
        return kept
    best = [] if found.best is None else [found.best]
    return np.unique(np.concatenate([kept[np.linspace(0, len(kept) - 1, PICKED).round().astype(np.intp)], best])).astype(np.intp)


def _numbers(kept: NDArray[np.intp], picked: NDArray[np.intp]) -> list[int | None]:
    """Return for every drawn point its number among the selectable points; None if it is not selectable."""
    known = {int(k): number_ for number_, k in enumerate(picked)}
    return [known.get(int(k)) for k in kept]


def _curves(found: Swept) -> Chart:
    """Plot the objective or the quantities above the designs, over the only parameter."""
    one = found.grid.axes[0]
    kept = _kept(found)
    picked = _picked(found, kept)
    x = found.numbers(one.column)
    first = found.figures[0]
    data = {"customdata": _numbers(kept, picked)}
    above = [
        line(x[kept], found.numbers(name)[kept], named(name), colour, width=2.2) | data
        for name, colour in zip(found.figures, (FOUND, *BODIES), strict=False)
    ]
    bad = kept[~found.flags("valid")[kept]] if not found.evaluated else kept[:0]
    if len(bad):
        crosses = line(x[bad], found.numbers(first)[bad], "not proven", LIMIT, width=8.0, mode="markers")
        above.append(crosses | {"marker": crosses["marker"] | {"symbol": "x"}})
    panels = [Panel("over the revolution" if found.evaluated and len(found.figures) > 1 else named(first), above, 1.2)]
    units = dict.fromkeys(name.rpartition("_")[2] for name in found.designs)
    for unit in units:
        own = [name for name in found.designs if name.rpartition("_")[2] == unit]
        curves = [
            line(x[kept], found.numbers(name)[kept], name.rpartition("_")[0], BODIES[found.designs.index(name) % len(BODIES)])
            for name in own
        ]
        panels.append(Panel(f"design [{unit}]", curves))
    figure = stacked(panels, _varied(one))
    places = x[np.flatnonzero(found.flags(CHANGED))][:200]
    look = {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "line": {"color": QUIET, "width": 1, "dash": "dot"}}
    figure["layout"]["shapes"] = [look | {"x0": float(at), "x1": float(at)} for at in places]
    picks = _picks(found, picked, x[picked], found.numbers(first)[picked])
    figure["data"].append(mark(picks) | {"yaxis": "y"})
    remark = "Dotted: from there on other limits hold the design." if len(places) else ""
    return Chart(f"Over {one.key}", figure, False, picks, remark)


def _map(found: Swept, name: str) -> Chart:
    """Plot a column over two parameters."""
    slow, fast = found.grid.axes
    shape = (len(slow.values), len(fast.values))
    every = tuple(slice(None, None, max(1, -(-size // 150))) for size in shape)
    places = np.arange(found.grid.count).reshape(shape)[every]
    values = found.numbers(name).reshape(shape)[every]
    x, y = np.array(fast.values)[every[1]], np.array(slow.values)[every[0]]
    chosen = name == found.figures[0]
    flat = np.sort(places.ravel())
    picked = _picked(found, flat)
    known = dict(zip(picked.tolist(), range(len(picked)), strict=True))
    shaded: Trace = {
        "type": "heatmap",
        "name": escape(named(name)),
        "x": short(x),
        "y": short(y),
        "z": [short(row) for row in values],
        "colorscale": "Viridis",
        "colorbar": {"title": {"text": escape(named(name)), "side": "right"}, "thickness": 16},
        "customdata": [[known.get(int(k)) for k in row] for row in places],
        "hovertemplate": f"{escape(fast.key)} %{{x:.6g}}<br>{escape(slow.key)} %{{y:.6g}}<br>%{{z:.6g}}<extra></extra>",
    }
    curves = [shaded]
    marked = np.flatnonzero(found.flags(CHANGED))
    if len(marked):
        edge = line(*_places(found, marked[:MOST]), "other limits begin to hold", "#ffffff", width=3.5, mode="markers")
        curves.append(edge | {"hoverinfo": "skip"})
    best = found.best
    if best is not None:
        star = line(*_places(found, np.array([best])), "best", LIMIT, width=13.0, mode="markers")
        curves.append(star | {"marker": star["marker"] | {"symbol": "star"}})
    layout = sheet(480) | {"hovermode": "closest", "plot_bgcolor": "#eceef1"}
    layout["xaxis"] = axis(_varied(fast)) | {"range": _edges(x)}
    layout["yaxis"] = axis(_varied(slow)) | {"range": _edges(y)}
    layout["legend"] |= {"bgcolor": "#d5d9de"}
    remark = (
        "White dots: from there on, along the horizontal axis, other limits hold the design. Grey: no design."
        if len(marked)
        else ""
    )
    if not chosen:
        return Chart(named(name), {"data": curves, "layout": layout}, False, remark=remark)
    picks = _picks(found, picked, *_places(found, picked))
    seen = mark(picks)
    seen["marker"]["line"]["color"] = "#ffffff"
    return Chart(named(name), {"data": [*curves, seen], "layout": layout}, False, picks, remark)


def _edges(values: Array) -> list[float]:
    """Return the outer edges of the cells around the values."""
    ends = np.sort(values)
    first, last = (ends[1] - ends[0], ends[-1] - ends[-2]) if len(ends) > 1 else (1.0, 1.0)
    return [float(ends[0] - 0.5 * first), float(ends[-1] + 0.5 * last)]


def _places(found: Swept, places: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the coordinates of points in a map, along the fast and the slow parameter."""
    slow, fast = found.grid.axes
    return found.numbers(fast.column)[places], found.numbers(slow.column)[places]


def _least(found: Swept, one: Axis) -> Chart:
    """Plot the least and largest value of each quantity over one of three or more parameters, taken over the others."""
    panels: list[Panel] = []
    for figure in found.figures[:PANELS]:
        values, places = found.numbers(figure), found.numbers(one.column)
        known = np.array([value for value in one.values if np.any(np.isfinite(values[places == value]))])
        low, high = (np.array([reach(values[places == value]) for value in known]) for reach in (np.nanmin, np.nanmax))
        least = line(known, low, "least of all points with that value", FOUND, width=2.4, mode="lines+markers")
        largest = line(known, high, "largest of them", QUIET, width=1.3, dash="dash")
        panels.append(Panel(named(figure), [curve | {"showlegend": not panels} for curve in (least, largest)]))
    return Chart(f"Over {one.key}", stacked(panels, _varied(one)), cranked=False)
