"""Read the axes of a sweep: SI values, or texts such as "450..550 mm:101", a list of values, or steps of equal ratio."""

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.errors import InputError
from optlink.linkage.vector2d import all_finite
from optlink.problem.document import Source
from optlink.problem.file import WORDS, ProblemFile, check_plausible
from optlink.problem.quantity import file_key
from optlink.units import in_si, is_unit, plain, split

# Read and write values at keys of a problem file; the numbers of a file that can be changed by hand, with their ranges.

Raw = str | float | int

ANGLE = 45.0  # deg, half of the range of an angle that is not a design variable


def exact_text(value: float, unit: str) -> Raw:
    """Return a value with all its digits as written in a problem file."""
    if unit:
        return f"{float(value)!r} {unit}"
    return int(value) if float(value).is_integer() and abs(value) < 1e15 else value


def read_figure(raw: Any) -> tuple[float, str]:
    """Return a value and its unit; 0 and no unit for anything else."""
    if isinstance(raw, int | float) and not isinstance(raw, bool):
        return float(raw), ""
    parts = split(raw) if isinstance(raw, str) else None
    return parts if parts is not None and is_unit(parts[1]) else (0.0, "")


@dataclass(frozen=True)
class Knob:
    """A number at a key of the problem file: its name, and its value and range in a unit."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    key: str


def knobs(problem: ProblemFile) -> tuple[Knob, ...]:
    """Return the adjustable numbers of a problem file that are not design variables: fixed dimensions and limits."""
    return (*_dimensions(problem), *_limits(problem))


def _dimensions(problem: ProblemFile) -> Iterator[Knob]:
    """Yield the fixed dimensions, from half to one and a half times their values."""
    largest = max((abs(q.value) for q in problem.model.mechanism.quantities.values() if q.in_metres), default=1.0)
    for name, quantity in problem.model.mechanism.quantities.items():
        if not quantity.fixed:
            continue
        value, unit = quantity.value / quantity.si_per_unit, quantity.display[1]
        size = largest / quantity.si_per_unit if quantity.kind == "coordinate" else abs(value)
        room = ANGLE if quantity.kind == "angle" else 0.5 * size
        yield Knob(name, value, value - room, value + room, unit, file_key(problem.raw["mechanism"], name))


def _limits(problem: ProblemFile) -> Iterator[Knob]:
    """Yield the numbers of the limits of the file, from half to one and a half times their values."""
    for name, raw in (problem.raw.get("limits") or {}).items():
        pair = zip(("min", "max"), raw, strict=True) if isinstance(raw, list) else [("", raw)]
        for side, text in raw.items() if isinstance(raw, dict) else pair:
            value, unit = read_figure(text)
            if side not in ("", "min", "max", "exactly") or not (value or unit == "deg"):
                continue
            words = f"{name} {side}".rstrip().replace("_", " ")
            low, high = sorted((0.5 * value, 1.5 * value))
            if unit == "deg":
                low, high = max(0.0, value - ANGLE), min(180.0, value + ANGLE)
            yield Knob(words, value, low, high, unit, f"limits.{name}.{side}".rstrip("."))


MAX_POINTS = 10_000_000
ROW_BYTES, POINTS_PER_SECOND = 160, 5000  # for the error message on too many points
EXAMPLE = 'Write LOW..HIGH UNIT:N, for example "450..550 mm:101", or a list: "450 mm, 500 mm"'
VARY = "--vary"
WITH_KEY = f'Give for example {VARY} mechanism.frame="450..550 mm:101"'

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(
    rf"\s*({_NUMBER})\s*((?:1\s*/)?[^\s\d.:,][^.:,]*?)?\s*(?:\.\.\.(?=\s)|\.\.)\s*({_NUMBER})\s*((?:1\s*/)?[^\s\d.:,][^:,]*?)?\s*"
    rf"(?::\s*([-+]?\d+)\s*(log)?|step\s+({_NUMBER}))\s*"
)
_ONE = re.compile(rf"\s*({_NUMBER})\s*((?:1\s*/)?[^\s\d,:][^,:]*?)?\s*")
_ENDLESS = re.compile(r"(?<![\w/*^])[-+]?(?:nan|inf|infinity)(?![\w/*^])", re.IGNORECASE)


def column_name(name: str, unit: str) -> str:
    """Return the name of a table column of a quantity with a unit: its values are in SI."""
    unit = in_si(unit)[1]
    return f"{name}_{unit.replace('/', '_per_').replace('*', '').replace('^', '')}" if unit else name


@dataclass(frozen=True)
class Axis:
    """One parameter of a sweep and its values, in `unit` as written (empty for a plain number)."""

    shown: ClassVar[Mapping[str, Source]] = {
        **{name: name for name in ("key", "unit")},
        "first": lambda axis: axis.values[0],
        "last": lambda axis: axis.values[-1],
        "values": lambda axis: len(axis.values),
    }

    key: str
    unit: str
    values: tuple[float, ...]

    @property
    def column(self) -> str:
        """Name of its column in the table."""
        return column_name(self.key, self.unit)

    @property
    def si_per_unit(self) -> float:
        """Its unit [SI]."""
        return in_si(self.unit)[0]

    @cached_property
    def si(self) -> NDArray[np.float64]:
        """The values [SI], the same for a grid in any unit: without the last digit, which is that of the conversion."""
        return np.array([_rounded(value * self.si_per_unit) for value in self.values])

    @cached_property
    def array(self) -> NDArray[np.float64]:
        """The values as an array."""
        return np.array(self.values)

    def raw(self, index: int) -> Raw:
        """Return a value as written in a problem file."""
        return exact_text(self.values[index], self.unit)


def axis_of(problem: ProblemFile, key: str, given: ArrayLike, unit: str, option: str = VARY) -> Axis:
    """Return the axis of a key from values in SI, from a text, or from a list of texts.

    `unit` is that of the quantity in the file: values in SI are stated in it, so that a grid is the same however it is given.
    Whole numbers remain without it, and the file refuses them; see `ProblemFile.override`.
    """
    values = np.asarray(given)
    if values.dtype.kind == "U":
        texts = values.ravel().tolist()
        if unit and values.ndim and not all(read_figure(text)[1] for text in texts):
            raise InputError("a text without a unit", EXAMPLE, key=f"{option} {key}", value=given)
        return read_axis(key, ", ".join(texts))
    if values.ndim > 1 or not values.size or values.dtype.kind not in "iuf" or not all_finite(values):
        remedy = "Give SI values, for example np.linspace(0.45, 0.55, 11)"
        raise InputError("not a list of finite numbers", remedy, problem.file, f"{option} {key}", given)
    if values.dtype.kind != "f" and unit:
        return Axis(key, "", tuple(map(float, values.ravel())))
    size, si_unit = in_si(unit)
    check_plausible(problem.raw, values, si_unit, problem.file, f"{option} {key}")
    return Axis(key, unit, tuple(_rounded(value / size) for value in values.ravel().tolist()))


def read_axis(key: str, text: str) -> Axis:
    """Return the axis of a key from a text."""
    values = plain(text).strip().strip("\"'").strip()

    def fault(message: str, remedy: str = EXAMPLE) -> InputError:
        return InputError(message, remedy, key=f"{VARY} {key}", value=values or None)

    if not values:
        raise fault("no values")
    if _ENDLESS.search(values):
        raise fault("the values must be finite numbers")
    match = _RANGE.fullmatch(values)
    if match is None:
        if ".." in values:
            raise fault("this is not a range with a number of points")
        return _value_list(key, values, fault)
    low, low_unit, high, high_unit, count, spacing, step = match.groups()
    unit = (high_unit or low_unit or "").strip()
    if low_unit and high_unit and low_unit.strip() != high_unit.strip():
        raise fault("the two ends have different units", "Write both ends in one unit")
    a, b = float(low), float(high)
    if not (math.isfinite(a) and math.isfinite(b)):
        raise fault("the ends must be finite")
    if a >= b:
        raise fault(
            "the range is empty" if a == b else "the range is empty: its ends are in the wrong order", "Give LOW below HIGH"
        )
    if step is not None:
        size = float(step)
        if not size > 0.0:
            raise fault("the step is zero or negative: the range would never end", "Give a step above zero")
        ratio = (b - a) / size * (1.0 + 1e-12)
        if ratio < 1.0:
            raise fault("the step is longer than the range", "Give a shorter step, or one value with --set")
        if ratio >= MAX_POINTS:  # including infinity
            raise fault(
                f"the step is too small: the number of points exceeds the limit of a sweep, {MAX_POINTS:,}", "Give a longer step"
            )
        steps = math.floor(ratio)
        return Axis(key, unit, tuple(_rounded(a + size * i) for i in range(steps + 1)))
    number = int(count) if len(count) < 20 else int(min(max(float(count), -1.0), 1e18))  # int refuses thousands of digits
    if number < 2:
        raise fault(f"{number} points do not make a range", "Give at least 2 points, or one value with --set")
    if number > MAX_POINTS:
        raise fault(f"{number:,} points exceed the limit of a sweep, {MAX_POINTS:,}", "Give fewer points")
    if spacing:
        if a <= 0.0:
            raise fault("equal ratios need ends above zero", "Leave log out, or begin above zero")
        inner = tuple(a * (b / a) ** (i / (number - 1)) for i in range(1, number - 1))
    else:
        inner = tuple(a + (b - a) * i / (number - 1) for i in range(1, number - 1))
    if not all(map(math.isfinite, inner)):
        raise fault("the range exceeds the largest number", "Give ends that are nearer to each other")
    return Axis(key, unit, (a, *map(_rounded, inner), b))


def _rounded(value: float) -> float:
    """Return a value within a range without rounding errors of the division: 1.4 instead of 1.4000000000000001."""
    return float(f"{value:.15g}")


def _value_list(key: str, values: str, fault: Callable[..., InputError]) -> Axis:
    parts = [_ONE.fullmatch(part) for part in values.split(",")]
    groups = [match.groups() for match in parts if match is not None]
    if not any(map(str.isdigit, values)):
        remedy = "Run it once for each word, with --set and another --out"
        raise fault("this is not a list of numbers; a sweep does not vary words", remedy)
    if len(groups) != len(parts):
        raise fault("this is not a list of values")
    units = {(unit or "").strip() for _, unit in groups}
    unit = max(units, key=len)
    if len(units - {""}) > 1:
        raise fault("the values have different units", "Write all values in one unit")
    numbers = tuple(float(number) for number, _ in groups)
    if not all(map(math.isfinite, numbers)):
        raise fault("the values must be finite numbers")
    if len(set(numbers)) != len(numbers):
        raise fault("a value is listed twice", "List every value once")
    return Axis(key, unit, numbers)


@dataclass(frozen=True)
class Grid:
    """All combinations of the values of the axes; the last axis varies fastest."""

    axes: tuple[Axis, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of every axis."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def count(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    @property
    def row(self) -> int:
        """Number of values of the last axis."""
        return self.shape[-1]

    def place(self, index: int) -> tuple[int, ...]:
        """Return the index of a point along every axis."""
        return tuple(map(int, np.unravel_index(index, self.shape)))

    def values(self, index: int) -> list[float]:
        """Return the values at a point, in the units of the axes."""
        return [axis.values[i] for axis, i in zip(self.axes, self.place(index), strict=True)]

    def columns(self, points: NDArray[np.intp]) -> list[NDArray[np.float64]]:
        """Return the values (points,) of every axis at points, in the units of the axes."""
        places = np.unravel_index(points, self.shape)
        return [axis.array[place] for axis, place in zip(self.axes, places, strict=True)]

    def in_si(self, points: ArrayLike) -> list[NDArray[np.float64]]:
        """Return the values (points,) of every axis at points [SI]."""
        places = np.unravel_index(np.asarray(points), self.shape)
        return [axis.si[place] for axis, place in zip(self.axes, places, strict=True)]

    def changes(self, index: int) -> dict[str, Raw]:
        """Return the changes of the problem file at a point."""
        return {axis.key: axis.raw(i) for axis, i in zip(self.axes, self.place(index), strict=True)}


@contextlib.contextmanager
def _of_axis(axis: Axis) -> Iterator[None]:
    """Attribute errors to --vary instead of the file."""
    try:
        yield
    except InputError as error:
        first = error.faults[0]
        raise InputError(replace(first, key=f"{VARY} {first.key or axis.key}")) from None


def assigned(assignments: Iterable[str]) -> dict[str, str]:
    """Return values by key from texts `KEY=VALUES`, as they stand on the command line."""
    values: dict[str, str] = {}
    for assignment in assignments:
        key, equals, text = (part.strip() for part in assignment.partition("="))
        if not equals or not key or not text:
            raise InputError("expected KEY=VALUES", WITH_KEY, key=VARY, value=assignment)
        if key in values:
            raise InputError("varied twice", "Give every key once", key=f"{VARY} {key}")
        values[key] = text
    return values


def read_grid(problem: ProblemFile, vary: Sequence[str] | Mapping[str, ArrayLike]) -> Grid:
    """Read the axes of a sweep, and check them against the problem."""
    if not vary:
        raise InputError("no parameter is varied", WITH_KEY, key=VARY)
    axes = vary if isinstance(vary, Mapping) else assigned(vary)
    grid = Grid(tuple(axis_of(problem, key, values, problem.unit_at(key)) for key, values in axes.items()))
    if grid.count > MAX_POINTS:
        days, size = grid.count / POINTS_PER_SECOND / 86400.0, grid.count * ROW_BYTES / 1e9
        shape = " x ".join(f"{size:,}" for size in grid.shape)
        raise InputError(
            f"{shape} = {grid.count:,} points exceed the limit of a sweep, {MAX_POINTS:,}: "
            f"about {days:z,.0f} days on one core and {size:z,.0f} GB",
            "Give fewer points, or vary fewer parameters at a time",
            problem.file,
            VARY,
        )
    for axis in grid.axes:  # one by one, so that the error names the axis
        section = axis.key.partition(".")[0]
        if section in (*WORDS, "rounding") or (section == "tolerances" and problem.at("requirement.robust") is None):
            remedy = 'Vary a quantity, for example mechanism.frame="450..550 mm:101"'
            raise InputError("no result depends on this key", remedy, problem.file, f"{VARY} {axis.key}")
        for at in {axis.values.index(end) for end in (min(axis.values), max(axis.values))}:
            with _of_axis(axis):
                problem.override({axis.key: axis.raw(at)})
    for corner in sorted({0, grid.count - 1}):  # the first and the last values of all axes
        problem.override(grid.changes(corner))
    return grid
