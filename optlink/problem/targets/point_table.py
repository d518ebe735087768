"""Points listed in the problem file or in a CSV file: read, checked, and reduced if there are too many."""

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.problem.quantity import LONGEST, SHORTEST, Unusable, below, check_keys, is_number, nearest, read_scalar
from optlink.problem.targets.csv_table import COLUMN_UNITS, CsvTable, read_csv
from optlink.problem.targets.target_points import COINCIDENT, HEAVIEST, MAX_POINTS, TargetPoints, diagonal, pairs, shortened
from optlink.units import factor, read_number, show

MAX_ROWS = 1_000_000

_TURNED = 1e4  # rad; a larger angle has lost its last digits and is an input error


@dataclass(frozen=True)
class PointRows:
    """Columns (n,) [SI] by name: x and y, and of crank, angle, weight and tolerance those that are defined.

    `unit` of x. `file` and the row `numbers` in it, for a CSV file. `key` named in errors; None: that of each listed row.
    """

    columns: Mapping[str, Array]
    unit: str
    file: str = ""
    numbers: Sequence[int] | None = None
    key: str | None = None

    @property
    def points(self) -> Array:
        """Points (n, 2) [m]."""
        return np.stack([self.columns["x"], self.columns["y"]], axis=1)

    def named(self, *rows: int) -> str:
        """Return the names of rows for display: "points 4 and 5", or "rows 5 and 6 of curve.csv"."""
        numbers = [row + 1 if self.numbers is None else self.numbers[row] for row in rows]
        what = ("point" if self.numbers is None else "row") + ("s" if len(rows) > 1 else "")
        return f"{what} {' and '.join(map(str, numbers))}{f' of {self.file}' if self.file else ''}"

    def refuse(self, bad: NDArray[np.bool_], column: str, message: str, remedy: str) -> None:
        """Raise an error for the first bad row (n,), if there is one; in the message {} stands for the name of the row.

        Raises
        ------
        Unusable
        """
        if bad.any():
            row = int(np.argmax(bad))
            key = f"[{row}].{column}" if self.key is None else self.key
            kind, value = _COLUMNS[column], float(self.columns[column][row])
            raise Unusable(message.format(self.named(row)), remedy, key, show(value, kind) if kind else f"{value:.6g}")


_COLUMNS = {"x": "coordinate", "y": "coordinate", "crank": "angle", "angle": "angle", "weight": "", "tolerance": "length"}
_LEFT_OUT = {"weight": 1.0, "tolerance": math.inf}  # defaults of a row


def read_rows(raw: Sequence[object]) -> PointRows:
    """Read rows listed in the problem file, each a list of two or a table.

    Raises
    ------
    Unusable
        If there is no row or there are too many, or a row is invalid, with its index.
    """
    if len(raw) > MAX_ROWS:
        raise Unusable(f"there are {len(raw):,} points, more than {MAX_ROWS:,}", "Reduce their number", "")
    example = 'Write ["20 mm", "25 mm"], or { x = "20 mm", y = "25 mm", crank = "30 deg" }'
    columns: dict[str, list[float]] = {name: [] for name in _COLUMNS}
    first_rows: dict[str, int] = {}
    unit = "mm"
    for number, row in enumerate(raw):
        if isinstance(row, list | tuple):
            if len(row) != 2:
                raise Unusable(f"point {number + 1} needs two values, x and y", example, f"[{number}]", row)
            row = dict(zip("xy", row, strict=True))
        if not isinstance(row, dict):
            raise Unusable(f"point {number + 1} is neither a list nor a table", example, f"[{number}]", row)
        with below(f"[{number}]"):
            check_keys(row, list(_COLUMNS))
        for name, kind in _COLUMNS.items():
            key = f"[{number}].{name}"
            if name not in row and name in ("x", "y"):
                raise Unusable(f"point {number + 1} has no {name}", example, key)
            if name not in row:
                columns[name].append(_LEFT_OUT.get(name, math.nan))
            elif kind:
                value, spelled = read_scalar(row[name], kind, key)
                columns[name].append(value)
                unit = spelled if number == 0 and name == "x" else unit
            else:
                columns[name].append(_number(row[name], key))
            if name in row:
                first_rows.setdefault(name, number)
    if not raw:
        raise Unusable("there is no point", "Give at least one", "", raw)
    for name in ("crank", "angle"):
        lacks = next((number for number, value in enumerate(columns[name]) if math.isnan(value)), None)
        if name in first_rows and lacks is not None:
            message = f"point {lacks + 1} has no {name}, and point {first_rows[name] + 1} has one"
            raise Unusable(message, f"Give {name} of all points or of none", f"[{lacks}].{name}")
    return PointRows({name: np.array(columns[name]) for name in first_rows}, unit)


def _number(raw: object, key: str) -> float:
    if not is_number(raw) or not abs(raw) <= HEAVIEST:
        raise Unusable(f"expected a plain number above zero, at most {HEAVIEST:g}", "Write weight = 2.0, for example", key, raw)
    return float(raw)


_ENDINGS = {"length": COLUMN_UNITS["coordinate"], "": ("",)} | COLUMN_UNITS
_TITLES = {f"{name}_{unit}".rstrip("_"): (name, unit) for name, kind in _COLUMNS.items() for unit in _ENDINGS[kind]}


def read_csv_rows(raw: Mapping[str, Any], folder: Path) -> PointRows:
    """Read rows of a CSV file; unlike `csv_table.read_columns` it allows only known columns, and empty cells.

    Raises
    ------
    Unusable
    """
    table = read_csv(raw, folder, MAX_ROWS)
    if table.titles:
        _check_titles(table)
    read: list[tuple[str, str, int, array[float]]] = [
        (column, unit, table.titles.index(title), array("d"))
        for title, (column, unit) in _TITLES.items()
        if title in table.titles
    ]
    numbers = array("q")
    for number, cells in table.rows:
        numbers.append(number)
        for column, _, index, values in read:
            if column not in _LEFT_OUT:
                values.append(table.number(number, cells, index))
            elif index < len(cells) and cells[index].strip():
                values.append(table.number(number, cells, index, "Leave the cell empty where there is none"))
            else:
                values.append(_LEFT_OUT[column])
    if not numbers:
        remedy = "Give the columns x_mm and y_mm, and at least one row below them"
        raise Unusable(f"{table.name} has no rows", remedy, "csv", table.name)
    for column, _, index, values in read:
        if column == "crank":
            table.check_unit(index, min(values), max(values))
    columns = {column: np.array(values) * (factor(unit, _COLUMNS[column]) if unit else 1.0) for column, unit, _, values in read}
    unit = next(unit for column, unit, *_ in read if column == "x")
    return PointRows(columns, unit, table.name, numbers, "csv")


def _check_titles(table: CsvTable) -> None:
    """Check that each column is known and unique."""
    name, titles = table.name, table.titles
    for title in titles:
        if not title:
            message = f"column {titles.index(title) + 1} of {name} has no title"
            remedy = "Name it, or remove it, such as the index that pandas writes without index=False"
            raise Unusable(message, remedy, "csv", name)
        if title not in _TITLES:
            examples = [allowed for allowed in _TITLES if not allowed.endswith(("_cm", "_in"))]
            with_unit = [allowed for allowed in examples if allowed.startswith(f"{title.lower()}_")]
            remedy = nearest(title, examples, with_unit[:1])
            if not math.isnan(read_number(title)):
                remedy = "Name the columns in a first row, for example x_mm,y_mm (lines that begin with # or % are comments)"
            raise Unusable(f'{name} has an unknown column "{shortened(title)}"', remedy, "csv", shortened(title))
    columns = [_TITLES[title][0] for title in titles]
    for column in ("x", "y"):
        if column not in columns:
            remedy = f"Name the columns in the first row, one of them {column}_mm"
            raise Unusable(f"{name} has no column {column}_mm", remedy, "csv", name)
    for column in columns:
        if columns.count(column) > 1:
            raise Unusable(f"{name} has two columns of {column}", "Keep one of them", "csv", name)


def check_and_reduce(rows: PointRows, requested_count: int | None) -> TargetPoints:
    """Check the rows, and reduce them to the requested number, by default as many as there are, up to `MAX_POINTS`."""
    _check_ranges(rows)
    points, of_each = rows.points, set(rows.columns) - {"x", "y"}
    most, number = requested_count or MAX_POINTS, len(points)
    if number > most and not of_each:
        chords = np.hypot(*np.diff(points, axis=0).T)
        length, size = float(np.sum(chords)), diagonal(points)
        _check_size(rows)
        loop = bool(np.hypot(*(points[-1] - points[0])) <= COINCIDENT * size)
        at, here = np.linspace(0.0, length, most, endpoint=not loop), np.concatenate([[0.0], np.cumsum(chords)])
        even = {name: np.interp(at, here, rows.columns[name]) for name in "xy"}
        reduced = PointRows(even, rows.unit, key="points" if requested_count else rows.key or "")
        check_apart(reduced)
        return TargetPoints(pairs(reduced.points), unit=rows.unit, note=_reduced(rows, most, "arc length"), loop=loop)
    check_apart(rows)
    note, columns = "", dict(rows.columns)
    if number > most:
        # values of a row apply to its point alone, so rows are selected and not interpolated
        picked = np.round(np.linspace(0, number - 1, most)).astype(int)
        columns = {name: column[picked] for name, column in columns.items()}
        note = _reduced(rows, most, "rows")
    elif requested_count and number < requested_count:
        note = f"{rows.file} has {number:,} points, fewer than the requested {requested_count}; all of them are used"
    crank, angles, weights, tolerances = (
        tuple(columns[name].tolist()) if name in columns else None for name in ("crank", "angle", "weight", "tolerance")
    )
    distinct = pairs(np.stack([columns["x"], columns["y"]], axis=1))
    return TargetPoints(distinct, crank, angles, weights, tolerances, rows.unit, note)


def _reduced(rows: PointRows, count: int, by: str) -> str:
    of = f" of {rows.file}" if rows.file else ""
    return f"{len(rows.points):,} points{of} were reduced to {count}, evenly by {by}"


def _check_ranges(rows: PointRows) -> None:
    columns = rows.columns
    for name in ("x", "y"):
        remedy = f"Give one within {LONGEST / 1e3:g} km, and check its unit"
        rows.refuse(np.abs(columns[name]) > LONGEST, name, "{} lies too far away for a linkage", remedy)
    for name in ("crank", "angle"):
        if name in columns:
            bad = np.abs(columns[name]) > _TURNED
            rows.refuse(bad, name, f"the {name} of {{}} is too large an angle", "Give it within one turn")
    if "weight" in columns:
        bad = (columns["weight"] <= 0.0) | (columns["weight"] > HEAVIEST)
        rows.refuse(bad, "weight", "the weight of {} is out of range", f"Give one above zero, at most {HEAVIEST:g}")
    if "tolerance" in columns:
        tolerances = columns["tolerance"]
        bad = np.isfinite(tolerances) & ((tolerances < SHORTEST) | (tolerances > LONGEST))
        rows.refuse(bad, "tolerance", "the tolerance of {} is out of range", f"Give one above zero, at least {SHORTEST:g} m")
    crank = columns.get("crank")
    if crank is None or len(crank) < 2:
        return
    steps = np.diff(crank)
    way = 1.0 if 2 * np.count_nonzero(steps > 0.0) >= len(steps) else -1.0  # the sense of the majority
    rows.refuse(
        np.concatenate([[False], way * steps <= 0.0]),
        "crank",
        "the crank angles must rise (or fall) from row to row; that of {} does not",
        "Sort the rows by crank angle, remove repeated ones, and write 370 deg rather than 10 deg after 350 deg",
    )
    turned = np.abs(crank - crank[0]) > 2.0 * math.pi * (1.0 + 1e-9)
    remedy = "Give the points of one revolution; the motion repeats"
    rows.refuse(turned, "crank", "the crank angle of {} is more than one revolution from the first", remedy)


def _check_size(rows: PointRows) -> None:
    size = diagonal(rows.points)
    if len(rows.points) > 1 and size < SHORTEST:
        what = "all points coincide" if size == 0.0 else f"the whole path is smaller than {SHORTEST:g} m"
        raise Unusable(what, "Give points that differ, and check their unit", rows.key or "")


def check_apart(rows: PointRows) -> None:
    """Refuse a point that coincides with the previous one, unless their crank angles (a dwell) or angles (a rotation) differ.

    Raises
    ------
    Unusable
    """
    points, columns = rows.points, rows.columns
    if "crank" not in columns:
        same = np.hypot(*np.diff(points, axis=0).T) <= COINCIDENT * diagonal(points)
        if "angle" in columns:
            same &= np.diff(columns["angle"]) == 0.0
        if same.any():
            row = int(np.argmax(same))
            in_list = rows.key is None or rows.numbers is not None
            remedy = "Remove one of them" if in_list else "Request another number of points, or check the curve"
            raise Unusable(f"{rows.named(row, row + 1)} coincide", remedy, f"[{row + 1}]" if rows.key is None else rows.key)
    if "angle" not in columns:
        _check_size(rows)
