"""Target points of a path or poses of a body, and functions shared by their readers."""

import codecs
import contextlib
import csv
import io
import itertools
import math
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.problem.quantity import LONGEST, SHORTEST, Unusable, below, check_keys, is_number, largest, nearest, read_scalar
from optlink.units import KINDS, count_noun, factor, plain, read_number, respelled, show

MAX_POINTS = 400
MAX_BYTES = 50_000_000
DEFAULT_POINTS = 60  # for a drawing or an expression
COINCIDENT = 1e-9  # share of the size of the whole path
HEAVIEST = 1e9  # largest plain number, such as a weight
BINARY = {
    b"PK\x03\x04": "a ZIP archive, such as an Excel or Word file",
    b"%PDF": "a PDF file",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"GIF8": "a picture",
    b"\xd0\xcf\x11\xe0": "an Office file",
}
"""Kinds of files that are not text, by their first bytes."""


@dataclass(frozen=True)
class TargetPoints:
    """Target points [m] of a path, in order; with `angles`, poses of a body.

    `crank`, `angles` [rad]: the crank angle and the angle of the body at each point, None if not prescribed, NaN at a point among
    poses. `weights` of the
    squared distances, None where all are 1. `tolerances` [m]: the largest permitted distance, inf where there is none. `unit` for
    display. `loop`: sampled from a closed curve, whose first point is not repeated at the end. `note`: description of the
    sampling or reduction, for display. `sampled`: the points are not listed, but taken from a curve.
    """

    points: tuple[tuple[float, float], ...]
    crank: tuple[float, ...] | None = None
    angles: tuple[float, ...] | None = None
    weights: tuple[float, ...] | None = None
    tolerances: tuple[float, ...] | None = None
    unit: str = "mm"
    note: str = field(default="", compare=False)
    loop: bool = False
    sampled: bool = field(default=False, compare=False)

    @property
    def posed(self) -> NDArray[np.bool_]:
        """Which points have an angle."""
        given: NDArray[np.bool_] = ~np.isnan(np.full(len(self.points), np.nan) if self.angles is None else np.array(self.angles))
        return given

    @property
    def size(self) -> float:
        """Diagonal [m] of the rectangle around the points."""
        return diagonal(np.asarray(self.points))


def closed(targets: TargetPoints) -> bool:
    """Return whether the points form a closed curve: sampled from one, or listed with the last on the first."""
    if targets.loop:
        return True
    first, last = targets.points[0], targets.points[-1]
    return len(targets.points) > 2 and math.dist(first, last) <= COINCIDENT * targets.size


def read_count(raw: Mapping[str, Any]) -> int:
    """Read the number of points at which a curve is sampled.

    Raises
    ------
    Unusable
    """
    count = raw.get("points", DEFAULT_POINTS)
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_POINTS:
        raise Unusable(f"expected a whole number from 2 to {MAX_POINTS}", "Write points = 60, for example", "points", count)
    return count


def metres(raw: Mapping[str, Any]) -> float:
    """Return the length of one unit [m].

    Raises
    ------
    Unusable
    """
    if not isinstance(raw["unit"], str):
        raise Unusable("expected a unit of length", 'Write unit = "mm"', "unit", raw["unit"])
    with below("unit", raw["unit"]):
        return factor(raw["unit"], "length")


def diagonal(points: Array) -> float:
    """Return the diagonal of the rectangle around points (n, 2)."""
    return float(np.hypot(*np.ptp(points, axis=0)))


def shortened(value: object) -> str:
    """Return a shortened printable piece of an input value, for messages."""
    text = str(value)
    printable = "".join(sign if sign.isprintable() else " " for sign in text[:60])
    return printable if len(text) <= 60 else f"{printable}..."


def file_kind(data: bytes) -> str:
    """Return the kind of a file that is not text, by its first bytes; empty for any other file."""
    return next((words for start, words in BINARY.items() if data.startswith(start)), "")


ENCLOSED = "data:"
"""Beginning of a value that encloses a file, as stored results do: then its name and, from the next line on, its content."""


def split_enclosed(value: str) -> tuple[str, str]:
    """Return name and content of an enclosed file, or the name of another file and an empty text."""
    if not value.startswith(ENCLOSED) or "\n" not in value:
        return value, ""
    name, _, content = value.removeprefix(ENCLOSED).partition("\n")
    return name, content


def enclosed(name: str, content: str) -> str:
    """Return the value that encloses a file."""
    return f"{ENCLOSED}{name}\n{content}"


def read_file(raw: Mapping[str, Any], key: str, folder: Path) -> tuple[str, bytes]:
    """Return the display name and the bytes of a file; devices and pipes are refused.

    It may be enclosed in the value itself, see `ENCLOSED`.

    Parameters
    ----------
    key : str
        Key of `raw` with the name of the file; also its suffix.
    folder : Path
        Folder to which the name is relative.

    Raises
    ------
    Unusable
        when the file cannot be read or is too large.
    """
    name = raw[key]
    if isinstance(name, str) and name.startswith(ENCLOSED) and "\n" in name:
        title, content = split_enclosed(name)
        return shortened(title), content.encode()
    if not isinstance(name, str) or not name.strip() or "\0" in name:
        raise Unusable(f"expected the name of a file ending in .{key}", f'Write {key} = "curve.{key}"', key, name)
    path, remedy = folder / name, "Give the path relative to the problem file"
    try:
        if not path.is_file():
            reason = "it is a folder" if path.is_dir() else "it is not a regular file" if path.exists() else "no such file"
            raise Unusable(f"cannot read the file: {reason}", remedy, key, shortened(name))
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise Unusable(f"cannot read the file: {error.strerror}", remedy, key, shortened(name)) from None
    if len(data) > MAX_BYTES:
        raise Unusable(f"{shortened(name)} is larger than {MAX_BYTES / 1e6:g} MB", "Reduce its size", key, shortened(name))
    return shortened(name), data


SHIFTED = re.compile("[\0\ufffd" + "\r\n123456789".encode("utf-16-be").decode("utf-16-le") + "]")
"""What UTF-16 contains where a byte is lost: line ends and digits whose two bytes are exchanged, and what is no character."""


def decoded(data: bytes, encoding: str = "latin-1") -> str:
    """Return the text of a file: UTF-8, UTF-16 with its byte order mark, else in an 8-bit encoding.

    Raises
    ------
    ValueError
        If it is no text; the message says what it is.
    """
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if not wide and ((kind := file_kind(data)) or b"\0" in data):
        raise ValueError(kind or "UTF-16 without its mark, or no text")
    with contextlib.suppress(UnicodeDecodeError):
        return data.decode("utf-8-sig")
    text = data.decode("utf-16" if wide else encoding, errors="replace")
    if wide and (len(data) % 2 or SHIFTED.search(text)):
        raise ValueError("damaged UTF-16, or UTF-32")
    return text


def pairs(points: Array) -> tuple[tuple[float, float], ...]:
    """Return points (n, 2) as plain numbers."""
    return tuple((x, y) for x, y in points.tolist())


# CSV files: delimiter, title row, and the rows below it with their numbers in the file.

DECIMALS = "decimals have a point"
MAX_ROWS = 10_000  # of a table; points have their own
SAVE = "Save it as CSV, UTF-8"
COMMENTS = re.compile(
    r"(?:^|(?<=[\r\n]))[ \t]*(?:%|#(?![A-Z]+[/!?,;\t]))[^\r\n]*"
)  # "#N/A" and "#DIV/0!" are faults of a spreadsheet
REVOLUTION = (2.0 * math.pi * (1.0 - 1e-3), 2.0 * math.pi * (1.0 + 1e-3))  # degrees that were radians


@dataclass(frozen=True)
class CsvTable:
    """A CSV file: `name` for display, `titles` of its columns; `rows`, read once: number in the file and cells."""

    name: str
    titles: Sequence[str]
    rows: Iterator[tuple[int, list[str]]]

    def number(self, row: int, cells: Sequence[str], index: int, remedy: str = f"Correct or remove the row; {DECIMALS}") -> float:
        """Return the number in a cell, by the number of its row in the file and the index of its column.

        Raises
        ------
        Unusable
        """
        cell = cells[index] if index < len(cells) else ""
        value = read_number(plain(cell))
        if not math.isnan(value):
            return value
        fault, remedy = _fault(cell.strip(), remedy)
        message = f"row {row} of {self.name} has {fault} in column {self.titles[index]}"
        raise Unusable(message, remedy, "csv", shortened(cell) or None)

    def check_unit(self, index: int, least: float, largest: float) -> None:
        """Refuse angles in degrees that run through one revolution in radians.

        Raises
        ------
        Unusable
        """
        title = self.titles[index]
        if title.endswith("_deg") and REVOLUTION[0] < largest - least < REVOLUTION[1]:
            message = f"column {title} of {self.name} runs from {least:.6g} to {largest:.6g}: this is one revolution in radians"
            remedy = f"Name the column {title.removesuffix('_deg')}_rad, or give its values in degrees"
            raise Unusable(message, remedy, "csv", title)


def _fault(cell: str, remedy: str) -> tuple[str, str]:
    """Return what a cell has in place of a finite number, and a remedy, by default that of the argument."""
    (numbers, rest), written = respelled(plain(cell)), re.fullmatch(r"([-+]?[.\d]+)\s*[^\W\d]+", cell)
    if len(numbers) > 1 and not rest:
        return "a comma that may separate decimals or thousands", f"Write {' or '.join(numbers)} in all such cells"
    if re.fullmatch(r"[-+]?[\d.]*\d,\d+", cell):
        return "a decimal comma", "Replace the decimal commas of the file by points" + (f": {numbers[0]}" if "." in cell else "")
    if numbers and not rest:
        return "thousands separators", f"Write {numbers[0]}, and the other numbers of the file in this way"
    if written and not math.isnan(read_number(written[1])):
        return "a unit", f"Write {written[1]} alone; the title of the column has the unit"
    return "no finite number", remedy


def read_csv(raw: Mapping[str, Any], folder: Path, most: int) -> CsvTable:
    """Read a CSV file with a title row; its delimiter is a comma, or a semicolon or tab of the title row.

    Lines that begin with # or % are comments. Text is UTF-8, UTF-16 with its byte order mark, or an 8-bit code, in which numbers
    and the titles of optlink are the same. Devices, pipes and files that are too large are refused.

    Raises
    ------
    Unusable
        If the file cannot be read or is not text; on reading its rows, if there are too many or one has more cells than titles.
    """
    name, data = read_file(raw, "csv", folder)
    try:
        text = decoded(data)
    except ValueError as error:
        raise Unusable(f"{name} is not a CSV text file: it is {error}", SAVE, "csv", name) from None
    separator_line = re.match(r"sep=([;,\t])[;,\t\s]*?\r?\n", text, re.IGNORECASE)  # Excel's own first line
    text = text[separator_line.end() :] if separator_line else text
    text = COMMENTS.sub("", text)
    first = text[:10_000].lstrip().partition("\n")[0]
    delimiter = next((sign for sign in ";\t" if sign in first and "," not in first), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
    rows = _filled(reader, name, 2 if separator_line else 1)
    titles = [cell.strip() for cell in next(rows, (0, []))[1]]
    while titles and not titles[-1]:
        titles.pop()
    if len(titles) == 1 and re.search(r"_\w+[\s|:]+\w", titles[0]):
        remedy = "Separate its columns by commas, semicolons or tabs"
        raise Unusable(f"{name} has a single column", remedy, "csv", shortened(titles[0]))
    return CsvTable(name, titles, _checked(rows, name, len(titles), most))


def _filled(reader: Iterator[list[str]], name: str, first: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows that are not empty."""
    try:
        yield from ((number, cells) for number, cells in enumerate(reader, start=first) if "".join(cells).strip())
    except csv.Error as error:
        raise Unusable(f"{name} is not a CSV text file: {error}", SAVE, "csv", name) from None


def _checked(rows: Iterator[tuple[int, list[str]]], name: str, width: int, most: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows; a decimal comma that splits a number in two is refused by the number of cells."""
    for count, (number, cells) in enumerate(rows):
        if count == most:
            raise Unusable(f"{name} has more than {most:,} rows", "Reduce their number", "csv", name)
        if len(cells) > width and "".join(cells[width:]).strip():
            message = f"row {number} of {name} has {len(cells)} cells, the title row has {width}"
            raise Unusable(message, f"Correct the row; {DECIMALS}", "csv", shortened(cells[width]))
        yield number, cells


COLUMN_UNITS = {
    "angle": ("deg", "rad"),
    "coordinate": ("mm", "m", "cm", "in"),
    "force": ("N", "kN"),
    "torque": ("Nm",),
    "angular velocity": ("rpm", "rad_s"),
    "velocity": ("m_s", "mm_s"),
    "pressure": ("bar", "MPa", "kPa", "Pa"),
    "time": ("s", "ms"),
    "voltage": ("V",),
}
"""Units that a column name ends in, for each kind; volts are plain numbers."""


def read_columns(
    raw: Mapping[str, Any],
    folder: Path,
    kinds: Mapping[str, str],
    *,
    ordered: Literal["", "rising", "either way"] = "",
    most: int = MAX_ROWS,
) -> list[list[float]]:
    """Return columns [SI] of a CSV file whose header names them with their units: phi_deg, s_mm, force_N.

    `kinds` has the physical kind for each column name; `ordered` is whether the first of them must rise from row to row, or rise
    or fall.

    Raises
    ------
    Unusable
    """
    table = read_csv(raw, folder, most)
    columns = [(*_column(table, name, kind), kind) for name, kind in kinds.items()]
    numbers, values = [], []
    for number, cells in table.rows:
        numbers.append(number)
        values.append([table.number(number, cells, index) for index, *_ in columns])
        for value, (index, size, kind) in zip(values[-1], columns, strict=True):
            if abs(value * size) > largest(kind):
                message = f"row {number} of {table.name} has too large a value in column {table.titles[index]}"
                unit = KINDS[kind].si if kind in KINDS else ""
                raise Unusable(message, f"Give at most {largest(kind):.0e} {unit}".rstrip(), "csv", shortened(cells[index]))
    if len(values) < 2:
        message = f"{table.name} has {'a single row' if values else 'no row'} below its titles"
        raise Unusable(message, "Give two or more", "csv", table.name)
    if ordered:
        first = [row[0] for row in values]
        table.check_unit(columns[0][0], min(first), max(first))
        _check_order(table.titles[columns[0][0]], table.name, numbers, first, ordered == "rising")
    return [[row[place] * size for row in values] for place, (_, size, _) in enumerate(columns)]


def _check_order(title: str, name: str, numbers: Sequence[int], values: Sequence[float], rising: bool) -> None:
    """Refuse the first row whose value is not beyond that of the row before."""
    way = 1.0 if rising or values[-1] > values[0] else -1.0
    for number, (before, value) in zip(numbers[1:], itertools.pairwise(values), strict=True):
        if not way * (value - before) > 0.0:
            must = "rise" if rising else "rise (or fall)"
            message = f"row {number} of {name} has {title} = {value:.6g} after {before:.6g}, which must {must} from row to row"
            raise Unusable(message, f"Sort the rows by {title}, and remove repeated ones", "csv", f"{value:.6g}")


def _column(table: CsvTable, name: str, kind: str) -> tuple[int, float]:
    """Return the index of a column and its unit [SI]."""
    units = {f"{name}_{unit}": unit for unit in COLUMN_UNITS[kind]}
    indices = [index for index, title in enumerate(table.titles) if title in units]
    if not indices:
        message = f"{table.name} has no column {' or '.join(units)}"
        remedy = f"Name the columns in the first row, one of them {next(iter(units))}"
        raise Unusable(message, remedy, "csv", shortened(", ".join(table.titles)) or None)
    if len(indices) > 1:
        raise Unusable(f"{table.name} has two columns of {name}", "Keep one of them", "csv")
    unit = units[table.titles[indices[0]]].replace("_", "/")
    return indices[0], 1.0 if unit == "V" else factor(unit, kind)


# Points listed in the problem file or in a CSV file: read, checked, and reduced if there are too many.

MOST_POINTS = 1_000_000

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
            kind, value = POINT_COLUMNS[column], float(self.columns[column][row])
            raise Unusable(message.format(self.named(row)), remedy, key, show(value, kind) if kind else f"{value:.6g}")


POINT_COLUMNS = {"x": "coordinate", "y": "coordinate", "crank": "angle", "angle": "angle", "weight": "", "tolerance": "length"}
_LEFT_OUT = {"weight": 1.0, "tolerance": math.inf, "angle": math.nan}  # defaults of a row


def read_rows(raw: Sequence[object]) -> PointRows:
    """Read rows listed in the problem file, each a list of two or a table.

    Raises
    ------
    Unusable
        If there is no row or there are too many, or a row is invalid, with its index.
    """
    if len(raw) > MOST_POINTS:
        raise Unusable(f"there are {len(raw):,} points, more than {MOST_POINTS:,}", "Reduce their number", "")
    example = 'Write ["20 mm", "25 mm"], or { x = "20 mm", y = "25 mm", crank = "30 deg" }'
    columns: dict[str, list[float]] = {name: [] for name in POINT_COLUMNS}
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
            check_keys(row, list(POINT_COLUMNS))
        for name, kind in POINT_COLUMNS.items():
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
    lacks = next((number for number, value in enumerate(columns["crank"]) if math.isnan(value)), None)
    if "crank" in first_rows and lacks is not None:
        message = f"point {lacks + 1} has no crank, and point {first_rows['crank'] + 1} has one"
        raise Unusable(message, "Give crank of all points or of none", f"[{lacks}].crank")
    return PointRows({name: np.array(columns[name]) for name in first_rows}, unit)


def _number(raw: object, key: str) -> float:
    if not is_number(raw) or not abs(raw) <= HEAVIEST:
        raise Unusable(f"expected a plain number above zero, at most {HEAVIEST:g}", "Write weight = 2.0, for example", key, raw)
    return float(raw)


_ENDINGS = {"length": COLUMN_UNITS["coordinate"], "": ("",)} | COLUMN_UNITS
_TITLES = {f"{name}_{unit}".rstrip("_"): (name, unit) for name, kind in POINT_COLUMNS.items() for unit in _ENDINGS[kind]}


def read_csv_rows(raw: Mapping[str, Any], folder: Path) -> PointRows:
    """Read rows of a CSV file; unlike `csv_table.read_columns` it allows only known columns, and empty cells.

    Raises
    ------
    Unusable
    """
    table = read_csv(raw, folder, MOST_POINTS)
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
    columns = {
        column: np.array(values) * (factor(unit, POINT_COLUMNS[column]) if unit else 1.0) for column, unit, _, values in read
    }
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
        note = f"{rows.file} has {count_noun(number, 'point')}, fewer than the requested {requested_count}; all of them are used"
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
            turned = np.diff(columns["angle"])
            same &= np.isnan(turned) | (turned == 0.0)
        if same.any():
            row = int(np.argmax(same))
            in_list = rows.key is None or rows.numbers is not None
            remedy = "Remove one of them" if in_list else "Request another number of points, or check the curve"
            raise Unusable(f"{rows.named(row, row + 1)} coincide", remedy, f"[{row + 1}]" if rows.key is None else rows.key)
    if "angle" not in columns:
        _check_size(rows)
