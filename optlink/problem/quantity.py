"""Quantities and intervals of problem files, checked as they are read.

A quantity is fixed if it is one value ("500 mm"), a design variable if it is a range ("300..500 mm") or a table with bounds.
"""

from __future__ import annotations

import difflib
import functools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator

from optlink.errors import Fault, InputError, InvalidValue
from optlink.units import KINDS, UnitProblem, display_unit, factor, mistyped_range, parse, show

SIDES = ("min", "max", "exactly")
SHORTEST, LONGEST = 1e-9, 1e6  # m; beyond them squares of ratios overflow


class Unusable(InvalidValue):
    """An invalid value: the reason, a remedy, and the key below the present one."""


@contextmanager
def below(key: str) -> Iterator[None]:
    """Prefix a key to the one that an `Unusable` names."""
    try:
        yield
    except Unusable as error:
        error.key = f"{key}.{error.key}" if error.key else key
        raise


@contextmanager
def input_of(file: str | None, key: str | None = None, value: object = None) -> Iterator[None]:
    """Raise an `Unusable` as the error of a file or an option.

    Parameters
    ----------
    file : str or None
        Name of the file.
    key : str, optional
        Key or option. Default: the key and value of the `Unusable`.
    value : object, optional

    Raises
    ------
    InputError
        in place of an `Unusable`.
    """
    try:
        yield
    except Unusable as error:
        place = (error.key, error.value) if key is None else (key, value)
        raise InputError(Fault(error.message, error.remedy, file, *place)) from None


def nearest(key: str, known: Iterable[str]) -> str:
    """Return a remedy for an unknown name: the shortest that contain it, or else the closest one, and all known ones.

    Parameters
    ----------
    key : str
        The unknown name.
    known : iterable of str
    """
    names, quoted = list(known), '"{}"'.format
    inside = sorted((name for name in names if len(key) > 2 and key in name), key=len)
    close = inside or difflib.get_close_matches(key, names, n=1, cutoff=0.5)
    guess = f"Did you mean {' or '.join(map(quoted, close[:3]))}? " if close else ""
    return f"{guess}Known: {', '.join(quoted(name) if ',' in name else name for name in names)}"


@dataclass(frozen=True)
class Quantity:
    """A value [SI] with the unit of the file; a design variable between `low` and `high` if these are not None."""

    value: float
    kind: str
    unit: str
    low: float | None = None
    high: float | None = None

    @property
    def free(self) -> bool:
        """Whether the quantity is a design variable."""
        return self.low is not None

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound [SI]; both equal the value if it is fixed."""
        return (self.value, self.value) if self.low is None or self.high is None else (self.low, self.high)

    @property
    def display(self) -> tuple[float, str]:
        """Factor from SI to the display unit, and that unit."""
        return display_unit(self.kind)

    @property
    def si_per_unit(self) -> float:
        """The display unit [SI]."""
        unit = KINDS[self.kind].display
        return factor(unit, self.kind) if unit else 1.0

    def __str__(self) -> str:
        if not self.free:
            return show(self.value, self.kind, self.unit)
        low, high = (show(bound, self.kind, self.unit) for bound in self.bounds)
        return f"free, {low} ... {high}, start {show(self.value, self.kind, self.unit)}"


@dataclass(frozen=True)
class Interval:
    """Limits of a measure: at least `low`, at most `high` [SI]; None for an open side; both equal for a target value."""

    low: float | None
    high: float | None
    kind: str | None
    unit: str

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound [SI], infinite for an open side."""
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high

    def __str__(self) -> str:
        low, high = (None if bound is None else self.to_display(bound) for bound in (self.low, self.high))
        if low is None or high is None:
            return f"at least {low}" if high is None else f"at most {high}"
        return f"exactly {low}" if low == high else f"{low} ... {high}"

    def to_display(self, value: float) -> str:
        """Return the value in the interval's own unit."""
        return show(value, self.kind, self.unit) if self.kind else f"{value:.6g}"


@dataclass(frozen=True)
class JointRanges(Interval):
    """Limits of an angle at joints: the interval itself for every joint without its own, and `own` by the name of the joint."""

    own: tuple[tuple[str, Interval], ...] = ()

    @property
    def plain(self) -> bool:
        """Whether there are limits for the joints without their own."""
        return self.low is not None or self.high is not None

    def __str__(self) -> str:
        return "; ".join([*[super().__str__()] * self.plain, *(f"{interval} at {joint}" for joint, interval in self.own)])


STROKES = {"forward": "backward", "backward": "forward", "slow": "quick", "quick": "slow"}
"""Every name of a stroke, and that of the other stroke."""


@dataclass(frozen=True)
class StrokeRatio(Interval):
    """Limits of the duration of one stroke over that of the other: of `stroke`, or of the slow one if that is None."""

    stroke: str | None = None

    def __str__(self) -> str:
        return super().__str__() + (f", {self.strokes}" if self.stroke else "")

    @property
    def strokes(self) -> str:
        """Names of the two strokes, for display."""
        stroke = self.stroke or "slow"
        return f"{stroke} over {STROKES[stroke]}"


def check_time_ratio(stroke: str | None, value: float, key: str, low: float | None, high: float | None) -> None:
    """Refuse a limit that no time ratio can satisfy, and suggest the part of its range that one can.

    Parameters
    ----------
    stroke : "forward", "backward", "slow", "quick" or None
        Stroke whose time is divided by the other's; None is the slow one.
    value, low, high : float or None
        The limit, and the whole range.
    key : str
        Key of the limit, for errors; empty if both sides have one key.

    Raises
    ------
    Unusable
        with the key.
    """
    slow, quick = stroke in (None, "slow") and value < 1.0, stroke == "quick" and value > 1.0
    if slow or quick:
        words, side = ("at least as long as the quick", "more") if slow else ("at most as long as the slow", "less")
        remedy = f"Give 1 or {side}"
        if low is not None and high is not None and low < 1.0 < high:
            remedy = "Give 1" if key else f"Write [1, {high:g}]" if slow else f"Write [{low:g}, 1]"
        raise Unusable(f"the {stroke or 'slow'} stroke takes {words} one, so that the ratio is 1 or {side}", remedy, key, value)
    if value <= 0.0:
        raise Unusable("the time of a stroke is positive", "Give a ratio above 0", key, value)


def check_keys(raw: Iterable[object], known: Sequence[str]) -> None:
    """Refuse a table with an unknown key.

    Parameters
    ----------
    raw : mapping, or iterable of its keys
    known : sequence of str
        Permitted keys.

    Raises
    ------
    Unusable
        with the first unknown key.
    """
    for key in raw:
        if key not in known:
            raise Unusable("unknown key", nearest(str(key), known), str(key))


def _positive(value: float, text: object, kind: str, key: str = "") -> float:
    if kind == "length" and value <= 0.0:
        raise Unusable("a length must be positive", f'Give one above zero, for example "{KINDS[kind].example}"', key, text)
    if kind == "length" and not SHORTEST <= value <= LONGEST:
        raise Unusable("no linkage has such a length", "Give one between 1e-9 m and 1000 km, and check its unit", key, text)
    return value


def read_scalar(text: object, kind: str, key: str = "") -> tuple[float, str]:
    """Read one value; return its SI number and the unit as written.

    Parameters
    ----------
    text : object
        Value as read from the file.
    kind : str
        Physical kind.
    key : str
        Key of the value, for errors.

    Raises
    ------
    Unusable
        when the value cannot be read or is out of range.
    """
    try:
        value, unit = parse(text, kind)
    except UnitProblem as problem:
        raise Unusable(problem.message, problem.remedy, key, text) from None
    return _positive(value, text, kind, key), unit


def read_quantity(raw: object, kind: str) -> Quantity:
    """Read a fixed quantity or a design variable.

    Parameters
    ----------
    raw : object
        Value as read from the file.
    kind : str
        Physical kind.

    Raises
    ------
    Unusable
        when the value cannot be read, with the key below the present one.
    """
    if isinstance(raw, Quantity):
        return raw
    if not isinstance(raw, dict):
        value, unit = read_scalar(raw, kind)
        return Quantity(value, kind, unit)
    check_keys(raw, ("start", "bounds"))
    example = f"bounds = {range_example(kind)}"
    bounds = raw.get("bounds")
    if bounds is None:
        raise Unusable("a free quantity needs bounds", f"Add {example}, or give one value to fix it", "bounds")
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise Unusable("bounds are two values, lower and upper", f"Write {example}", "bounds", bounds)
    (low, low_unit), (high, _) = (read_scalar(bound, kind, "bounds") for bound in bounds)
    if low >= high:
        raise Unusable("the lower bound is not below the upper", "Exchange them, or give one value to fix it", "bounds", bounds)
    if "start" not in raw:
        return Quantity(0.5 * (low + high), kind, low_unit, low, high)
    start, unit = read_scalar(raw["start"], kind, "start")
    if not low <= start <= high:
        raise Unusable(
            "the start lies outside the bounds",
            f"Choose one from {show(low, kind, unit)} to {show(high, kind, unit)}",
            "start",
            raw["start"],
        )
    return Quantity(start, kind, unit, low, high)


def range_example(kind: str | None) -> str:
    """Return a valid range of a kind (None: plain numbers) in quotes, for remedies."""
    number, unit = KINDS[kind].example.split(" ", 1) if kind else ("1", "")
    return f'"{f"{number}..{2.0 * float(number):g} {unit}".strip()}"'


def _read_number(raw: object, key: str) -> float:
    if isinstance(raw, str) and (share := re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*%\s*", raw, re.ASCII)):
        raw = float(share.group(1)) / 100.0
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        remedy = "Write a number without a unit, for example 1.2"
        if isinstance(raw, str) and re.fullmatch(r"\s*[-+]?\d+,\d+\s*", raw):
            remedy = f"Write a decimal point, without quotes: {raw.strip().replace(',', '.')}"
        raise Unusable("expected a plain number", remedy, key, raw)
    number = float(raw) if abs(raw) < 1e308 else math.inf
    if not math.isfinite(number):
        raise Unusable("the number must be finite", "Write a finite number, for example 1.2", key, raw)
    return number


def _read_interval(raw: object, kind: str | None) -> Interval:
    if isinstance(raw, Interval):
        return raw

    def one(text: object, key: str = "") -> tuple[float, str]:
        return read_scalar(text, kind, key) if kind else (_read_number(text, key), "")

    example = range_example(kind)
    if isinstance(raw, str) and (meant := mistyped_range(raw)) is not None:
        raise Unusable("this is not a range", f'Write it with two dots: "{meant}"', "", raw)
    if isinstance(raw, dict):
        check_keys(raw, SIDES)
        if not raw:
            raise Unusable("the table is empty", f"Give min, max or both, or write {example}", "", raw)
        if "exactly" in raw and len(raw) > 1:
            raise Unusable("exactly leaves no room for min and max", "Give the one or the others", "exactly", raw["exactly"])
        exactly = one(raw["exactly"], "exactly") if "exactly" in raw else None
        low, high = (one(raw[key], key) if key in raw else exactly for key in SIDES[:2])
    elif isinstance(raw, list):
        if len(raw) != 2:
            raise Unusable("a range is two values, lower and upper", f"Write {example}", "", raw)
        low, high = one(raw[0]), one(raw[1])
    else:
        low = high = one(raw)
    if low and high and low[0] > high[0]:
        raise Unusable("the lower limit is above the upper", "Exchange them", "", raw)
    unit = (low or high or (0.0, ""))[1]
    return Interval(low[0] if low else None, high[0] if high else None, kind, unit)


def _read_stroke_ratio(raw: object, kind: None) -> StrokeRatio:
    if isinstance(raw, StrokeRatio):
        return raw
    stroke, sides = None, raw
    if isinstance(raw, dict):
        stroke, sides = raw.get("stroke"), {key: value for key, value in raw.items() if key != "stroke"}
        if stroke is not None and stroke not in list(STROKES):
            raise Unusable("unknown stroke", nearest(str(stroke), STROKES), "stroke", stroke)
        if stroke is not None and not sides:
            raise Unusable("the time ratio has no limit", "Add min, max or exactly", "", raw)
    found = _read_interval(sides, kind)
    for key, value in (("min", found.low), ("max", found.high)):
        if value is not None:
            written = "exactly" if isinstance(sides, dict) and "exactly" in sides else key
            check_time_ratio(stroke, value, written if isinstance(sides, dict) else "", found.low, found.high)
    return StrokeRatio(found.low, found.high, found.kind, found.unit, stroke)


def _read_joint_ranges(raw: object, kind: str) -> JointRanges:
    """Read a range for every joint, or a table with the ranges of single joints beside it."""
    return _joint_ranges(raw, kind, lambda one: _read_interval(one, kind))


def _read_joint_maxima(raw: object, kind: str) -> JointRanges:
    """Read a largest value for every joint, or a table with those of single joints."""

    def largest(one: object) -> Interval:
        if not isinstance(one, dict):
            value, unit = read_scalar(one, kind)
            return Interval(None, value, kind, unit)
        for key, value in one.items():
            if key != "max":
                raise Unusable("only its largest value is limited", f'Write max = "{KINDS[kind].example}"', key, value)
        return _read_interval(one, kind)

    return _joint_ranges(raw, kind, largest)


def _joint_ranges(raw: object, kind: str, read: Callable[[object], Interval]) -> JointRanges:
    if isinstance(raw, JointRanges):
        return raw
    named = {key: value for key, value in raw.items() if key not in SIDES} if isinstance(raw, dict) else {}
    sides = {key: raw[key] for key in raw if key in SIDES} if isinstance(raw, dict) else raw
    own = []
    for joint, value in named.items():
        with below(str(joint)):
            own.append((str(joint), read(value)))
    plain = read(sides) if sides or not named else Interval(None, None, kind, own[0][1].unit)
    return JointRanges(plain.low, plain.high, kind, plain.unit, tuple(own))


def read_fixed(raw: object, kind: str) -> Quantity:
    """Read a quantity that must be fixed.

    Parameters
    ----------
    raw : object
        Value as read from the file.
    kind : str
        Physical kind.

    Raises
    ------
    Unusable
        when it is a table, or cannot be read.
    """
    if isinstance(raw, dict):
        raise Unusable("this quantity cannot be free", f'Give one value, for example "{KINDS[kind].example}"', "", raw)
    return read_quantity(raw, kind)


def read_positive(raw: object, kind: str) -> Quantity:
    """Read a fixed quantity that must not be negative.

    Parameters
    ----------
    raw : object
        Value as read from the file.
    kind : str
        Physical kind.

    Raises
    ------
    Unusable
        when it is negative, or cannot be read.
    """
    quantity = read_fixed(raw, kind)
    if quantity.value < 0.0:
        raise Unusable(f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} is not negative", "Give zero or more", "", raw)
    return quantity


def _reader(function: Any, kind: str | None) -> BeforeValidator:
    return BeforeValidator(functools.partial(function, kind=kind))  # the key reference reads function and kind


Length = Annotated[Quantity, _reader(read_quantity, "length")]
Angle = Annotated[Quantity, _reader(read_quantity, "angle")]
FixedLength = Annotated[Quantity, _reader(read_fixed, "length")]
FixedAngle = Annotated[Quantity, _reader(read_fixed, "angle")]
Coordinate = Annotated[Quantity, _reader(read_quantity, "coordinate")]
CoordinateInterval = Annotated[Interval, _reader(_read_interval, "coordinate")]
LengthInterval = Annotated[Interval, _reader(_read_interval, "length")]
AngleInterval = Annotated[Interval, _reader(_read_interval, "angle")]
AnglesOfJoints = Annotated[JointRanges, _reader(_read_joint_ranges, "angle")]
LargestAnglesOfJoints = Annotated[JointRanges, _reader(_read_joint_maxima, "angle")]
NumberInterval = Annotated[Interval, _reader(_read_interval, None)]
RatioOfStrokes = Annotated[StrokeRatio, _reader(_read_stroke_ratio, None)]
Speed = Annotated[Quantity, _reader(read_fixed, "angular velocity")]
Duration = Annotated[Quantity, _reader(read_positive, "time")]
Velocity = Annotated[Quantity, _reader(read_positive, "velocity")]
Frequency = Annotated[Quantity, _reader(read_positive, "frequency")]
ContactStiffness = Annotated[Quantity, _reader(read_positive, "contact stiffness")]
Mass = Annotated[Quantity, _reader(read_positive, "mass")]
MassInterval = Annotated[Interval, _reader(_read_interval, "mass")]
StiffnessInterval = Annotated[Interval, _reader(_read_interval, "stiffness")]
Density = Annotated[Quantity, _reader(read_positive, "density")]
FixedForce = Annotated[Quantity, _reader(read_positive, "force")]
Stiffness = Annotated[Quantity, _reader(read_positive, "stiffness")]
Damping = Annotated[Quantity, _reader(read_positive, "damping")]
TorsionalStiffness = Annotated[Quantity, _reader(read_positive, "torsional stiffness")]
TorsionalDamping = Annotated[Quantity, _reader(read_positive, "torsional damping")]
Number = Annotated[float, BeforeValidator(lambda raw: _read_number(raw, ""))]
