"""Motion laws: the output over the crank angle as an expression in phi, phi0, psi0 (for a slide s0), or as a table."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from optlink.linkage.vector2d import TURN, Array, Value
from optlink.problem.quantity import Quantity, Unusable, below, check_keys, check_pair, is_number, read_scalar
from optlink.problem.targets.expression import Expression, LawError, parse
from optlink.problem.targets.target_points import COLUMN_UNITS, MAX_ROWS, read_columns, read_csv
from optlink.units import factor

# Function generation: y(x), where x is proportional to the crank angle and y to the output, each over its range.

KEYS = ("function", "x", "input", "output")
EXAMPLE = 'law = { function = "log10(x)", x = [1, 2], input = "60 deg", output = "60 deg" }'
GRID = 2001  # values of x at which y is evaluated to find its range


@dataclass(frozen=True)
class Function:
    """A function y(x) for `low` <= x <= `high`, generated in a crank rotation `input` [rad].

    The output moves by `output` [rad or m] from the least to the largest value of y. It is a law of the crank angle: prescribed
    output = psi0 + output * (y(x) - least y) / (largest y - least y), where psi0 is the output at the least y.
    """

    expression: Expression
    low: float
    high: float
    input: float
    output: float
    kind: str = "angle"  # of the output: or "coordinate"
    names: frozenset[str] = field(default=frozenset({"phi", "phi0", "psi0"}), repr=False)

    @property
    def text(self) -> str:
        """The function for display."""
        return f"y = {self.expression.text}, x = {self.low:g} ... {self.high:g}"

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Least and largest y, refined between the values of a grid."""
        x = np.linspace(self.low, self.high, GRID)
        y = np.asarray(self.expression({"x": x}) + 0.0 * x, dtype=float)
        values = []
        for sign in (1.0, -1.0):
            i = int(np.argmin(sign * y))
            near = np.linspace(x[max(i - 1, 0)], x[min(i + 1, GRID - 1)], GRID)
            values.append(sign * float(np.min(sign * np.asarray(self.expression({"x": near}) + 0.0 * near, dtype=float))))
        return values[0], values[1]

    def rise(self, offset: Value) -> Value:
        """Return the prescribed output [rad or m] above that of the least y at a crank rotation [rad]; elementwise."""
        least, largest = self.ends
        x = self.low + (self.high - self.low) / self.input * offset
        return (self.expression({"x": x}) - least) * (self.output / (largest - least))

    def __call__(self, values: Mapping[str, Value]) -> Value:
        """Return the prescribed output for phi, phi0 and psi0."""
        return values["psi0"] + self.rise(values["phi"] - values["phi0"])

    def hazards(self, values: Mapping[str, Value]) -> str | None:
        """Return the defect of the function along the range, or None; see `Expression.hazards`."""
        return self.expression.hazards({"x": self.low + (self.high - self.low) / self.input * (values["phi"] - values["phi0"])})


def read_function(raw: Mapping[str, Any], kind: str = "angle") -> Function:
    """Read a function from its table; the kind of the output is "angle" or "coordinate".

    Raises
    ------
    Unusable
        with the key of the cause.
    """
    check_keys(raw, KEYS)
    for key in KEYS:
        if key not in raw:
            raise Unusable("the function needs this key", f"Write {EXAMPLE}", key)
    if not isinstance(raw["function"], str):
        raise Unusable("a function is text", f"Write {EXAMPLE}", "function", raw["function"])
    with below("function", raw["function"]):
        expression = parse(raw["function"], ("x",))
    bounds = raw["x"]
    check_pair(bounds, "the range of x is a list of two numbers", 'Write x = [1, 2], or x = ["0 deg", "90 deg"]', "x")
    low, high = (_bound(bound, k) for k, bound in enumerate(bounds))
    if not low < high:
        raise Unusable("the range of x must rise", "Exchange its ends; a negative input turns the crank clockwise", "x", bounds)
    turned = read_scalar(raw["input"], "angle", "input")[0]
    if not 1e-6 <= abs(turned) <= 2.0 * math.pi * (1.0 + 1e-9):
        raise Unusable(
            "the crank rotation must not be zero or exceed one revolution", 'Write input = "60 deg"', "input", raw["input"]
        )
    output = read_scalar(raw["output"], kind, "output")[0]
    if output == 0.0:
        raise Unusable("the output range must not be zero", 'Write output = "60 deg"', "output", raw["output"])
    function = Function(expression, low, high, turned, output, kind)
    span = {"phi": turned * np.linspace(0.0, 1.0, GRID), "phi0": 0.0, "psi0": 0.0}
    worry = function.hazards(span)
    if worry:
        message = f"the function {worry} between x = {low:g} and {high:g}"
        raise Unusable(message, "Change the function or its range", "function", expression.text)
    least, largest = function.ends
    if not math.isfinite(largest - least) or largest - least <= 1e-12 * max(abs(least), abs(largest), 1e-300):
        raise Unusable("the function is constant there", "Choose a function that varies", "function", expression.text)
    return function


def _bound(raw: object, index: int) -> float:
    if isinstance(raw, str):
        try:
            return float(parse(raw, ())({}))
        except LawError:
            return read_scalar(raw, "angle", f"x[{index}]")[0]
    if not is_number(raw) or not math.isfinite(raw):
        raise Unusable("expected a plain number", "Write x = [1, 2]", f"x[{index}]", raw)
    return float(raw)


NAMES = ("phi", "phi0", "psi0")
SLIDE_NAMES = ("phi", "phi0", "s0")
SLIDE = 'law = { slide = "s0 + 40*(1 - cos(phi - phi0))", unit = "mm" }'
STARTS = np.array([[0.3, 1.9, -2.2], [-0.8, 2.5, 0.6]])  # phi0, psi0 [rad] at which a law is tested
SAME_ANGLE = 1e-12  # rad


@dataclass(frozen=True)
class Table:
    """Points (phi, psi) of a law: phi [rad] strictly monotone, psi the output [rad, or m for a slide].

    `from_start`: both are relative to the start position (phi - phi0, psi - psi0), else to the frame. `kind` of the output:
    "angle" or "coordinate".
    """

    phi: tuple[float, ...]
    psi: tuple[float, ...]
    from_start: bool
    kind: str = "angle"

    def __post_init__(self) -> None:
        if len(self.phi) != len(self.psi):
            message = f"phi has {len(self.phi)} values, psi has {len(self.psi)}"
            raise Unusable(message, "Give as many values of phi as of psi", "psi")
        if len(self.phi) < 2:
            raise Unusable("a table needs at least two rows", "Add rows, or give the law as an expression", "phi")
        steps = np.diff(self.phi)
        bad = np.flatnonzero((steps if self.phi[-1] > self.phi[0] else -steps) <= 0.0)
        if bad.size:
            row = int(bad[0]) + 2
            message = f"phi must rise (or fall) from row to row; row {row} does not"
            value = f"{math.degrees(self.phi[row - 1]):.6g} deg"
            raise Unusable(message, "Sort the rows by phi and remove repeated ones", "phi", value)

    @property
    def span(self) -> float:
        """Crank rotation [rad] from the start to the last row."""
        return self.phi[-1] if self.from_start else self.phi[-1] - self.phi[0]

    @property
    def offsets(self) -> Array:
        """Crank rotations of the rows from the start [rad]."""
        return np.asarray(self.phi) - (0.0 if self.from_start else self.phi[0])

    def at(self, offsets: Array) -> Array:
        """Return the prescribed output at crank rotations [rad] from the start, by monotone cubic interpolation."""
        rows, psi = self.offsets, np.asarray(self.psi)
        if len(offsets) == len(rows) and np.array_equal(offsets, rows):
            return psi
        from scipy.interpolate import PchipInterpolator

        order = np.argsort(rows)
        return np.asarray(PchipInterpolator(rows[order], psi[order])(offsets), dtype=float)


@dataclass(frozen=True)
class SlideExpression:
    """A slide [m] as an expression in phi, phi0 [rad] and s0; the expression and s0 are in a unit of `size` metres."""

    expression: Expression
    size: float
    unit: str
    kind: str = field(default="coordinate", repr=False)

    @property
    def text(self) -> str:
        """The expression with its unit, for display."""
        return f"{self.expression.text} [{self.unit}]"

    @property
    def names(self) -> frozenset[str]:
        """Names used, with s0 as psi0: the output at the start."""
        return frozenset("psi0" if name == "s0" else name for name in self.expression.names)

    def _variables(self, values: Mapping[str, Value]) -> dict[str, Value]:
        return {"phi": values["phi"], "phi0": values["phi0"], "s0": values["psi0"] / self.size}

    def __call__(self, values: Mapping[str, Value]) -> Value:
        """Return the prescribed slide [m] for phi, phi0 [rad] and psi0, the slide at the start [m]."""
        return self.expression(self._variables(values)) * self.size

    def hazards(self, values: Mapping[str, Value]) -> str | None:
        """Return the defect of the law along arrays of values, or None; see `Expression.hazards`."""
        return self.expression.hazards(self._variables(values))


Source = Expression | SlideExpression | Function | Table


def begins_at_psi0(law: Source) -> bool:
    """Return whether the law prescribes psi0 itself at the start, whatever phi0 and psi0 are."""
    if isinstance(law, Table):
        return law.from_start and law.phi[0] == 0.0 and law.psi[0] == 0.0
    phi0, psi0 = STARTS
    with np.errstate(all="ignore"):
        return not np.any(np.abs(law({"phi": phi0, "phi0": phi0, "psi0": psi0}) - psi0) > SAME_ANGLE)


def is_periodic(law: Source, name: str) -> bool:
    """Return whether values of the start angle phi0 or of psi0 that are a revolution apart prescribe the same output."""
    if not isinstance(law, Expression | SlideExpression):
        return True
    phi0, psi0 = STARTS
    values = {"phi": phi0 + 0.7, "phi0": phi0, "psi0": psi0}
    turned = values | ({"phi": phi0 + 0.7 + TURN, "phi0": phi0 + TURN} if name == "phi0" else {"psi0": psi0 + TURN})
    with np.errstate(all="ignore"):
        change = law(turned) - law(values) + 0.0 * phi0
    whole = TURN * np.round(change / TURN) if isinstance(law, Expression) else 0.0
    return bool(np.all(np.abs(change - whole) <= SAME_ANGLE))


def rotation(law: Source, span: Quantity | None) -> float:
    """Return the crank rotation of a law [rad], negative clockwise: that of a table or function, else the span of the file."""
    if isinstance(law, Table):
        return law.span
    if isinstance(law, Function):
        return law.input
    assert span is not None
    return span.value


def check_rotation(law: Source, span: Quantity | None, key: str, start: object, span_key: str = "span") -> None:
    """Refuse a span or a start that a law brings itself, and a span that is missing or out of range.

    `span` and `start` are those that the file states under `span_key` and `key` in the requirement.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    if isinstance(law, Function) and span is not None:
        raise Unusable("a function defines its own span, the input", "Leave span out", "requirement.span", str(span))
    if isinstance(law, Table):
        if span is not None and abs(span.value - law.span) > 1e-9:
            message = f"the span differs from that of the table, {math.degrees(law.span):.6g} deg"
            raise Unusable(message, "Leave span out: the table defines it", "requirement.span", str(span))
        if not law.from_start and start is not None:
            message = "a table measured from the frame defines its own start"
            raise Unusable(message, f"Leave {key} out", f"requirement.{key}", str(start))
    elif not isinstance(law, Function) and span is None:
        raise Unusable("a law given as an expression needs a span", 'Add span = "90 deg"', "requirement.span")
    turned = rotation(law, span)
    if not 1e-6 <= abs(turned) <= TURN * (1.0 + 1e-9):
        remedy = 'Give one such as "90 deg" (negative: clockwise)'
        value = f"{math.degrees(turned):.6g} deg"
        raise Unusable("the span must not be zero, nor exceed one revolution", remedy, f"requirement.{span_key}", value)


@dataclass(frozen=True, eq=False)
class Law:
    """The prescribed output at each design position.

    `offsets` (rows,) [rad]: crank rotation of each position from the start.
    """

    source: Source
    offsets: Array

    @cached_property
    def tabulated(self) -> Array:
        """Output of a table at each design position, before psi0 is added; zeros for an expression."""
        return self.source.at(self.offsets) if isinstance(self.source, Table) else np.zeros(len(self.offsets))

    def target(self, offset: Value, tabulated: Value, phi0: Value, psi0: Value) -> Value:
        """Return the prescribed output [rad or m] at a crank rotation `offset` from the start [rad]; elementwise.

        `tabulated`: `Law.tabulated` there; `phi0`, `psi0`: crank angle and output at the start.
        """
        if not isinstance(self.source, Table):
            return self.source({"phi": phi0 + offset, "phi0": phi0, "psi0": psi0})
        return tabulated + psi0 if self.source.from_start else tabulated

    def curve(self, offsets: Array, phi0: Value, psi0: Value) -> Array:
        """Return the prescribed output [rad or m] at crank rotations (n,) from the start [rad].

        `phi0` and `psi0`, crank angle and output at the start, are numbers, or arrays (designs, 1) for several designs.
        """
        tabulated = self.source.at(offsets) if isinstance(self.source, Table) else 0.0
        return np.asarray(self.target(offsets, tabulated, phi0, psi0) + 0.0 * offsets, dtype=float)


def read_law(raw: object, folder: Path) -> Expression | Function | Table:
    """Read a law from a problem file: an expression, a function, a table, or the CSV file of a table.

    Raises
    ------
    Unusable
        with the key below `law`.
    """
    if isinstance(raw, str):
        return parse(raw, NAMES)
    if isinstance(raw, dict) and "function" in raw:
        return read_function(raw)
    if isinstance(raw, dict):
        return _read_table(raw, folder)
    raise Unusable(
        "a law is an expression or a table",
        'Write "psi0 + 0.5*(phi - phi0)", or { phi = ["0 deg", ...], psi = ["0 deg", ...] }, or { csv = "law.csv" }, '
        'or { function = "log10(x)", x = [1, 2], input = "60 deg", output = "60 deg" }',
    )


def read_output_law(raw: object, folder: Path) -> Source:
    """Read the law of any output.

    In addition to the forms of `read_law`: { slide = "s0 + 40*(1 - cos(phi))", unit = "mm" }, a table of phi and s, or a function
    with the output of a slide.
    """
    if isinstance(raw, dict):
        if "function" in raw:
            try:
                return read_function(raw, "coordinate")
            except Unusable as error:
                if error.key != "output":
                    raise
        elif "slide" in raw:
            return _read_slide(raw)
        elif "s" in raw or _has_slide(raw, folder):
            return _read_table(raw, folder, "s")
    return read_law(raw, folder)


def _has_slide(raw: Mapping[str, Any], folder: Path) -> bool:
    """Return whether the CSV file of a table has a column of a slide; refuse one that has a column of an angle, too."""
    if "csv" not in raw or "phi" in raw or "psi" in raw:
        return False
    table = read_csv(raw, folder, MAX_ROWS)
    slides, angles = (
        [title for title in table.titles if title in {f"{name}_{unit}" for unit in COLUMN_UNITS[kind]}]
        for name, kind in (("s", "coordinate"), ("psi", "angle"))
    )
    if slides and angles:
        message = f"{table.name} has columns of two outputs, {slides[0]} and {angles[0]}"
        raise Unusable(message, "Keep the one that the law prescribes", "csv", table.name)
    return bool(slides)


def _read_slide(raw: Mapping[str, Any]) -> SlideExpression:
    check_keys(raw, ("slide", "unit"))
    if not isinstance(raw["slide"], str):
        raise Unusable("the law of a slide is text", f"Write {SLIDE}", "slide", raw["slide"])
    units = ("mm", "m", "cm", "in")
    if raw.get("unit") not in units:
        raise Unusable("the unit of the slide is missing or unknown", f"Write {SLIDE}", "unit", raw.get("unit"))
    with below("slide", raw["slide"]):
        return SlideExpression(parse(raw["slide"], SLIDE_NAMES), factor(raw["unit"], "coordinate"), raw["unit"])


def _read_table(raw: Mapping[str, Any], folder: Path, output: str = "psi") -> Table:
    kind = "angle" if output == "psi" else "coordinate"
    check_keys(raw, ("phi", output, "csv", "measured_from"))
    origin = raw.get("measured_from", "start")
    if origin not in ("start", "frame"):
        raise Unusable("unknown origin of the angles", 'Write "start" or "frame"', "measured_from", origin)
    if "csv" not in raw:
        phi, psi = _read_cells(raw.get("phi"), "phi", "angle"), _read_cells(raw.get(output), output, kind)
    elif "phi" in raw or output in raw:
        raise Unusable("the table is given twice", f"Give csv, or phi and {output}, not both", "csv", raw["csv"])
    else:
        phi, psi = read_columns(raw, folder, {"phi": "angle", output: kind}, ordered="either way")
    return Table(tuple(phi), tuple(psi), origin == "start", kind)


def _read_cells(column: object, name: str, kind: str) -> list[float]:
    if not isinstance(column, list) or not column:
        what, example = ("angles", '"0 deg", "15 deg"') if kind == "angle" else ("lengths", '"0 mm", "12 mm"')
        raise Unusable(f"the table of a law needs a list of {what} here", f"Write {name} = [{example}, ...]", name, column)
    if len(column) > MAX_ROWS:
        raise Unusable(f"the table has {len(column):,} rows, more than {MAX_ROWS:,}", "Reduce their number", name)
    return [read_scalar(cell, kind, f"{name}[{row}]")[0] for row, cell in enumerate(column)]
