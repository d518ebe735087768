"""Quantities of problem files, checked as they are read.

A quantity is fixed if it is one value ("500 mm"), a design variable if it is a range ("300..500 mm") or a table with bounds, and
linked if it equals an expression of others ({ equals = "0.5*coupler + 3 mm" }).
"""

import functools
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, TypeGuard

from pydantic import AfterValidator, BeforeValidator

from optlink.errors import InputError, InvalidValue, nearest as nearest
from optlink.units import KINDS, display_unit, factor, parse, show, with_article

SHORTEST, LONGEST = 1e-9, 1e6  # m; beyond them squares of ratios overflow
LARGEST, LARGEST_ANGLE = 1e30, 1e6  # in SI: products of several larger ones overflow, and sines of larger angles lose digits


Unusable = InvalidValue
"""An invalid value: the reason, a remedy, and the key below the present one."""


@contextmanager
def below(key: str, value: object = None) -> Iterator[None]:
    """Prefix a key to the one that an `Unusable` names, which has this value if it names none."""
    try:
        yield
    except Unusable as error:
        error.key = f"{key}.{error.key}" if key and error.key else key or error.key
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
        if kind == "length" and value <= 0.0:
            raise Unusable("a length must be positive", f'Give one above zero, for example "{KINDS[kind].example}"')
        if kind == "length" and not SHORTEST <= value <= LONGEST:
            raise Unusable("no linkage has such a length", "Give one between 1e-9 m and 1000 km, and check its unit")
        if abs(value) > largest(kind):
            remedy = f'Give at most {largest(kind):.0e} {KINDS[kind].si}, for example "{KINDS[kind].example}", and check its unit'
            raise Unusable("the value is too large", remedy)
    return value, unit


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
    number, unit = KINDS[kind].example.split(" ", 1) if kind else ("1", "")
    return f'"{f"{number}..{2.0 * float(number):g} {unit}".strip()}"'


def read_number(raw: object, key: str) -> float:
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
Number = Annotated[float, BeforeValidator(lambda raw: read_number(raw, ""))]
Friction = Annotated[
    Number, where(lambda value: 0.0 <= value < 10.0, "out of range", "A coefficient of friction lies between 0 and 10")
]
