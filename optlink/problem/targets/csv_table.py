"""CSV files: delimiter, title row, and the rows below it with their numbers in the file."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optlink.problem.quantity import Unusable
from optlink.problem.targets.target_points import read_file, shortened
from optlink.units import read_number

DECIMALS = "decimals have a point"


@dataclass(frozen=True)
class CsvTable:
    """A CSV file: `name` for display, `titles` of its columns; `rows`, read once: number in the file and cells."""

    name: str
    titles: Sequence[str]
    rows: Iterator[tuple[int, list[str]]]

    def number(self, row: int, cells: Sequence[str], index: int, remedy: str = f"Correct or remove the row; {DECIMALS}") -> float:
        """Return the number in a cell.

        Parameters
        ----------
        row : int
            Number of the row in the file.
        cells : sequence of str
        index : int
            Of the column.
        remedy : str

        Raises
        ------
        Unusable
            If the cell is missing or contains no finite number.
        """
        cell = cells[index] if index < len(cells) else ""
        value = read_number(cell)
        if math.isnan(value) and re.fullmatch(r"\s*[-+]?[\d.]*\d,\d+\s*", cell):
            message = f"row {row} of {self.name} has a decimal comma in column {self.titles[index]}"
            raise Unusable(message, "Replace the decimal commas of the file by points", "csv", shortened(cell))
        if math.isnan(value):
            message = f"row {row} of {self.name} has no finite number in column {self.titles[index]}"
            raise Unusable(message, remedy, "csv", shortened(cell) or "nothing")
        return value


def read_csv(raw: Mapping[str, Any], folder: Path, most: int) -> CsvTable:
    """Read a CSV file with a title row; its delimiter is a comma, or a semicolon or tab of the title row.

    Parameters
    ----------
    raw : mapping
        Its key csv names the file. Devices, pipes and files that are too large are refused.
    folder : Path
        Folder to which the name is relative.
    most : int
        Largest number of rows below the title row.

    Raises
    ------
    Unusable
        If the file cannot be read or is not UTF-8; on reading its rows, if there are too many or one has more cells than titles.
    """
    name, data = read_file(raw, "csv", folder)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Unusable(f"{name} is not a CSV text file: {error.reason}", "Save it as CSV, UTF-8", "csv", name) from None
    separator_line = re.match(r"sep=([;,\t])[;,\t\s]*?\r?\n", text, re.IGNORECASE)  # Excel's own first line
    text = text[separator_line.end() :] if separator_line else text
    first = text[:10_000].lstrip().partition("\n")[0]
    delimiter = next((sign for sign in ";\t" if sign in first and "," not in first), ",")
    rows = _filled(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter), name, 2 if separator_line else 1)
    titles = [cell.strip() for cell in next(rows, (0, []))[1]]
    while titles and not titles[-1]:
        titles.pop()
    return CsvTable(name, titles, _checked(rows, name, len(titles), most))


def _filled(reader: Iterator[list[str]], name: str, first: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows that are not empty."""
    try:
        yield from ((number, cells) for number, cells in enumerate(reader, start=first) if "".join(cells).strip())
    except csv.Error as error:
        raise Unusable(f"{name} is not a CSV text file: {error}", "Save it as CSV, UTF-8", "csv", name) from None


def _checked(rows: Iterator[tuple[int, list[str]]], name: str, width: int, most: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows; a decimal comma that splits a number in two is refused by the number of cells."""
    for count, (number, cells) in enumerate(rows):
        if count == most:
            raise Unusable(f"{name} has more than {most:,} rows", "Reduce their number", "csv", name)
        if len(cells) > width and "".join(cells[width:]).strip():
            message = f"row {number} of {name} has {len(cells)} cells, the title row has {width}"
            raise Unusable(message, f"Correct the row; {DECIMALS}", "csv", shortened(cells[width]))
        yield number, cells
