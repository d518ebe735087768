"""Quantities of problem files, checked as they are read.

A quantity is fixed if it is one value ("500 mm"), a design variable if it is a range ("300..500 mm") or a table with bounds, and
linked if it equals an expression of others ({ equals = "0.5*coupler + 3 mm" }).
"""

import functools
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, TypeGuard

from pydantic import AfterValidator, BeforeValidator

from optlink.errors import InputError, InvalidValue, nearest as nearest
from optlink.io import keeping, without
from optlink.linkage.fourbar import LENGTHS
from optlink.units import KINDS, display_unit, factor, mistyped_range, parse, show, with_article

SHORTEST, LONGEST = 1e-9, 1e6  # m; beyond them squares of ratios overflow
LEAST_RATIO = 1e-4
LARGEST, LARGEST_ANGLE = 1e30, 1e6  # in SI: products of several larger ones overflow, and sines of larger angles lose digits


Unusable = InvalidValue
"""An invalid value: the reason, a remedy, and the key below the present one."""


@contextmanager
def below(key: str, value: object = None) -> Iterator[None]:
    """Prefix a key to the one that an `Unusable` names, which has this value if it names none."""
    try:
        yield
    except Unusable as error:
        dot = "." if key and error.key and not error.key.startswith("[") else ""
        error.key = f"{key}{dot}{error.key}"
        error.value = value if error.value is None else error.value
        raise


@contextmanager
def input_of(file: str | None, key: str | None = None, value: object = None) -> Iterator[None]:
    """Raise an `Unusable` as the error of a file or an option, whose key and value default to those of the `Unusable`.

    Raises
    ------
    InputError
    """
    try:
        yield
    except Unusable as error:
        place = (error.key, error.value) if key is None else (key, value)
        raise InputError(error.message, error.remedy, file, *place) from None


@dataclass(frozen=True)
class Quantity:
    """A value [SI] with the unit of the file; a design variable between `low` and `high` if these are not None.

    A linked quantity `equals` an expression of others, see `optlink.problem.linked`; its value is that at their start.
    """

    value: float
    kind: str
    unit: str
    low: float | None = None
    high: float | None = None
    equals: str | None = None

    @property
    def free(self) -> bool:
        """Whether the quantity is a design variable."""
        return self.low is not None and self.equals is None

    @property
    def fixed(self) -> bool:
        """Whether the quantity has one value, independent of all others."""
        return self.low is None and self.equals is None

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound [SI]; both equal the value if it is fixed."""
        if self.low is not None and self.high is not None:
            return self.low, self.high
        if self.equals is not None:
            return (0.0 if self.kind == "length" else -math.inf), math.inf
        return self.value, self.value

    @property
    def in_metres(self) -> bool:
        """Whether it is a length or a coordinate."""
        return self.kind in ("length", "coordinate")

    @property
    def begun(self) -> bool:
        """Whether a design variable starts elsewhere than in the middle of its bounds, the default."""
        low, high = self.bounds
        return self.free and abs(self.value - 0.5 * (low + high)) > 1e-12 * (high - low)

    @property
    def status(self) -> str:
        """Origin of the value, for tables: "fixed", "= crank" if linked, else "free"."""
        return "fixed" if self.fixed else "free" if self.equals is None else f"= {self.equals}"

    @property
    def display(self) -> tuple[float, str]:
        """Factor from SI to the display unit, and that unit."""
        return display_unit(self.kind)

    @property
    def si_per_unit(self) -> float:
        """The display unit [SI]."""
        return factor(KINDS[self.kind].display, self.kind)

    def __str__(self) -> str:
        if self.kind not in KINDS:  # a word in place of a quantity
            return self.kind
        value = show(self.value, self.kind, self.unit)
        if self.low is None:
            return value if self.equals is None else f"{self.status}, {value}"
        low, high = (show(bound, self.kind, self.unit) for bound in self.bounds)
        return f"{self.status}, {low} ... {high}, {'start ' if self.free else ''}{value}"


def check_keys(raw: Iterable[object], allowed: Sequence[str]) -> None:
    """Refuse a table with an unknown key.

    Raises
    ------
    Unusable
    """
    for key in raw:
        if key not in allowed:
            raise Unusable("unknown key", nearest(str(key), allowed), str(key))


def check_name(name: object, allowed: Iterable[str], message: str, key: str = "", value: object = None) -> None:
    """Refuse a name that is not one of the known ones, with the nearest of them; the value in the error defaults to the name.

    Raises
    ------
    Unusable
    """
    names = list(allowed)
    if name not in names:
        raise Unusable(message, nearest(str(name), names), key, name if value is None else value)


def check_choice(key: str, name: str, choices: Iterable[str], message: str, file: str | None = None) -> None:
    """Refuse the name that an option or argument `key` has if it is not one of the known ones."""
    with input_of(file, key, name):
        check_name(name, choices, message)


def check_range(key: str, value: float, low: float, high: float) -> None:
    """Refuse an option outside its range.

    Raises
    ------
    InputError
    """
    if not low <= value <= high:
        raise InputError("out of range", f"Give a number from {low:,} to {high:,}", key=key, value=value)


def largest(kind: str) -> float:
    """Return the largest value [SI] of a physical kind that is read."""
    return LARGEST_ANGLE if kind == "angle" else LARGEST


def is_number(raw: object) -> TypeGuard[int | float]:
    """Return whether a value of a file is a plain number, which a logical value is not."""
    return isinstance(raw, int | float) and not isinstance(raw, bool)


def check_pair(raw: object, message: str, remedy: str, key: str = "") -> Sequence[Any]:
    """Return a list of two values; refuse any other.

    Raises
    ------
    Unusable
    """
    if not isinstance(raw, list | tuple) or len(raw) != 2:
        raise Unusable(message, remedy, key, raw)
    return raw


def read_scalar(text: object, kind: str, key: str = "") -> tuple[float, str]:
    """Read one value; return its SI number and the unit as written.

    Raises
    ------
    Unusable
    """
    with below(key, text):
        value, unit = parse(text, kind)
        check_scalar(value, kind)
    return value, unit


def check_scalar(value: float, kind: str) -> None:
    """Refuse a value [SI] that no quantity of its kind has.

    Raises
    ------
    Unusable
    """
    if not math.isfinite(value):
        raise Unusable("not a finite number", "Give one in SI units")
    if kind == "length" and value <= 0.0:
        raise Unusable("a length must be positive", f'Give one above zero, for example "{KINDS[kind].example}"')
    if kind == "length" and not SHORTEST <= value <= LONGEST:
        raise Unusable("no linkage has such a length", "Give one between 1e-9 m and 1000 km, and check its unit")
    if kind == "ratio" and not LEAST_RATIO <= abs(value) <= 1.0 / LEAST_RATIO:
        raise Unusable("out of range", "Give a ratio from 0.0001 to 10000, negative for opposite senses")
    if abs(value) > largest(kind):
        remedy = f'Give at most {largest(kind):.0e} {KINDS[kind].si}, for example "{KINDS[kind].example}", and check its unit'
        raise Unusable("the value is too large", remedy)


def read_quantity(raw: object, kind: str) -> Quantity:
    """Read a fixed quantity, a design variable or a linked quantity (without its value); errors have the key below this one.

    Raises
    ------
    Unusable
    """
    if isinstance(raw, Quantity):
        return raw
    if isinstance(raw, list) or (isinstance(raw, str) and raw.strip().lower() == "free"):
        stated = isinstance(raw, list) and len(raw) == 2 and all(isinstance(end, str) for end in raw)
        ends = json.dumps(raw, ensure_ascii=False) if stated else range_example(kind)
        remedy = f'Write {{ bounds = {ends} }} for a design variable, or one value, for example "{KINDS[kind].example}"'
        raise Unusable(f"this is not {with_article(kind)}", remedy, "", raw)
    if not isinstance(raw, dict):
        value, unit = read_scalar(raw, kind)
        return Quantity(value, kind, unit)
    check_keys(raw, ("start", "bounds", "equals"))
    example = f"bounds = {range_example(kind)}"
    bounds = raw.get("bounds")
    equals = _read_link(raw, kind) if "equals" in raw else None
    if bounds is None:
        if equals is not None:
            return Quantity(math.nan, kind, KINDS[kind].display, equals=equals)
        raise Unusable("a free quantity needs bounds", f"Add {example}, or give one value to fix it", "bounds")
    check_pair(bounds, "bounds are two values, lower and upper", f"Write {example}", "bounds")
    (low, low_unit), (high, _) = (read_scalar(bound, kind, "bounds") for bound in bounds)
    if low == high:
        raise Unusable("both bounds are the same", f'Give one value to fix it: "{bounds[0]}"', "bounds", bounds)
    if low > high:
        raise Unusable("the lower bound is not below the upper", "Exchange them, or give one value to fix it", "bounds", bounds)
    if equals is not None:
        return Quantity(math.nan, kind, low_unit, low, high, equals)
    if "start" not in raw:
        return Quantity(0.5 * (low + high), kind, low_unit, low, high)
    start, unit = read_scalar(raw["start"], kind, "start")
    within = min(max(start, low), high)
    if not math.isclose(start, within, rel_tol=1e-14):  # rounding: "208 mm" is an ulp above "0.208 m"
        remedy = f"Choose one from {show(low, kind, unit)} to {show(high, kind, unit)}"
        raise Unusable("the start lies outside the bounds", remedy, "start", raw["start"])
    return Quantity(within, kind, unit, low, high)


def _read_link(raw: dict[str, Any], kind: str) -> str:
    """Return the expression that a quantity equals."""
    equals, example = raw["equals"], "180 deg - start" if kind == "angle" else "0.5*coupler + 3 mm"
    if not isinstance(equals, str) or not equals.strip():
        raise Unusable("a link is an expression in quotes", f'Write equals = "{example}"', "equals", equals)
    if "start" in raw:
        raise Unusable("a linked quantity has no start: it follows from others", "Leave start out", "start", raw["start"])
    return " ".join(equals.split())


def range_example(kind: str | None) -> str:
    """Return a valid range of a kind (None: plain numbers) in quotes, for remedies."""
    number, _, unit = KINDS[kind].example.partition(" ") if kind else ("1", "", "")
    return f'"{f"{number}..{2.0 * float(number):g} {unit}".strip()}"'


def read_number(raw: object, key: str = "") -> float:
    """Read a plain number, or a share in percent.

    Raises
    ------
    Unusable
    """
    if isinstance(raw, str) and (share := re.fullmatch(r"\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+))\s*%\s*", raw, re.ASCII)):
        raw = float(share.group(1)) / 100.0
    if not is_number(raw):
        remedy = "Write a number without a unit, for example 1.2"
        if isinstance(raw, str) and re.fullmatch(r"\s*[-+]?\d+,\d+\s*", raw):
            remedy = f"Write a decimal point, without quotes: {raw.strip().replace(',', '.')}"
        raise Unusable("expected a plain number", remedy, key, raw)
    number = float(raw) if abs(raw) < 1e308 else math.inf
    if not math.isfinite(number):
        raise Unusable("the number must be finite", "Write a finite number, for example 1.2", key, raw)
    return number


def read_fixed(raw: object, kind: str) -> Quantity:
    """Read a quantity that must be fixed.

    Raises
    ------
    Unusable
    """
    if isinstance(raw, dict):
        way = "linked to others" if "equals" in raw else "free"
        raise Unusable(f"this quantity cannot be {way}", f'Give one value, for example "{KINDS[kind].example}"', "", raw)
    if isinstance(raw, Quantity):
        return raw
    value, unit = read_scalar(raw, kind)
    return Quantity(value, kind, unit)


def read_positive(raw: object, kind: str) -> Quantity:
    """Read a fixed quantity that must not be negative.

    Raises
    ------
    Unusable
    """
    quantity = read_fixed(raw, kind)
    if quantity.value < 0.0:
        raise Unusable(f"{with_article(kind)} must not be negative", "Give zero or more", "", raw)
    return quantity


def reader(function: Any, kind: str | None) -> BeforeValidator:
    """Return a function of (raw value, kind) as the annotation of a field of one physical kind; None for plain numbers."""
    return BeforeValidator(functools.partial(function, kind=kind))  # the key reference reads function and kind


def where(condition: Callable[[Any], bool], message: str, remedy: str) -> AfterValidator:
    """Return a condition on the number of a field [SI], or on any other value of it, as an annotation of the field."""

    def check(value: Any) -> Any:
        if not condition(value.value if isinstance(value, Quantity) else value):
            raise Unusable(message, remedy)
        return value

    return AfterValidator(check)


Length = Annotated[Quantity, reader(read_quantity, "length")]
Angle = Annotated[Quantity, reader(read_quantity, "angle")]
FixedLength = Annotated[Quantity, reader(read_fixed, "length")]
FixedAngle = Annotated[Quantity, reader(read_fixed, "angle")]
Coordinate = Annotated[Quantity, reader(read_quantity, "coordinate")]
Ratio = Annotated[Quantity, reader(read_quantity, "ratio")]
Speed = Annotated[Quantity, reader(read_fixed, "angular velocity")]
Duration = Annotated[Quantity, reader(read_positive, "time")]
Velocity = Annotated[Quantity, reader(read_positive, "velocity")]
Frequency = Annotated[Quantity, reader(read_positive, "frequency")]
ContactStiffness = Annotated[Quantity, reader(read_positive, "contact stiffness")]
Mass = Annotated[Quantity, reader(read_positive, "mass")]
Density = Annotated[Quantity, reader(read_positive, "density")]
FixedForce = Annotated[Quantity, reader(read_positive, "force")]
Stiffness = Annotated[Quantity, reader(read_positive, "stiffness")]
Damping = Annotated[Quantity, reader(read_positive, "damping")]
TorsionalStiffness = Annotated[Quantity, reader(read_positive, "torsional stiffness")]
TorsionalDamping = Annotated[Quantity, reader(read_positive, "torsional damping")]
Number = Annotated[float, BeforeValidator(read_number)]
Friction = Annotated[
    Number, where(lambda value: 0.0 <= value < 10.0, "out of range", "A coefficient of friction lies between 0 and 10")
]


# Intervals of problem files: limits of a measure, of the angles at joints, of the time ratio of the strokes.

SIDES = ("min", "max", "exactly")


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
    """Refuse a limit `value` that no time ratio can satisfy, and suggest the part of its range, `low` to `high`, that one can.

    `stroke` is the one whose time is divided by the other's, None the slow one; `key` is empty if both sides have one key.

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
        raise Unusable("the ratio of two stroke times must be positive", "Give a ratio above 0", key, value)


def read_figure(raw: object, kind: str | None, key: str = "") -> tuple[float, str]:
    """Read a value of a physical kind, or a plain number if there is no kind; return its SI number and the unit as written."""
    return read_scalar(raw, kind, key) if kind else (read_number(raw, key), "")


def read_interval(raw: object, kind: str | None) -> Interval:
    """Read a range: two values, one for both, or a table of `min`, `max` or `exactly`.

    Raises
    ------
    Unusable
    """
    example = range_example(kind)
    if isinstance(raw, str) and (suggestion := mistyped_range(raw)) is not None:
        raise Unusable("this is not a range", f'Write it with two dots: "{suggestion}"', "", raw)
    if isinstance(raw, dict):
        check_keys(raw, SIDES)
        if not raw:
            raise Unusable("the table is empty", f"Give min, max or both, or write {example}", "", raw)
        if "exactly" in raw and len(raw) > 1:
            message = "exactly and min or max are given together"
            raise Unusable(message, "Give either exactly, or min and max", "exactly", raw["exactly"])
        exactly = read_figure(raw["exactly"], kind, "exactly") if "exactly" in raw else None
        low, high = (read_figure(raw[key], kind, key) if key in raw else exactly for key in SIDES[:2])
    elif isinstance(raw, list):
        ends = check_pair(raw, "a range is two values, lower and upper", f"Write {example}")
        low, high = (read_figure(end, kind) for end in ends)
    else:
        low = high = read_figure(raw, kind)
    if low and high and low[0] > high[0]:
        raise Unusable("the lower limit is above the upper", "Exchange them", "", raw)
    unit = (low or high or (0.0, ""))[1]
    return Interval(low[0] if low else None, high[0] if high else None, kind, unit)


def _read_stroke_ratio(raw: object, kind: None) -> StrokeRatio:
    stroke, sides = None, raw
    if isinstance(raw, dict):
        stroke, sides = raw.get("stroke"), without(raw, "stroke")
        if stroke is not None:
            check_name(stroke, STROKES, "unknown stroke", "stroke")
            if not sides:
                raise Unusable("the time ratio has no limit", "Add min, max or exactly", "", raw)
    interval = read_interval(sides, kind)
    for key, value in (("min", interval.low), ("max", interval.high)):
        if value is not None:
            written = "exactly" if isinstance(sides, dict) and "exactly" in sides else key
            check_time_ratio(stroke, value, written if isinstance(sides, dict) else "", interval.low, interval.high)
    return StrokeRatio(interval.low, interval.high, interval.kind, interval.unit, stroke)


def _read_joint_ranges(raw: object, kind: str) -> JointRanges:
    """Read a range for every joint, or a table with the ranges of single joints beside it."""
    return _joint_ranges(raw, kind, read_interval)


def _read_joint_maxima(raw: object, kind: str) -> JointRanges:
    """Read a largest value for every joint, or a table with those of single joints."""

    return _joint_ranges(raw, kind, _read_largest)


def _read_largest(raw: object, kind: str) -> Interval:
    if not isinstance(raw, dict):
        value, unit = read_scalar(raw, kind)
        return Interval(None, value, kind, unit)
    for key, value in raw.items():
        if key != "max":
            raise Unusable("only its largest value is limited", f'Write max = "{KINDS[kind].example}"', key, value)
    return read_interval(raw, kind)


def _joint_ranges(raw: object, kind: str, read: Callable[[object, str], Interval]) -> JointRanges:
    by_joint: dict[Any, Any] = {}
    sides = raw
    if isinstance(raw, dict):
        by_joint = without(raw, *SIDES)
        sides = keeping(raw, *SIDES)
    entries = []
    for joint, value in by_joint.items():
        with below(str(joint)):
            entries.append((str(joint), read(value, kind)))
    plain = read(sides, kind) if sides or not by_joint else Interval(None, None, kind, entries[0][1].unit)
    return JointRanges(plain.low, plain.high, kind, plain.unit, tuple(entries))


CoordinateInterval = Annotated[Interval, reader(read_interval, "coordinate")]
LengthInterval = Annotated[Interval, reader(read_interval, "length")]
AngleInterval = Annotated[Interval, reader(read_interval, "angle")]
AnglesOfJoints = Annotated[JointRanges, reader(_read_joint_ranges, "angle")]
LargestAnglesOfJoints = Annotated[JointRanges, reader(_read_joint_maxima, "angle")]
NumberInterval = Annotated[Interval, reader(read_interval, None)]
RatioOfStrokes = Annotated[StrokeRatio, reader(_read_stroke_ratio, None)]
MassInterval = Annotated[Interval, reader(read_interval, "mass")]
StiffnessInterval = Annotated[Interval, reader(read_interval, "stiffness")]


# Keys of the quantities of a problem in its file: of "link2.P.along" it is `mechanism.links.link2.points.P.along`.


DIMENSIONS: dict[str, tuple[str, ...]] = {
    "cylinders": ("closed", "open"),
    "slots": ("direction",),
    "guides": ("direction", "offset", "tilt"),
    "gears": ("ratio", "phase"),
    "racks": ("radius", "phase"),
    "belts": ("diameters", "radii", "phase"),
    "cams": ("base_radius", "roller", "lift", "phase"),
}
"""Dimensions of the entries of each table of [mechanism]: of an entry NAME they are the quantities NAME.closed, NAME.open."""
BOTH = ("first", "second")
"""Names of the two of a list, as in NAME.diameters.first."""


def write(mechanism: dict[str, Any], name: str, value: object) -> None:
    """Write one quantity into the section [mechanism] at its place.

    Parameters
    ----------
    mechanism : dict
        Section [mechanism] as nested tables, modified in place.
    name : str
        Name of the quantity.
    value : object
        New value as in a TOML file.
    """
    table, key = place_of(mechanism, name)
    table[key] = value


def place_of(mechanism: dict[str, Any], name: str) -> tuple[Any, str | int]:
    """Return the table or list of the section [mechanism] that contains a quantity, and its key or index there.

    Parameters
    ----------
    mechanism : dict
        Section [mechanism] as nested tables; a pivot that is not stated is added.
    name : str
        Name of the quantity.
    """
    *steps, last = key_path(mechanism, name)
    if steps == ["pivot"]:
        mechanism["pivot"] = list(mechanism.get("pivot") or ["0 mm", "0 mm"])
    table: Any = mechanism
    for step in steps:
        table = table[step]
    return table, last


def key_path(mechanism: Mapping[str, Any], name: str) -> list[str | int]:
    """Return the path of a quantity in the section [mechanism]: keys, and the index of a coordinate.

    Parameters
    ----------
    mechanism : mapping
        Section [mechanism] as nested tables.
    name : str
        Name of the quantity.
    """
    parts = name.split(".")
    if "links" not in mechanism:  # four-bar
        if name in (*LENGTHS, "direction"):
            return [name]
        if parts[0] == "A":
            return ["pivot", "xy".index(parts[1])]
        return ["points", parts[0], ("along", "across").index(parts[1])]
    for table, keys in DIMENSIONS.items():
        if parts[1] in keys and states(mechanism.get(table, {}).get(parts[0]), parts[1]):
            return [table, *parts[:2], *(BOTH.index(which) for which in parts[2:])]
    if len(parts) == 3:
        return ["links", parts[0], "points", parts[1], ("along", "across").index(parts[2])]
    if parts[1] == "length":
        return ["links", parts[0], "length"]
    if parts[0] in mechanism["ground"]:
        return ["ground", parts[0], "xy".index(parts[1])]
    return ["guides", parts[0], "through", "xy".index(parts[1])]


def states(entry: Any, key: str) -> bool:
    """Return whether an entry of a table, as in a file or as a section, states a key."""
    return entry is not None and key in getattr(entry, "model_fields_set", entry)


def file_key(mechanism: Mapping[str, Any], name: str) -> str:
    """Return the dotted key of a quantity in the problem file.

    Parameters
    ----------
    mechanism : mapping
        Section [mechanism] as nested tables.
    name : str
        Name of the quantity.
    """
    steps = key_path(mechanism, name)
    if isinstance(steps[-1], int):
        steps[-1] = name.rpartition(".")[2]
    return ".".join(("mechanism", *map(str, steps)))


def quantity_key(problem: Any, name: str) -> str:
    """Return the dotted key of a quantity of a problem in its file.

    Parameters
    ----------
    problem : Problem
    name : str
        Name of the quantity.
    """
    if name.startswith("tolerances."):
        return name
    for part in getattr(problem, "parts", ()):
        if part.prefix and name.startswith(part.prefix):
            return str(part.key) + quantity_key(part, name.removeprefix(part.prefix)).removeprefix("requirement")
    if name in ("phi0", "psi0", "start", "mark", "zero"):
        return f"requirement.{problem.requirement.key_of(problem, name)}"
    return file_key(vars(problem.mechanism), name)
