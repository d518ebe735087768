"""Size of a force or torque: a quantity, an expression with its unit, or a table over crank angle, slide or crank speed."""

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from optlink.linkage.vector2d import TURN, Array, Value
from optlink.problem.quantity import Unusable, below, check_keys, read_scalar
from optlink.problem.targets.csv_table import read_columns
from optlink.problem.targets.expression import Expression, parse
from optlink.problem.targets.repetition import MOST_REVOLUTIONS, revolutions_of
from optlink.units import KINDS, factor, show
from optlink.unsupported import unsupported

OVER = {"phi": "angle", "s": "coordinate", "omega": "angular velocity"}
"""Independent variables of a table of forces: crank angle, slider position, crank speed."""
REPEATED = 1e-12  # share of a revolution by which a row that repeats the first one may miss it


@dataclass(frozen=True)
class Constant:
    """A constant value; `text` as written."""

    value: float
    text: str
    revolutions: ClassVar[int] = 1

    def __str__(self) -> str:
        return self.text

    def __call__(self, variables: Mapping[str, Value]) -> Value:
        """Return the value [SI]."""
        return self.value


@dataclass(frozen=True)
class Formula:
    """An expression in a unit of `size` SI."""

    expression: Expression
    unit: str
    size: float

    def __str__(self) -> str:
        return f"{self.expression.text} [{self.unit}]"

    def __call__(self, variables: Mapping[str, Value]) -> Value:
        """Return the value [SI]."""
        return self.expression(variables) * self.size

    @cached_property
    def revolutions(self) -> int | None:
        """Revolutions of the crank after which the value repeats, speeds and positions unchanged; None if it does not."""
        return revolutions_of(self.expression)

    @property
    def cornered(self) -> bool:
        """Whether the value may have a pole, a jump or a corner."""
        return bool(self.breakpoints({name: np.zeros(1) for name in self.expression.names}))

    def breakpoints(self, variables: Mapping[str, Value]) -> list[Value]:
        """Return quantities at whose zeros the value may have a pole, a jump or a corner, see `Expression.breakpoints`."""
        return self.expression.breakpoints(variables)


@dataclass(frozen=True)
class LoadTable:
    """A table over one variable with linear interpolation, constant beyond its ends.

    Over the crank angle it repeats after the least number of whole revolutions that hold its rows.
    """

    over: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    cornered: ClassVar[bool] = True

    def __str__(self) -> str:
        return f"a table over {self.over}, {len(self.at)} rows"

    def __call__(self, variables: Mapping[str, Value]) -> Value:
        """Return the value [SI]."""
        x, (at, values) = variables[self.over], self._rows
        if self.over == "phi":
            period = self.revolutions * TURN
            x = x - period * np.floor((x - at[0]) / period)
        if isinstance(x, float | int | np.ndarray | np.generic):
            return np.interp(np.asarray(x, dtype=float), at, values)
        slopes = np.concatenate([[0.0], np.diff(values) / np.diff(at), [0.0]])
        value: Value = float(values[0])
        for begin, change in zip(at.tolist(), np.diff(slopes).tolist(), strict=True):
            value = value + change * np.maximum(x - begin, 0.0)
        return value

    @property
    def revolutions(self) -> int:
        """Revolutions of the crank after which the values repeat."""
        turns = (self.at[-1] - self.at[0]) / TURN
        return max(1, math.ceil(turns * (1.0 - REPEATED))) if self.over == "phi" else 1

    @cached_property
    def _rows(self) -> tuple[Array, Array]:
        """The rows; over the crank angle those of whole revolutions, at whose end the value may jump to the first."""
        at, values = np.array(self.at), np.array(self.values)
        end = at[0] + self.revolutions * TURN
        if self.over == "phi" and at[-1] < end - TURN * REPEATED:
            return np.append(at, end), np.append(values, values[0])
        return at, values


Size = Constant | Formula | LoadTable


def read_size(raw: object, folder: Path, kind: str, names: Iterable[str]) -> Size:
    """Read a force or torque: a quantity, an expression with its unit, or a table over phi, s or omega.

    `names` are the variables of an expression; a table may run over those of them in `OVER`.

    Raises
    ------
    Unusable
    """
    if not isinstance(raw, dict):
        value, own_unit = read_scalar(raw, kind)
        return Constant(value, show(value, kind, own_unit, digits=12))
    if "expression" in raw:
        check_keys(raw, ("expression", "unit"))
        if not isinstance(raw["expression"], str):
            raise Unusable("an expression is text", 'Write expression = "1000 + 200*sin(phi)"', "expression", raw["expression"])
        with below("expression", raw["expression"]):
            expression = parse(raw["expression"], names)
            if not expression.constants_finite:
                raise Unusable("it has no finite value", "Correct the division by zero, or the root or logarithm of a constant")
        unit = raw.get("unit")
        if not isinstance(unit, str):
            raise Unusable("an expression gives a plain number", f'Add its unit: unit = "{KINDS[kind].display}"', "unit", unit)
        with below("unit", unit):
            return Formula(expression, unit, factor(unit, kind))
    over: Any = raw.get("over")
    variables = [name for name in names if name in OVER]
    if over in ("t", "time"):
        raise Unusable(*unsupported("load over time"), "over", over)
    if over not in variables:
        raise Unusable("the table has no independent variable", f"Write over = one of: {', '.join(variables)}", "over", over)
    check_keys(raw, ("over", "at", "values", "csv"))
    if "csv" in raw and ("at" in raw or "values" in raw):
        raise Unusable("the table is given twice", "Give csv, or at and values, not both", "csv", raw["csv"])
    if "csv" in raw:
        at, values = read_columns(raw, folder, {over: OVER[over], kind: kind}, ordered="rising")
    else:
        columns = []
        for key, of in (("at", OVER[over]), ("values", kind)):
            if not isinstance(raw.get(key), list):
                raise Unusable("the table needs a list here", f"Write {key} = [...], with units", key, raw.get(key))
            columns.append([read_scalar(cell, of, f"{key}[{row}]")[0] for row, cell in enumerate(raw[key])])
        at, values = columns
    if len(at) != len(values) or len(at) < 2:
        raise Unusable(f"at has {len(at)} values, values has {len(values)}", "Give as many, and two or more", "values")
    falls = next((row for row, (a, b) in enumerate(itertools.pairwise(at), start=2) if b <= a), None)
    if falls:
        raise Unusable(f"the rows must rise, and row {falls} does not", "Sort them and remove repeated ones", "at")
    table = LoadTable(over, tuple(at), tuple(values))
    if table.revolutions > MOST_REVOLUTIONS:
        message = f"the table is longer than {MOST_REVOLUTIONS} revolutions: {math.degrees(at[-1] - at[0]):.8g} deg"
        remedy = "A table is one cycle of the machine: give the rows after which the load repeats"
        raise Unusable(message, remedy, "csv" if "csv" in raw else "at")
    return table
