"""The points that a path shall pass through, or the poses of a body: a list, a CSV file, a drawing (SVG), or expressions in t."""

from __future__ import annotations

import cmath
import csv
import io
import math
import re
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from optlink.design.expression import Expression, LawError, parse
from optlink.design.quantity import LONGEST, SHORTEST, Unusable, nearest, read_scalar
from optlink.units import UnitProblem, factor, show

Array = NDArray[np.float64]
Drawn = NDArray[np.complex128]

MAX_POINTS = 400
MAX_ROWS = 1_000_000
MAX_BYTES = 50_000_000
MAX_SEGMENTS = 100_000  # of a drawn path
DEFAULT_POINTS = 60  # of a drawing or an expression
COINCIDENT = 1e-9  # of the size of the whole path

_FINE = 100_000  # chords that a curve is measured by; of one turn of a circle, they miss 2e-10 of the length
_TURNED = 1e4  # rad; beyond it an angle has lost its last digits, and nobody meant it
_HEAVIEST = 1e9
_FORMS = (
    'Write [["20 mm", "25 mm"], ...], { csv = "curve.csv" }, { svg = "drawing.svg" } '
    'or { x = "20*cos(t)", y = "10*sin(t)", unit = "mm", t = [0, "2*pi"] }'
)


@dataclass(frozen=True)
class Wanted:
    """Points [m] that a path shall pass through, in their order; with `angles`, poses of a body.

    `crank`, `angles` [rad]: the crank angle and the angle of the body at each point, None where they are left to the design.
    `weights` of the squared distances, None where all are 1. `tolerances` [m]: the largest distance allowed, inf where none is.
    `unit`: the one that people wrote. `loop`: sampled from a closed curve, whose first point is not repeated at the end.
    `note`: what was done to what the file states, for people.
    """

    points: tuple[tuple[float, float], ...]
    crank: tuple[float, ...] | None = None
    angles: tuple[float, ...] | None = None
    weights: tuple[float, ...] | None = None
    tolerances: tuple[float, ...] | None = None
    unit: str = "mm"
    note: str = ""
    loop: bool = False

    @property
    def size(self) -> float:
        """Diagonal [m] of the rectangle around the points."""
        return _size(np.asarray(self.points))


def closed(wanted: Wanted) -> bool:
    """Whether the points go round: sampled from a closed curve, or listed with the last on the first."""
    if wanted.loop:
        return True
    first, last = wanted.points[0], wanted.points[-1]
    return len(wanted.points) > 2 and math.dist(first, last) <= COINCIDENT * wanted.size


def read_points(raw: object, folder: Path) -> Wanted:
    """Read points or poses as a problem file states them: a list, a CSV file, a shape of an SVG file, or expressions in t.

    A listed point is kept as it is listed, up to `MAX_POINTS` of them; more are reduced evenly by arc length or, where something
    is stated of each point, evenly by rows. A closed curve that is sampled or reduced by arc length does not repeat its first
    point at the end. SVG's y axis points down and ours up, so y changes its sign; the origin stays that of the drawing.

    Parameters
    ----------
    raw : what the file states
    folder : of the file, which names of other files are relative to

    Raises
    ------
    Unusable
        naming the key below the present one that is to blame.
    """
    if isinstance(raw, Wanted):
        return raw
    if isinstance(raw, list | tuple):
        return _wanted(_listed(raw), None)
    if not isinstance(raw, dict):
        raise Unusable("points are a list or a table", _FORMS, "", raw)
    forms = [form for form, keys in (("csv", ("csv",)), ("svg", ("svg",)), ("x", ("x", "y"))) if any(key in raw for key in keys)]
    if not forms:
        known = {name for form in _KEYS.values() for name in form}
        for key in raw:
            if key not in known:
                raise Unusable("unknown key", nearest(str(key), sorted(known)), str(key))
        raise Unusable("nothing says where the points are", _FORMS, "", raw)
    if len(forms) > 1:
        raise Unusable(f"the points are given twice, by {' and by '.join(forms)}", "Keep one of them", forms[1], raw[forms[1]])
    for key in raw:
        if key not in _KEYS[forms[0]]:
            raise Unusable("unknown key", nearest(str(key), _KEYS[forms[0]]), str(key))
    if forms == ["csv"]:
        count = _count(raw) if "points" in raw else None
        return _wanted(_tabled(raw, folder), count)
    return _drawn(raw, folder) if forms == ["svg"] else _expressed(raw)


_KEYS = {
    "csv": ("csv", "points"),
    "svg": ("svg", "path", "unit", "points"),
    "x": ("x", "y", "unit", "t", "points", "spacing"),
}


def _count(raw: Mapping[str, Any]) -> int:
    count = raw.get("points", DEFAULT_POINTS)
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_POINTS:
        raise Unusable(f"expected a whole number from 2 to {MAX_POINTS}", "Write points = 60, for example", "points", count)
    return count


def _unit(raw: Mapping[str, Any]) -> float:
    """Metres of one unit."""
    if not isinstance(raw["unit"], str):
        raise Unusable("expected a unit of length", 'Write unit = "mm"', "unit", raw["unit"])
    try:
        return factor(raw["unit"], "length")
    except UnitProblem as problem:
        raise Unusable(problem.message, problem.remedy, "unit", raw["unit"]) from None


def _size(points: Array) -> float:
    return float(np.hypot(*np.ptp(points, axis=0)))


def _cut(value: object) -> str:
    """A piece of what people wrote that goes into a line of a message."""
    text = str(value)
    shown = "".join(sign if sign.isprintable() else " " for sign in text[:60])
    return shown if len(text) <= 60 else f"{shown}..."


# ---- rows, listed or from a CSV file


@dataclass(frozen=True)
class _Rows:
    """Columns (n,) [SI] by name: x and y, and of crank, angle, weight and tolerance those that are stated.

    `unit` of x. `file` and `numbers` of the rows in it, where they come from one. `key` to blame; None: that of each listed row.
    """

    columns: Mapping[str, Array]
    unit: str
    file: str = ""
    numbers: Sequence[int] | None = None
    key: str | None = None

    @property
    def points(self) -> Array:
        return np.stack([self.columns["x"], self.columns["y"]], axis=1)

    def named(self, *rows: int) -> str:
        """The rows as people find them: "points 4 and 5", or "rows 5 and 6 of curve.csv"."""
        numbers = [row + 1 if self.numbers is None else self.numbers[row] for row in rows]
        what = ("point" if self.numbers is None else "row") + ("s" if len(rows) > 1 else "")
        return f"{what} {' and '.join(map(str, numbers))}{f' of {self.file}' if self.file else ''}"

    def refuse(self, bad: NDArray[np.bool_], column: str, message: str, remedy: str) -> None:
        """Name the first of the rows where `bad` (n,), if there is one; {} in the message stands for it."""
        if bad.any():
            row = int(np.argmax(bad))
            key = f"[{row}].{column}" if self.key is None else self.key
            raise Unusable(message.format(self.named(row)), remedy, key, _people(column, float(self.columns[column][row])))


def _people(column: str, value: float) -> str:
    kind = _COLUMNS[column]
    return show(value, kind) if kind else f"{value:.6g}"


_COLUMNS = {"x": "coordinate", "y": "coordinate", "crank": "angle", "angle": "angle", "weight": "", "tolerance": "length"}
_LEFT_OUT = {"weight": 1.0, "tolerance": math.inf}  # what a row has that states none


def _listed(raw: Sequence[object]) -> _Rows:
    if len(raw) > MAX_ROWS:
        raise Unusable(f"there are {len(raw):,} points, more than {MAX_ROWS:,}", "Thin them out", "")
    example = 'Write ["20 mm", "25 mm"], or { x = "20 mm", y = "25 mm", crank = "30 deg" }'
    columns: dict[str, list[float]] = {name: [] for name in _COLUMNS}
    stated: dict[str, int] = {}
    unit = "mm"
    for number, row in enumerate(raw):
        if isinstance(row, list | tuple):
            if len(row) != 2:
                raise Unusable(f"point {number + 1} needs two values, x and y", example, f"[{number}]", row)
            row = dict(zip("xy", row, strict=True))
        if not isinstance(row, dict):
            raise Unusable(f"point {number + 1} is neither a list nor a table", example, f"[{number}]", row)
        for key in row:
            if key not in _COLUMNS:
                raise Unusable("unknown key", nearest(str(key), _COLUMNS), f"[{number}].{key}")
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
                stated.setdefault(name, number)
    if not raw:
        raise Unusable("there is no point", "Give at least one", "", raw)
    for name in ("crank", "angle"):
        lacks = next((number for number, value in enumerate(columns[name]) if math.isnan(value)), None)
        if name in stated and lacks is not None:
            raise Unusable(
                f"point {lacks + 1} has no {name}, and point {stated[name] + 1} has one",
                f"Give {name} of all points or of none",
                f"[{lacks}].{name}",
            )
    return _Rows({name: np.array(columns[name]) for name in stated}, unit)


def _number(raw: object, key: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not abs(raw) <= _HEAVIEST:
        raise Unusable(f"expected a plain number above zero, at most {_HEAVIEST:g}", "Write weight = 2.0, for example", key, raw)
    return float(raw)


_ENDINGS = {
    "coordinate": ("mm", "m", "cm", "in"),
    "length": ("mm", "m", "cm", "in"),
    "angle": ("deg", "rad"),
}  # units as they may end the name of a column
_TITLES = {
    (f"{name}_{unit}" if unit else name): (name, unit) for name, kind in _COLUMNS.items() for unit in _ENDINGS.get(kind, ("",))
}


def _contents(raw: Mapping[str, Any], key: str, folder: Path) -> tuple[str, bytes]:
    """Name, for people, and bytes of the file that `raw[key]` names; devices and pipes would never end."""
    name = raw[key]
    if not isinstance(name, str) or not name.strip() or "\0" in name:
        raise Unusable(f"expected the name of a file ending in .{key}", f'Write {key} = "curve.{key}"', key, name)
    path, remedy = folder / name, "Give the path relative to the problem file"
    try:
        if not path.is_file():
            reason = "it is a folder" if path.is_dir() else "it is no plain file" if path.exists() else "no such file"
            raise Unusable(f"cannot read the file: {reason}", remedy, key, _cut(name))
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise Unusable(f"cannot read the file: {error.strerror}", remedy, key, _cut(name)) from None
    if len(data) > MAX_BYTES:
        raise Unusable(f"{_cut(name)} is larger than {MAX_BYTES / 1e6:g} MB", "Thin it out", key, _cut(name))
    return _cut(name), data


def _tabled(raw: Mapping[str, Any], folder: Path) -> _Rows:
    """Rows of a CSV file, read here because some columns may be missing and cells be empty, which `law.read_columns` refuses."""
    name, data = _contents(raw, "csv", folder)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Unusable(f"{name} is not a CSV text file: {error.reason}", "Save it as CSV, UTF-8", "csv", name) from None
    first = text[:10_000].lstrip().partition("\n")[0]
    delimiter = next((sign for sign in ";\t" if sign in first and "," not in first), ",")
    read: list[tuple[str, str, int, float | None, array[float]]] = []
    width, numbers = 0, array("q")
    try:
        for number, cells in enumerate(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter), start=1):
            if not "".join(cells).strip():
                continue
            if not read:
                titles = _titles(cells, name)
                width = len(titles)
                read = [
                    (column, title, titles.index(title), _LEFT_OUT.get(column), array("d"))
                    for title, (column, _) in _TITLES.items()
                    if title in titles
                ]
                continue
            if len(numbers) == MAX_ROWS:
                raise Unusable(f"{name} has more than {MAX_ROWS:,} rows", "Thin them out", "csv", name)
            numbers.append(number)
            for _, title, index, left_out, values in read:
                cell = cells[index] if index < len(cells) else ""
                if left_out is not None and not cell.strip():
                    values.append(left_out)
                    continue
                try:
                    value = float(cell)
                except ValueError:
                    value = math.nan
                if not math.isfinite(value):
                    raise Unusable(
                        f"row {number} of {name} has no finite number in column {title}",
                        "Leave the cell empty where there is none"
                        if left_out is not None
                        else "Correct or remove the row; decimals have a point",
                        "csv",
                        _cut(cell) or "nothing",
                    )
                values.append(value)
            if len(cells) > width and "".join(cells[width:]).strip():
                raise Unusable(
                    f"row {number} of {name} has {len(cells)} cells, and there are {width} columns",
                    "Correct the row; decimals have a point",
                    "csv",
                    _cut(cells[width]),
                )
    except csv.Error as error:
        raise Unusable(f"{name} is not a CSV text file: {error}", "Save it as CSV, UTF-8", "csv", name) from None
    if not numbers:
        raise Unusable(f"{name} has no rows", "Give the columns x_mm and y_mm, and at least one row below them", "csv", name)
    columns = {}
    for column, title, _, _, values in read:
        unit = _TITLES[title][1]
        columns[column] = np.array(values) * (factor(unit, _COLUMNS[column]) if unit else 1.0)
    unit = next(_TITLES[title][1] for column, title, *_ in read if column == "x")
    return _Rows(columns, unit, name, numbers, "csv")


def _titles(cells: Iterable[str], name: str) -> list[str]:
    """The names of the columns, each known and none twice; empty ones at the end are left out."""
    titles = [cell.strip() for cell in cells]
    while titles and not titles[-1]:
        titles.pop()
    for title in titles:
        if title not in _TITLES:
            shown = [known for known in _TITLES if not known.endswith(("_cm", "_in"))]
            raise Unusable(f'{name} has an unknown column "{_cut(title)}"', nearest(title, shown), "csv", _cut(title))
    columns = [_TITLES[title][0] for title in titles]
    for column in ("x", "y"):
        if column not in columns:
            raise Unusable(
                f"{name} has no column {column}_mm", f"Name the columns in the first row, one of them {column}_mm", "csv", name
            )
    for column in columns:
        if columns.count(column) > 1:
            raise Unusable(f"{name} has two columns of {column}", "Keep one of them", "csv", name)
    return titles


def _wanted(rows: _Rows, asked: int | None) -> Wanted:
    """Check the rows, and reduce them where there are more than asked for, or than `MAX_POINTS`."""
    _check_ranges(rows)
    points, of_each = rows.points, set(rows.columns) - {"x", "y"}
    most, found = asked or MAX_POINTS, len(points)
    if found > most and not of_each:
        chords = np.hypot(*np.diff(points, axis=0).T)
        length, size = float(np.sum(chords)), _size(points)
        _check_size(rows)
        loop = bool(np.hypot(*(points[-1] - points[0])) <= COINCIDENT * size)
        at, here = np.linspace(0.0, length, most, endpoint=not loop), np.concatenate([[0.0], np.cumsum(chords)])
        reduced = np.stack([np.interp(at, here, points[:, 0]), np.interp(at, here, points[:, 1])], axis=1)
        _check_apart(_Rows({"x": reduced[:, 0], "y": reduced[:, 1]}, rows.unit, key="points" if asked else rows.key or ""))
        return Wanted(_pairs(reduced), unit=rows.unit, note=_reduced(rows, most, "arc length"), loop=loop)
    _check_apart(rows)
    note = ""
    columns = dict(rows.columns)
    if found > most:
        # values of a row hold at its point alone, so rows are picked and nothing is put between them
        picked = np.round(np.linspace(0, found - 1, most)).astype(int)
        columns = {name: column[picked] for name, column in columns.items()}
        note = _reduced(rows, most, "rows")
    elif asked and found < asked:
        note = f"{rows.file} has {found:,} points, fewer than the {asked} asked for; all were kept"
    crank, angles, weights, tolerances = (
        tuple(columns[name].tolist()) if name in columns else None for name in ("crank", "angle", "weight", "tolerance")
    )
    pairs = _pairs(np.stack([columns["x"], columns["y"]], axis=1))
    return Wanted(pairs, crank, angles, weights, tolerances, rows.unit, note)


def _reduced(rows: _Rows, count: int, by: str) -> str:
    of = f" of {rows.file}" if rows.file else ""
    return f"{len(rows.points):,} points{of} were reduced to {count}, evenly by {by}"


def _pairs(points: Array) -> tuple[tuple[float, float], ...]:
    return tuple((x, y) for x, y in points.tolist())


def _check_ranges(rows: _Rows) -> None:
    columns = rows.columns
    for name in ("x", "y"):
        remedy = f"Give one within {LONGEST / 1e3:g} km, and check its unit"
        rows.refuse(np.abs(columns[name]) > LONGEST, name, "{} lies too far away for a linkage", remedy)
    for name in ("crank", "angle"):
        if name in columns:
            bad = np.abs(columns[name]) > _TURNED
            rows.refuse(bad, name, f"the {name} of {{}} is too large an angle", "Give it within one turn")
    if "weight" in columns:
        bad = (columns["weight"] <= 0.0) | (columns["weight"] > _HEAVIEST)
        rows.refuse(bad, "weight", "the weight of {} is out of range", f"Give one above zero, at most {_HEAVIEST:g}")
    if "tolerance" in columns:
        tolerances = columns["tolerance"]
        bad = np.isfinite(tolerances) & ((tolerances < SHORTEST) | (tolerances > LONGEST))
        rows.refuse(bad, "tolerance", "the tolerance of {} is out of range", f"Give one above zero, at least {SHORTEST:g} m")
    if "crank" not in columns or len(columns["crank"]) < 2:
        return
    crank = columns["crank"]
    steps = np.diff(crank)
    way = 1.0 if 2 * np.count_nonzero(steps > 0.0) >= len(steps) else -1.0  # that of most
    rows.refuse(
        np.concatenate([[False], way * steps <= 0.0]),
        "crank",
        "the crank angles must rise (or fall) from row to row; that of {} does not",
        "Sort the rows by crank angle, remove repeated ones, and write 370 deg rather than 10 deg after 350 deg",
    )
    turned = np.abs(crank - crank[0]) > 2.0 * math.pi * (1.0 + 1e-9)
    remedy = "Give the points of one revolution; the motion repeats"
    rows.refuse(turned, "crank", "the crank angle of {} is more than one revolution from the first", remedy)


def _check_size(rows: _Rows) -> None:
    size = _size(rows.points)
    if len(rows.points) > 1 and size < SHORTEST:
        what = "all points lie in one place" if size == 0.0 else f"the whole path is smaller than {SHORTEST:g} m"
        raise Unusable(what, "Give points that differ, and check their unit", rows.key or "")


def _check_apart(rows: _Rows) -> None:
    """Refuse a point on the one before; with a crank angle of its own it is a dwell, and with another angle a turn in place."""
    points, columns = rows.points, rows.columns
    if "crank" not in columns:
        same = np.hypot(*np.diff(points, axis=0).T) <= COINCIDENT * _size(points)
        if "angle" in columns:
            same &= np.diff(columns["angle"]) == 0.0
        if same.any():
            row = int(np.argmax(same))
            listed = rows.key is None or rows.numbers is not None
            raise Unusable(
                f"{rows.named(row, row + 1)} coincide",
                "Remove one of them" if listed else "Ask for another number of points, or check the curve",
                f"[{row + 1}]" if rows.key is None else rows.key,
            )
    if "angle" not in columns:
        _check_size(rows)


# ---- curves, drawn or expressed


@dataclass(frozen=True)
class _Piece:
    """A piece of a curve: `at` gives its points (n, 2) [m] at u (n,) from 0 to 1; measured by `chords` chords."""

    at: Callable[[Array], Array]
    chords: int


def _evenly(pieces: Sequence[_Piece], count: int) -> tuple[Array, bool, float]:
    """Sample a curve evenly by its arc length.

    Returns
    -------
    points (count, 2) [m], exactly on the curve; whether it is closed: then the first is not repeated; its length [m]
    """
    traced = [piece.at(np.linspace(0.0, 1.0, piece.chords + 1)) for piece in pieces]
    chords = np.concatenate([np.hypot(*np.diff(points, axis=0).T) for points in traced])
    starts = np.concatenate([[0], np.cumsum([piece.chords for piece in pieces])])
    here = np.concatenate([[0.0], np.cumsum(chords)])
    low = np.min([points.min(axis=0) for points in traced], axis=0)
    high = np.max([points.max(axis=0) for points in traced], axis=0)
    size = float(np.hypot(*(high - low)))
    if not max(np.max(np.abs(low)), np.max(np.abs(high))) <= LONGEST:  # NaN too
        raise Unusable("the curve is too large for a linkage", "Check its numbers and its unit")
    if size < SHORTEST:
        raise Unusable("the curve has no length", "Check its numbers and its unit")
    loop = bool(np.hypot(*(traced[-1][-1] - traced[0][0])) <= COINCIDENT * size)
    targets = np.linspace(0.0, here[-1], count, endpoint=not loop)
    index = np.clip(np.searchsorted(here, targets, side="right") - 1, 0, len(chords) - 1)
    fraction = (targets - here[index]) / np.where(chords[index] > 0.0, chords[index], 1.0)
    piece = np.clip(np.searchsorted(starts, index, side="right") - 1, 0, len(pieces) - 1)
    u = np.clip([(i - starts[p] + f) / pieces[p].chords for i, f, p in zip(index, fraction, piece, strict=True)], 0.0, 1.0)
    return np.concatenate([pieces[p].at(at[None]) for p, at in zip(piece, u, strict=True)]), loop, float(here[-1])


def _sampled(points: Array, unit: str, loop: bool, note: str) -> Wanted:
    _check_apart(_Rows({"x": points[:, 0], "y": points[:, 1]}, unit, key="points"))
    return Wanted(_pairs(points), unit=unit, note=f"{note}; closed, the first is not repeated" if loop else note, loop=loop)


def _expressed(raw: Mapping[str, Any]) -> Wanted:
    for key, example in (("x", '"20*cos(t)"'), ("y", '"10*sin(t)"'), ("t", '[0, "2*pi"]'), ("unit", '"mm"')):
        if key not in raw:
            raise Unusable(
                f"expressions of points need {key}",
                f'Add {key} = {example}; listed points are written [["20 mm", "25 mm"], ...]',
                key,
            )
    unit, size, count = raw["unit"], _unit(raw), _count(raw)
    spacing = raw.get("spacing", "t")
    if spacing not in ("t", "arc length"):
        raise Unusable("unknown spacing of the points", 'Write "t" or "arc length"', "spacing", spacing)
    x, y = (_expression(raw[key], ("t",), key) for key in ("x", "y"))
    bounds = raw["t"]
    if not isinstance(bounds, list | tuple) or len(bounds) != 2:
        raise Unusable("t needs two values, first and last", 'Write t = [0, "2*pi"]', "t", bounds)
    begin, end = (_bound(bound, f"t[{number}]") for number, bound in enumerate(bounds))
    if begin == end:
        raise Unusable("t starts where it ends", 'Write t = [0, "2*pi"], for example', "t[1]", bounds[1])
    fine = np.linspace(begin, end, _FINE + 1)
    for key, law in (("x", x), ("y", y)):
        worry = law.hazards({"t": fine})
        if not worry and np.max(np.abs(np.asarray(law({"t": fine}), dtype=float))) * size > LONGEST:
            worry = f"exceeds {LONGEST / 1e3:g} km"
        if worry:
            raise Unusable(
                f"{key} {worry} between t = {begin:.6g} and t = {end:.6g}", "Choose another range of t", key, _cut(raw[key])
            )

    def at(u: Array) -> Array:
        known = {"t": begin + (end - begin) * u}
        return np.stack([np.broadcast_to(np.asarray(law(known), dtype=float), u.shape) for law in (x, y)], axis=1) * size

    points, loop, length = _evenly([_Piece(at, _FINE)], count)
    if spacing == "t":
        points = at(np.linspace(0.0, 1.0, count, endpoint=not loop))
    note = f"a curve {show(length, 'length', unit)} long, sampled at {count} points evenly by {spacing}"
    return _sampled(points, unit, loop, note)


def _expression(raw: object, names: Iterable[str], key: str) -> Expression:
    if not isinstance(raw, str):
        raise Unusable("an expression is text", f'Write {key} = "20*cos(t)", for example', key, raw)
    try:
        return parse(raw, names)
    except LawError as error:
        raise Unusable(error.message, error.remedy, key, _cut(raw)) from None


def _bound(raw: object, key: str) -> float:
    remedy = 'Write a plain number or a constant expression, for example 0 or "2*pi"'
    if isinstance(raw, bool) or not isinstance(raw, int | float | str):
        raise Unusable("expected a bound of t", remedy, key, raw)
    if not isinstance(raw, str):
        value: Any = raw
    else:
        try:
            value = parse(raw, ())({})
        except LawError as error:
            raise Unusable(error.message, remedy, key, _cut(raw)) from None
    if not abs(value) <= _HEAVIEST:  # NaN too
        raise Unusable("the bound of t is not finite, or too large", remedy, key, _cut(raw))
    return float(value)


# ---- SVG

_SVG = "http://www.w3.org/2000/svg"
_SHAPES = ("path", "line", "polyline", "polygon", "rect", "circle", "ellipse")
_PLAIN = ("g", "a", "switch")  # what a shape may lie in; defs, symbols, nested drawings and the like place it elsewhere
_MOVING = ("animate", "animateTransform", "animateMotion", "set")
_PROPERTY = re.compile(r"transform(?:-origin)?|translate|rotate|scale|offset-path|zoom|d|c[xy]|r[xy]?", re.IGNORECASE)
_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72.0, "pc": 25.4 / 6.0, "q": 0.25}
_PIXEL = 25.4 / 96.0  # mm, of CSS
_FLATTEN = "Flatten it (Inkscape: Path > Object to Path, ungroup, save as Plain SVG)"

_N = r"(?>[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
_S = r"(?>[ \t\r\n]*)"
_C = rf"(?>{_S},?{_S})"
# svg.path leaves off what it cannot read at the end of a command, so the whole text is held against the grammar first; nothing
# in it is tried twice (atomic groups), so its time is linear
_GRAMMAR = re.compile(
    rf"{_S}(?=[Mm])(?>(?:(?:[MmLlTt]{_S}(?>(?:{_N}{_C}){{2}})++|[HhVv]{_S}(?:{_N}{_C})++|[Cc]{_S}(?>(?:{_N}{_C}){{6}})++"
    rf"|[SsQq]{_S}(?>(?:{_N}{_C}){{4}})++|[Aa]{_S}(?>(?:(?!-){_N}{_C}){{2}}{_N}{_C}[01]{_C}[01]{_C}(?:{_N}{_C}){{2}})++|[Zz]{_S})"
    rf"(?=[A-Za-z]|\Z))*+)"
)
_FUNCTION = re.compile(rf"{_C}(matrix|translate|scale|rotate|skewX|skewY){_S}\(([^()]*)\){_C}")


@dataclass
class _Element:
    """`drawn`: where it stands, not elsewhere by a copy; `moved`: by an animation."""

    tag: str
    attributes: Mapping[str, str]
    parent: _Element | None
    drawn: bool
    moved: bool = False

    @property
    def id(self) -> str:
        return self.attributes.get("id", "")

    def __str__(self) -> str:
        return f'<{self.tag} id="{_cut(self.id)}">' if self.id else f"<{self.tag}>"

    def chain(self) -> list[_Element]:
        """From the root to this one."""
        found: list[_Element] = []
        here: _Element | None = self
        while here is not None:
            found.append(here)
            here = here.parent
        return found[::-1]


def _elements(data: bytes, name: str) -> tuple[_Element, list[_Element], str]:
    """Root, shapes and style sheets of a drawing.

    Read by expat itself rather than into a tree: a file that declares entities is refused before they can grow, and what is no
    shape takes no memory. A DOCTYPE that only points elsewhere, as most editors write it, is harmless: it is never followed.
    """
    parser = expat.ParserCreate(namespace_separator=" ")
    open_now: list[_Element] = []
    roots: list[_Element] = []
    shapes: list[_Element] = []
    sheets: list[str] = []
    seen = {"elements": 0, "doctype": 0}

    def start(spelled: str, attributes: dict[str, str]) -> None:
        seen["elements"] += 1
        if seen["elements"] > MAX_ROWS:
            raise Unusable(f"{name} has more than {MAX_ROWS:,} elements", "Save the curve alone", "svg", name)
        space, _, tag = spelled.rpartition(" ")
        above = open_now[-1] if open_now else None
        drawn = above is None or above.parent is None or (above.drawn and above.tag in _PLAIN)
        element = _Element(tag if space in ("", _SVG) else "", attributes, above, drawn)
        if not open_now:
            roots.append(element)
        elif element.tag in _MOVING:
            open_now[-1].moved = True
        elif element.tag in _SHAPES:
            shapes.append(element)
        open_now.append(element)

    def text(words: str) -> None:
        if open_now[-1].tag == "style":
            sheets.append(words)

    def doctype(_name: str, _system: str | None, _public: str | None, internal: bool) -> None:
        seen["doctype"] = 1
        if internal:
            raise Unusable(f"{name} declares entities of its own", "Save it without (Inkscape: Plain SVG)", "svg", name)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: open_now.pop()
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(data, True)
    except Unusable:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise Unusable(f"{name} is not an SVG file: {error}", "Save the drawing as SVG", "svg", name) from None
    # with a DOCTYPE, expat passes over unknown entities in silence, and part of a path could be lost
    if seen["doctype"] and re.search(rb"&(?!#|amp;|lt;|gt;|quot;|apos;)", data.replace(b"\0", b"")):
        raise Unusable(f"{name} uses entities", "Save it without (Inkscape: Plain SVG)", "svg", name)
    if roots[0].tag != "svg":
        raise Unusable(
            f"{name} is not an SVG file: it begins with <{_cut(roots[0].tag)}>", "Save the drawing as SVG", "svg", name
        )
    return roots[0], shapes, "".join(sheets)


def _chosen(shapes: Sequence[_Element], raw: Mapping[str, Any], name: str) -> _Element:
    """The shape with the id `path`, or the path of that number (of another shape where there are no paths)."""
    asked = raw.get("path", 1)
    if isinstance(asked, bool) or not isinstance(asked, int | str):
        raise Unusable("expected an id or a number", 'Write path = "curve", or path = 1', "path", asked)
    if isinstance(asked, str) and asked:
        named = [shape for shape in shapes if shape.id == asked]
        if len(named) > 1:
            raise Unusable(f"{name} has {len(named)} shapes of that id", "Give each its own, or name it by number", "path", asked)
        if named:
            return named[0]
    drawn = [shape for shape in shapes if shape.drawn]
    numbered = [shape for shape in drawn if shape.tag == "path"] or drawn
    if not numbered:
        raise Unusable(f"{name} draws no path", "Save a drawing that has one; text and pictures are none", "svg", name)
    listing = ", ".join(f"{number} {shape}" for number, shape in enumerate(numbered[:8], start=1))
    remedy = f"It has, by number: {listing}{', ...' if len(numbered) > 8 else ''}"
    if "path" not in raw and len(numbered) != 1:
        raise Unusable(f"{name} has {len(numbered)} paths, so the wanted one must be named", remedy, "path")
    number = asked if isinstance(asked, int) else int(asked) if re.fullmatch("[0-9]{1,7}", asked) else 0
    if not 1 <= number <= len(numbered):
        raise Unusable(f"{name} has no such path", remedy, "path", _cut(asked))
    return numbered[number - 1]


def _placed(shape: _Element, sheets: str, name: str) -> Array:
    """Matrix (3, 3) from the shape's own coordinates to those of the drawing.

    Whatever else could move the shape is refused, for a drawing that is read wrongly looks right.
    """
    matrix = np.eye(3)
    chain = shape.chain()
    for element in chain:
        if element is not chain[0] and element is not shape and element.tag not in _PLAIN:
            raise Unusable(f"{shape} of {name} lies in {element}, which places it elsewhere", _FLATTEN, "path", shape.id)
        style = [part.partition(":")[0].strip() for part in element.attributes.get("style", "").split(";")]
        if element.moved or any(map(_PROPERTY.fullmatch, style)) or "transform-origin" in element.attributes:
            why = "an animation" if element.moved else "a style"
            raise Unusable(f"{element} of {name} is moved by {why}, which is not understood", _FLATTEN, "path", shape.id)
        matrix = matrix @ _transform(element, name)
    if any(map(_PROPERTY.fullmatch, re.findall(r"(?<![-\w])([-\w]++)\s*+:", sheets))):
        raise Unusable(f"{name} has a style sheet that may move shapes, which is not understood", _FLATTEN, "svg", name)
    return matrix


def _transform(element: _Element, name: str) -> Array:
    text = element.attributes.get("transform", "").strip()
    matrix, end = np.eye(3), 0
    while end < len(text):
        match = _FUNCTION.match(text, end)
        step = _step(match.group(1), match.group(2)) if match else None
        if match is None or step is None:
            raise Unusable(f"the transform of {element} of {name} cannot be read", _FLATTEN, "path", _cut(text[end:]))
        matrix, end = matrix @ step, match.end()
    return matrix


def _step(function: str, text: str) -> Array | None:
    """Matrix (3, 3) of one function of a transform, or None."""
    if not re.fullmatch(rf"{_S}(?:{_N}{_C})*+", text):
        return None
    values = [float(number) for number in re.findall(_N, text)]
    a, b, c, d, e, f = 1.0, 0.0, 0.0, 1.0, 0.0, 0.0
    match function, values:
        case "matrix", [a, b, c, d, e, f]:
            pass
        case "translate", [e]:
            pass
        case "translate", [e, f]:
            pass
        case "scale", [a]:
            d = a
        case "scale", [a, d]:
            pass
        case "rotate", [turn, *centre] if len(centre) in (0, 2):
            a, b = math.cos(math.radians(turn)), math.sin(math.radians(turn))
            c, d = -b, a
            x, y = centre or (0.0, 0.0)
            e, f = x - a * x - c * y, y - b * x - d * y
        case "skewX", [turn]:
            c = math.tan(math.radians(turn))
        case "skewY", [turn]:
            b = math.tan(math.radians(turn))
        case _:
            return None
    matrix = np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])
    return matrix if np.all(np.isfinite(matrix)) else None


def _scale(root: _Element, name: str, forgive: bool) -> float | None:
    """Millimetres of one user unit as the drawing itself says it; None where it does not, or not clearly and we `forgive`."""
    sides = []
    for side in ("width", "height"):
        match = re.fullmatch(rf"({_N})\s*([a-zA-Z]+)", root.attributes.get(side, "").strip())
        unit = match.group(2).lower() if match else ""
        sides.append(float(match.group(1)) * _MILLIMETRES[unit] if match and unit in _MILLIMETRES else None)
    if sides == [None, None]:
        return None
    if "viewBox" not in root.attributes:
        return _PIXEL
    box, add = root.attributes["viewBox"], 'Correct it, or say how long a user unit is: unit = "mm"'
    values = [float(number) for number in re.findall(_N, box)] if re.fullmatch(rf"{_S}(?:{_N}{_C}){{4}}", box) else []
    scales = [side / whole for side, whole in zip(sides, values[2:], strict=False) if side is not None and whole > 0.0]
    clear = bool(values and scales) and all(math.isfinite(scale) and scale > 0.0 for scale in scales)
    kept = root.attributes.get("preserveAspectRatio", "")
    stretched = clear and "none" in kept and max(scales) > min(scales) * (1.0 + 1e-6)
    if forgive and (stretched or not clear):
        return None
    if not clear:
        raise Unusable(f"the viewBox of {name} cannot be read", add, "svg", _cut(box))
    if stretched:
        raise Unusable(f"{name} is stretched: its width and height do not go with its viewBox", add, "svg", _cut(box))
    return max(scales) if "slice" in kept else min(scales)


def _drawn(raw: Mapping[str, Any], folder: Path) -> Wanted:
    count = _count(raw)
    stated = _unit(raw) * 1e3 if "unit" in raw else None
    name, data = _contents(raw, "svg", folder)
    root, shapes, sheets = _elements(data, name)
    shape = _chosen(shapes, raw, name)
    own = _scale(root, name, stated is not None)
    scale = stated or own or 1.0
    matrix = np.diag([1e-3 * scale, -1e-3 * scale, 1.0]) @ _placed(shape, sheets, name)
    try:
        with np.errstate(all="ignore"):
            curves = _curves(shape, name)
            fine = min(max(_FINE // max(len(curves), 1), 16), 2048)
            pieces = [_Piece(_onto(curve, matrix), 1 if straight else fine) for curve, straight in curves]
            points, loop, length = _evenly(pieces, count)
    except Unusable as error:
        key = error.key or "path"
        raise Unusable(f"{shape} of {name}: {error.message}", error.remedy, key, error.value) from None
    unit = raw.get("unit", "mm")
    said = "as stated" if stated else "as the file says" if own else "as the file does not say"
    if stated and own and not math.isclose(stated, own, rel_tol=1e-6):
        said = f"as stated, though the file says {own:.6g} mm"
    note = f"{shape} of {name}, {show(length, 'length', unit)} long, sampled at {count} points evenly by arc length"
    return _sampled(points, unit, loop, f"{note}; one user unit is {scale:.6g} mm, {said}")


_Curve = Callable[[Array], Drawn]  # x + iy in user units at u from 0 to 1


def _onto(curve: _Curve, matrix: Array) -> Callable[[Array], Array]:
    def at(u: Array) -> Array:
        z = curve(u)
        x, y = z.real, z.imag
        return np.stack(
            [matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2], matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]], 1
        )

    return at


def _curves(shape: _Element, name: str) -> list[tuple[_Curve, bool]]:
    """The curves that make up a shape, one beginning where the other ends, each with whether it is straight."""

    def size(key: str) -> float:
        text = shape.attributes.get(key, "0").strip()
        if not re.fullmatch(rf"{_N}(?:px)?", text):
            raise Unusable(f"its {key} is no plain number", _FLATTEN, "", _cut(text))
        return float(text.removesuffix("px"))

    if shape.tag in ("circle", "ellipse"):
        radii = (size("r"), size("r")) if shape.tag == "circle" else (size("rx"), size("ry"))
        return [(_ellipse(complex(size("cx"), size("cy")), radii, 1.0 + 0.0j, 0.0, 2.0 * math.pi), False)]
    if shape.tag == "rect":
        if "rx" in shape.attributes or "ry" in shape.attributes:
            raise Unusable("a rectangle with round corners is not understood", _FLATTEN)
        return _path(f"M {size('x')!r} {size('y')!r} h {size('width')!r} v {size('height')!r} h {-size('width')!r} z")
    if shape.tag == "line":
        return _path(f"M {size('x1')!r} {size('y1')!r} L {size('x2')!r} {size('y2')!r}")
    if shape.tag in ("polyline", "polygon"):
        return _path(f"M {shape.attributes.get('points', '')} {'Z' if shape.tag == 'polygon' else ''}")
    return _path(shape.attributes.get("d", ""))


def _path(text: str) -> list[tuple[_Curve, bool]]:
    from svg.path import Arc, Close, Line, Move, parse_path

    broken = "The data is that of the SVG standard: M 0 0 L 10 5 C ..."
    match = _GRAMMAR.match(text)
    end = match.end() if match else 0
    if not text.strip():
        raise Unusable("there is no path data", broken)
    if end < len(text):
        raise Unusable(f"its data cannot be read from character {end + 1} on", broken, "", _cut(text[end:]))
    try:
        segments = list(parse_path(text))
    except (ValueError, ArithmeticError) as error:
        raise Unusable(f"its data cannot be read: {_cut(error)}", broken) from None
    if len(segments) > MAX_SEGMENTS:
        raise Unusable(f"it has more than {MAX_SEGMENTS:,} segments", "Simplify it (Inkscape: Path > Simplify)")
    curves: list[tuple[_Curve, bool]] = []
    here: complex | None = None
    for segment in segments:
        if isinstance(segment, Move) or (isinstance(segment, Line | Close) and segment.start == segment.end):
            continue
        if here is not None and segment.start != here:
            raise Unusable("it has more than one part", "Break it apart (Inkscape: Path > Break Apart) and name one part")
        here = segment.end
        if not cmath.isfinite(here):
            raise Unusable("it goes beyond all bounds", broken)
        if isinstance(segment, Arc):
            curve = _arc(segment)
            if curve is not None:
                curves.append(curve)
        else:
            curves.append((segment.point, isinstance(segment, Line | Close)))  # type: ignore[arg-type]  # takes arrays too
    if not curves:
        raise Unusable("it has no length", broken)
    return curves


def _ellipse(centre: complex, radii: tuple[float, float], turn: complex, begin: float, sweep: float) -> _Curve:
    def at(u: Array) -> Drawn:
        angle = begin + sweep * u
        return np.asarray(centre + turn * (radii[0] * np.cos(angle) + 1j * radii[1] * np.sin(angle)))

    return at


def _arc(segment: Any) -> tuple[_Curve, bool] | None:
    """An elliptical arc; straight where a radius is zero, and nothing where it ends at its start, as the standard has it."""
    start, end = segment.start, segment.end
    if start == end:
        return None
    if segment.radius.real == 0.0 or segment.radius.imag == 0.0:
        return (lambda u: start + (end - start) * u), True
    radii = (segment.radius.real * segment.radius_scale, segment.radius.imag * segment.radius_scale)
    turn = complex(math.cos(math.radians(segment.rotation)), math.sin(math.radians(segment.rotation)))

    def angle(point: complex) -> float:
        # svg.path takes an arc cosine, which loses half the digits of a half turn
        w = (point - segment.center) / turn
        return math.atan2(w.imag / radii[1], w.real / radii[0])

    begin = angle(start)
    sweep = (angle(end) - begin) % (2.0 * math.pi)
    return _ellipse(segment.center, radii, turn, begin, sweep if segment.sweep else sweep - 2.0 * math.pi), False
