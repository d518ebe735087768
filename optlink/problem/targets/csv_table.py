"""CSV files: delimiter, title row, and the rows below it with their numbers in the file."""

import csv
import io
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from optlink.problem.quantity import Unusable, largest
from optlink.problem.targets.target_points import file_kind, read_file, shortened
from optlink.units import KINDS, factor, plain, read_number, respelled

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
    text = _text(data, name)
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


def _text(data: bytes, name: str) -> str:
    wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    if not wide and ((kind := file_kind(data)) or b"\0" in data):
        raise Unusable(f"{name} is not a CSV text file: it is {kind or 'UTF-16 without its mark, or no text'}", SAVE, "csv", name)
    try:
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        if wide:
            raise Unusable(f"{name} is not a CSV text file: it is damaged UTF-16", SAVE, "csv", name) from None
        return data.decode("latin-1")


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
