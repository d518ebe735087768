"""The law that the rocker shall follow: an expression in phi, phi0, psi0, or a table of points."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Value
from optlink.problem.quantity import Unusable, nearest, read_scalar
from optlink.problem.targets.expression import Expression, LawError, parse
from optlink.problem.targets.function import Function, read_function
from optlink.problem.targets.target_points import csv_text
from optlink.units import factor

Array = NDArray[np.float64]
NAMES = ("phi", "phi0", "psi0")
MAX_ROWS = 10_000


@dataclass(frozen=True)
class Table:
    """Points (phi, psi) [rad] of a law, phi strictly monotone.

    `from_start`: both angles are counted from the start position (phi - phi0, psi - psi0); else from the frame.
    """

    phi: tuple[float, ...]
    psi: tuple[float, ...]
    from_start: bool

    def __post_init__(self) -> None:
        if len(self.phi) != len(self.psi):
            raise Unusable(
                f"phi has {len(self.phi)} values, psi has {len(self.psi)}",
                "Give as many of the one as of the other",
                "psi",
            )
        if len(self.phi) < 2:
            raise Unusable("a table needs at least two rows", "Add rows, or give the law as an expression", "phi")
        steps = np.diff(self.phi)
        bad = np.flatnonzero(steps <= 0.0) if self.phi[-1] > self.phi[0] else np.flatnonzero(steps >= 0.0)
        if bad.size:
            row = int(bad[0]) + 2
            raise Unusable(
                f"phi must rise (or fall) from row to row; row {row} does not",
                "Sort the rows by phi and remove repeated ones",
                "phi",
                f"{math.degrees(self.phi[row - 1]):.6g} deg",
            )

    @property
    def span(self) -> float:
        """Crank rotation [rad] from the start to the last row."""
        return self.phi[-1] if self.from_start else self.phi[-1] - self.phi[0]

    def at(self, offsets: Array) -> Array:
        """Wanted angle [rad] at crank rotations [rad] from the start: monotone cubics between the rows."""
        rows = np.asarray(self.phi) - (0.0 if self.from_start else self.phi[0])
        psi = np.asarray(self.psi)
        if len(offsets) == len(rows) and np.array_equal(offsets, rows):
            return psi
        from scipy.interpolate import PchipInterpolator

        order = np.argsort(rows)
        return np.asarray(PchipInterpolator(rows[order], psi[order])(offsets), dtype=float)


@dataclass(frozen=True)
class Law:
    """What the rocker angle shall be at each design position.

    `offsets` (rows,) [rad]: crank rotation of each position from the start.
    """

    source: Expression | Function | Table
    offsets: Array

    @cached_property
    def tabulated(self) -> Array:
        """Angle [rad] that the table wants at each design position, before psi0 is added; zeros for an expression."""
        return self.source.at(self.offsets) if isinstance(self.source, Table) else np.zeros(len(self.offsets))

    def wanted(self, offset: Value, tabulated: Value, phi0: Value, psi0: Value) -> Value:
        """Wanted rocker angle [rad] at crank rotations `offset` from the start; elementwise."""
        if isinstance(self.source, Expression | Function):
            return self.source({"phi": phi0 + offset, "phi0": phi0, "psi0": psi0})
        return tabulated + psi0 if self.source.from_start else tabulated

    def curve(self, offsets: Array, phi0: float, psi0: float) -> Array:
        """Wanted rocker angle [rad] at any crank rotations [rad] from the start, for one design."""
        tabulated = self.source.at(offsets) if isinstance(self.source, Table) else 0.0
        return np.asarray(self.wanted(offsets, tabulated, phi0, psi0) + 0.0 * offsets, dtype=float)


def read_law(raw: object, folder: Path) -> Expression | Function | Table:
    """Read a law as a problem file states it: an expression, a table, or the CSV file of a table.

    Raises
    ------
    Unusable
        naming the key below `law` that is to blame.
    """
    if isinstance(raw, Expression | Function | Table):
        return raw
    if isinstance(raw, str):
        try:
            return parse(raw, NAMES)
        except LawError as error:
            raise Unusable(error.message, error.remedy) from None
    if isinstance(raw, dict) and "function" in raw:
        return read_function(raw)
    if isinstance(raw, dict):
        return _read_table(raw, folder)
    raise Unusable(
        "a law is an expression or a table",
        'Write "psi0 + 0.5*(phi - phi0)", or { phi = ["0 deg", ...], psi = ["0 deg", ...] }, or { csv = "law.csv" }, '
        'or { function = "log10(x)", x = [1, 2], input = "60 deg", output = "60 deg" }',
    )


def _read_table(raw: Mapping[str, Any], folder: Path) -> Table:
    known = ("phi", "psi", "csv", "measured_from")
    for key in raw:
        if key not in known:
            raise Unusable("unknown key", nearest(str(key), known), str(key))
    origin = raw.get("measured_from", "start")
    if origin not in ("start", "frame"):
        raise Unusable("unknown origin of the angles", 'Write "start" or "frame"', "measured_from", origin)
    if "csv" not in raw:
        phi, psi = (_read_angles(raw.get(name), name) for name in ("phi", "psi"))
    elif "phi" in raw or "psi" in raw:
        raise Unusable("the table is given twice", "Give csv, or phi and psi, not both", "csv", raw["csv"])
    else:
        phi, psi = read_columns(raw, folder, {"phi": "angle", "psi": "angle"})
    return Table(tuple(phi), tuple(psi), origin == "start")


def _read_angles(column: object, name: str) -> list[float]:
    if not isinstance(column, list) or not column:
        example = f'Write {name} = ["0 deg", "15 deg", ...]'
        raise Unusable("the table of a law needs a list of angles here", example, name, column)
    if len(column) > MAX_ROWS:
        raise Unusable(f"the table has {len(column):,} rows, more than {MAX_ROWS:,}", "Thin them out", name)
    return [read_scalar(cell, "angle", f"{name}[{row}]")[0] for row, cell in enumerate(column)]


def read_columns(raw: Mapping[str, Any], folder: Path, kinds: Mapping[str, str]) -> list[list[float]]:
    """Read columns of a CSV file whose header names them with their units: phi_deg, s_mm, force_N.

    Parameters
    ----------
    raw : mapping
        Its key csv names the file, relative to the folder. Devices, pipes and files that are too large are refused.
    folder : Path
    kinds : mapping of column name to the kind of its unit

    Returns
    -------
    lists in the order of `kinds` [SI]

    Raises
    ------
    Unusable
        naming the file, and the row where a row is at fault.
    """
    title, text = csv_text(raw, folder)
    try:
        rows = [row for row in csv.reader(io.StringIO(text, newline="")) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise Unusable(f"{title} is not a CSV text file: {error}", "Save it as CSV, UTF-8", "csv", title) from None
    header = [cell.strip() for cell in rows[0]] if rows else []
    return [_column(rows, header, name, kind, title) for name, kind in kinds.items()]


_UNITS = {
    "angle": {"deg": "deg", "rad": "rad"},
    "coordinate": {"mm": "mm", "m": "m"},
    "force": {"N": "N", "kN": "kN"},
    "torque": {"Nm": "N*m"},
    "angular velocity": {"rpm": "rpm", "rad_s": "rad/s"},
}  # as they may end the name of a column


def _column(rows: Sequence[Sequence[str]], header: list[str], name: str, kind: str, file: str) -> list[float]:
    titles = {f"{name}_{ending}": unit for ending, unit in _UNITS[kind].items()}
    title = next((title for title in header if title in titles), None)
    if title is None:
        raise Unusable(
            f"{file} has no column {' or '.join(titles)}",
            f"Name the columns in the first row, one of them {next(iter(titles))}",
            "csv",
        )
    if len(rows) - 1 > MAX_ROWS:
        raise Unusable(f"{file} has {len(rows) - 1:,} rows, more than {MAX_ROWS:,}", "Thin them out", "csv")
    index, size = header.index(title), factor(titles[title], kind)
    values = []
    for number, row in enumerate(rows[1:], start=2):
        try:
            value = float(row[index]) * size
        except (ValueError, IndexError):
            value = math.nan
        if not math.isfinite(value):
            found = row[index] if index < len(row) else "nothing"
            raise Unusable(
                f"row {number} of {file} has no finite number in column {title}",
                "Correct or remove the row",
                "csv",
                found,
            )
        values.append(value)
    return values
