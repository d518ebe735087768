"""Conversion of quantities such as "412 mm", "64 rpm" or "45 deg" to SI values, and formatting in display units.

A closed table of units, in the definition syntax of pint (the tests compare every factor with pint), read by a small
evaluator: a unit is a product of powers. Importing pint takes longer than most designs do.
"""

from __future__ import annotations

import contextlib
import datetime
import decimal
import functools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from optlink.errors import OPTIONS_NAMED, InvalidValue

DEFINITIONS = (
    "meter = [length] = m = metre",
    "second = [time] = s = sec",
    "kilogram = [mass] = kg = kgs",
    "radian = [angle] = rad",
    "millimeter = 1e-3 m = mm = millimetre",
    "centimeter = 1e-2 m = cm = centimetre",
    "decimeter = 1e-1 m = dm",
    "micrometer = 1e-6 m = um = micrometre",
    "kilometer = 1e3 m = km",
    "inch = 0.0254 m = in = inches",
    "foot = 0.3048 m = ft = feet",
    "degree = 0.017453292519943295 rad = deg",
    "milliradian = 1e-3 rad = mrad",
    "arcminute = 0.0002908882086657216 rad = arcmin",
    "turn = 6.283185307179586 rad = rev = revolution",
    "rpm = 0.10471975511965977 rad / s",
    "millisecond = 1e-3 s = ms",
    "minute = 60 s = min",
    "hour = 3600 s",
    "hertz = 6.283185307179586 rad / s = Hz = hz",
    "gram = 1e-3 kg = g",
    "tonne = 1e3 kg = t",
    "pound = 0.45359237 kg = lb = lbs",
    "newton = kg * m / s ** 2 = N",
    "kilonewton = 1e3 N = kN",
    "pound_force = 4.4482216152605 N = lbf",
    "joule = N * m = J",
    "watt = J / s = W",
    "kilowatt = 1e3 W = kW",
    "pascal = N / m ** 2 = Pa",
    "kilopascal = 1e3 Pa = kPa",
    "megapascal = 1e6 Pa = MPa",
    "bar = 1e5 Pa",
    "gigapascal = 1e9 Pa = GPa",
)


@dataclass(frozen=True)
class Kind:
    """A physical quantity: its SI unit, its default display unit, and a valid example."""

    name: str
    si: str
    display: str
    example: str


KINDS = {
    kind.name: kind
    for kind in (
        Kind("length", "m", "mm", "100 mm"),
        Kind("coordinate", "m", "mm", "100 mm"),
        Kind("angle", "rad", "deg", "45 deg"),
        Kind("ratio", "", "", "0.5"),
        Kind("angular velocity", "rad/s", "rpm", "64 rpm"),
        Kind("angular acceleration", "rad/s**2", "rad/s^2", "40 rad/s^2"),
        Kind("time", "s", "s", "2 s"),
        Kind("mass", "kg", "kg", "1.2 kg"),
        Kind("density", "kg/m**3", "kg/m^3", "7850 kg/m^3"),
        Kind("force", "N", "N", "1000 N"),
        Kind("torque", "N*m", "N*m", "5 N*m"),
        Kind("energy", "J", "J", "100 J"),
        Kind("power", "W", "W", "500 W"),
        Kind("moment of inertia", "kg*m**2", "kg*m^2", "0.016 kg*m^2"),
        Kind("acceleration", "m/s**2", "m/s^2", "9.81 m/s^2"),
        Kind("stiffness", "N/m", "N/m", "500 N/m"),
        Kind("damping", "N*s/m", "N*s/m", "20 N*s/m"),
        Kind("velocity", "m/s", "m/s", "0.01 m/s"),
        Kind("pressure", "Pa", "GPa", "207 GPa"),
        Kind("volume", "m**3", "cm^3", "50 cm^3"),
        Kind("contact stiffness", "N/m**1.5", "N/m^1.5", "6.6e+10 N/m^1.5"),
        Kind("frequency", "rad/s", "Hz", "300 Hz"),
        Kind("torsional stiffness", "N*m/rad", "N*m/rad", "5 N*m/rad"),
        Kind("torsional damping", "N*m*s/rad", "N*m*s/rad", "0.1 N*m*s/rad"),
    )
}

_SIMPLE = r"[-+]?(?:\d+(?:[.,]\d+)?|\.\d+)(?:[eE][-+]?\d{1,4})?"  # in a range, where a dot may belong to ".."
_AFTER = r"(1\s*/.*?|[^\s\d.<=>].*?)"  # a unit, beside a number
# texts, compiled at their first use: most files need none of them
_RANGE = rf"(?as)\s*({_SIMPLE})\s*{_AFTER}?\s*(?:\.\.\.(?=\s)|\.\.(?!\.))\s*({_SIMPLE})\s*{_AFTER}?\s*"
_TOLERANCE = rf"(?as)\s*({_SIMPLE})\s*{_AFTER}?\s*\+(?:-|/-)\s*({_SIMPLE})\s*(%|[^\s\d.<=>].*?)?\s*"
_ONE_SIDED = rf"(?as)\s*([<>])=?\s*({_SIMPLE})\s*{_AFTER}?\s*"
_HYPHEN = r"(?s)(.*\d\s*[a-z]*)\s*(?:(?<!\d[eE])-|\bto\b)\s*(\d.*)"
_COMMA = r"(?as)([-+]?)(\d+),(\d+)\s*([^\d.].*)?"
_GROUPS = r"(?as)([-+]?\d{1,3}(?:[ ,._'\u2019]\d{3})+)(?:[.,](\d+))?\s*(\D.*)?"
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,4})?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(1\s*/.*?|[^\s\d].*?)?\s*", re.DOTALL | re.ASCII)
_PLAIN_NUMBER = re.compile(rf"\s*{_NUMBER}\s*", re.ASCII)
_POWER = r"(?:\s*(?:\^|\*\*)\s*(-?[1-4](?:\.5)?)|([2-4]))?"  # "m^2", "m**2", "m2"
_FACTOR = rf"(\s*[*/]\s*|\s+|-|)([A-Za-z_]++){_POWER}"  # "kg m^2" and "N-m" are products; a name is never cut into several
_UNIT = re.compile(re.sub(r"\((?!\?)", "(?:", rf"(1\s*(?=/))?{_FACTOR}({_FACTOR}){{0,4}}"))
_COMPACT = re.compile(r"(N|kN|lbf|kg|g)(m|cm|mm|in|ft|s)")  # "Nm", "kgm^2"
_PLAIN = str.maketrans(
    {"\u00a0": " ", "\u2007": " ", "\u2009": " ", "\u202f": " "}  # spaces that do not break
    | dict.fromkeys("\u2010\u2011\u2013\u2212", "-")
    | dict.fromkeys("\u00b7\u22c5\u2219\u00d7", "*")
    | dict.fromkeys("\u00b5\u03bc", "u")
    | dict.fromkeys("\u00b0\u00ba", "deg")
    | {"\u2026": " ... ", "\u2264": "<=", "\u2265": ">=", "\u00b1": "+-"}
)
_SUPERSCRIPTS = str.maketrans("\u207b\u00b9\u00b2\u00b3\u2074", "-1234")
_PER_TIME = {"angular velocity": {"1/s": "rad/s", "1/min": "rpm"}, "frequency": {"1/s": "Hz", "1/min": "rpm"}}


class UnitProblem(InvalidValue):
    """A quantity that cannot be parsed: `message` gives the reason, `remedy` the correction."""


@dataclass(frozen=True)
class _Unit:
    """A unit: its SI value, the exponents of length, time, mass and angle, and its spelling in messages and documents."""

    scale: float
    powers: tuple[float, ...]
    symbol: str


@functools.cache
def _table() -> dict[str, _Unit]:
    """Return the units of `DEFINITIONS` by each of their names."""
    table: dict[str, _Unit] = {}
    bases = 0
    for definition in DEFINITIONS:
        name, meaning, *aliases = definition.split(" = ")
        if meaning.startswith("["):
            scale, powers = 1.0, tuple(float(place == bases) for place in range(4))
            bases += 1
        else:
            number, product = re.fullmatch(rf"({_NUMBER})?\s*(.+)", meaning).groups()  # type: ignore[union-attr]
            unit = _product(_factors(product, table))
            scale, powers = float(number or 1.0) * unit.scale, unit.powers
        names = (name, *aliases)
        table |= dict.fromkeys(names, _Unit(scale, powers, (aliases or names)[0]))
    return table


def _find(name: str, table: dict[str, _Unit]) -> tuple[_Unit, ...]:
    """Return the unit of a name, or the two of a compact product such as "Nm"; raise KeyError for an unknown name."""
    compact = _COMPACT.fullmatch(name)
    if name not in table and compact:
        return tuple(table[part] for part in compact.groups())
    lower = name.lower()
    names = [name]
    if name == lower and len(name) > 2:
        names.append(name.removesuffix("s"))  # a plural
    if (len(name) > 3 and lower != "mrad") or lower in _ANY_CASE:  # no prefix that depends on the case, as in "mN"
        names += [lower, lower.removesuffix("s")]
    return (table[next((known for known in names if known in table), name)],)


_ANY_CASE = ("rpm", "deg", "rad", "rev", "min", "sec", "kg", "lb", "lbf", "in", "ft", "hz")


def _factors(text: str, table: dict[str, _Unit]) -> Iterator[tuple[_Unit, float]]:
    """Yield the units of a product, each with its exponent."""
    for separator, name, power, digit in re.findall(_FACTOR, text):
        *units, last = _find(name, table)
        sign = -1.0 if "/" in separator else 1.0
        for unit in units:
            yield unit, sign
        yield last, sign * float(power or digit or 1)


def _product(factors: Iterator[tuple[_Unit, float]]) -> _Unit:
    exponents: dict[_Unit, float] = {}
    for unit, exponent in factors:
        exponents[unit] = exponents.get(unit, 0.0) + exponent
    scale, powers = 1.0, [0.0] * 4
    above: list[str] = []
    below: list[str] = []
    for unit, exponent in exponents.items():
        scale *= unit.scale**exponent
        powers = [power + exponent * unit_power for power, unit_power in zip(powers, unit.powers, strict=True)]
        if exponent:
            size = abs(exponent)
            (above if exponent > 0.0 else below).append(unit.symbol + (f"^{size:g}" if size != 1.0 else ""))
    return _Unit(scale, tuple(powers), "/".join(["*".join(above) or "1", *below]))


def plain(text: str) -> str:
    """Replace typographic signs: superscripts, degree and micro signs, dots of products, minus signs, fixed spaces."""
    if text.isascii():
        return text
    text = text.translate(_PLAIN)
    return re.sub("[\u207b\u00b9\u00b2\u00b3\u2074]+", lambda found: "^" + found[0].translate(_SUPERSCRIPTS), text)


@functools.lru_cache(maxsize=512)
def _unit(unit: str, kind: str) -> _Unit:
    expected_kind = KINDS[kind]
    if not expected_kind.si and not unit:
        return _Unit(1.0, (0.0,) * 4, "")
    if not expected_kind.si:
        raise UnitProblem(f"{with_article(kind)} has no unit", f"Write a plain number, for example {expected_kind.example}")
    use = f'Use a unit of {kind}, for example "{expected_kind.example}"'
    spelled = plain(unit)
    if not _UNIT.fullmatch(spelled):
        raise UnitProblem(f'"{unit[:40]}" is not a unit', use)
    table = _table()
    try:
        result = _product(_factors(spelled, table))
    except KeyError as error:
        close = [f'"{name}"' for name in table if name.lower() == str(error.args[0]).lower()]
        hint = f"Upper and lower case matter: {' or '.join(close)}. " if close else ""
        raise UnitProblem(f'the unit "{unit[:40]}" is unknown', hint + use) from None
    result = _unit(_PER_TIME[kind][result.symbol], kind) if result.symbol in _PER_TIME.get(kind, {}) else result
    if result.powers != _product(_factors(expected_kind.si, table)).powers:
        raise UnitProblem(f'"{unit[:40]}" is not a unit of {kind}', use)
    return result


def factor(unit: str, kind: str) -> float:
    """Return the SI value of one `unit` of a kind of `KINDS`, for example "mm" or "kg*m^2".

    Raises
    ------
    UnitProblem
        The unit is unknown or measures another quantity.
    """
    return _unit(unit, kind).scale


def measures(text: str, kind: str) -> bool:
    """Return whether a text is a quantity of a kind."""
    with contextlib.suppress(UnitProblem):
        return math.isfinite(parse(text, kind)[0])
    return False


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any kind."""
    return kind_of_unit(text) is not None


@functools.lru_cache(maxsize=512)
def kind_of_unit(unit: str) -> str | None:
    """Return the first physical kind that has a unit; None for any other text."""
    for kind in (kind.name for kind in KINDS.values() if kind.si):
        with contextlib.suppress(UnitProblem):
            _unit(unit, kind)
            return kind
    return None


def in_si(unit: str) -> tuple[float, str]:
    """Return the SI value of one `unit`, and its SI unit, also of a square; any other text, as of a ratio, remains with 1."""
    kind = kind_of_unit(unit)
    if kind is None and unit.endswith("^2"):
        size, base = in_si(unit.removesuffix("^2"))
        return size**2, f"{base}^2"
    return (1.0, unit) if kind is None else (factor(unit, kind), KINDS[kind].si.replace("**", "^"))


def read_number(text: str) -> float:
    """Return the finite decimal number that a text is; NaN for any other text, for example "1_0" or digits of other scripts."""
    number = float(text) if _PLAIN_NUMBER.fullmatch(text) else math.nan
    return number if math.isfinite(number) else math.nan


def parse(text: object, kind: str) -> tuple[float, str]:
    """Return value [SI] and unit of a quantity such as "412 mm"; the unit in canonical spelling: "N*m" for "N·m" or "Nm".

    Raises
    ------
    UnitProblem
        Not a text, no number, no unit, unknown unit, unit of another quantity, or not finite.
    """
    expected_kind, quantity = KINDS[kind], with_article(kind)
    remedy = f'Write a number and a unit: "{expected_kind.example}"'
    if not expected_kind.si:
        remedy = f"Write a plain number, for example {expected_kind.example}"
    if isinstance(text, bool) or not isinstance(text, (str, int, float)):
        kinds = {bool: "a logical value", list: "a list", dict: "a table", datetime.date: "a date", datetime.time: "a time"}
        name = kinds.get(type(text), type(text).__name__)
        raise UnitProblem(f"expected {quantity}, found {name}", f'Write it as text: "{expected_kind.example}"')
    if not isinstance(text, str) and not expected_kind.si and math.isfinite(text):
        return float(text), ""
    if not isinstance(text, str):
        if abs(text) > 1e300 or not math.isfinite(text):
            raise UnitProblem(f"{quantity} must be finite", remedy)
        raise UnitProblem(f"{quantity} needs a unit", f"Write {_with_units(f'{text:.12g}', expected_kind)}, with the quotes")
    text = plain(text[:201])
    match = _QUANTITY.fullmatch(text) if len(text) <= 200 else None
    if match is None or _UNIT.fullmatch(match[2] or "m") is None:
        _check_form(text.strip(), kind)
    if match is None:
        raise UnitProblem(f"this is not {quantity}", remedy)
    number, unit = match.groups()
    if unit is None and expected_kind.si:
        raise UnitProblem(f"{quantity} needs a unit", f"Write {_with_units(number, expected_kind)}")
    known_unit = _unit(unit or "", kind)
    value = float(number) * known_unit.scale
    if not math.isfinite(value):
        raise UnitProblem(f"{quantity} must be finite", remedy)
    return value, known_unit.symbol


def _with_units(number: str, kind: Kind) -> str:
    """Return a number with the units that were probably meant: that of display, and SI, which is not typed in a command."""
    units = dict.fromkeys((kind.display, *(() if OPTIONS_NAMED.get() else (kind.si.replace("**", "^"),))))
    return " or ".join(f'"{number} {unit}"' for unit in units)


def _check_form(text: str, kind: str) -> None:
    """Raise for what is written in another form than a number and a unit, but can be recognised."""
    expected_kind = KINDS[kind]
    if len(text) > 200:
        return
    if re.match(r"[-+]?(nan|inf)", text, re.IGNORECASE):
        raise UnitProblem(f"{with_article(kind)} must be finite", f'Write a number and a unit: "{expected_kind.example}"')
    if split_range(text) is not None:
        raise UnitProblem(f"one {kind} is needed here, not a range", f'Write one value: "{expected_kind.example}"')
    numbers, unit = respelled(text)
    if numbers:
        unit = unit or expected_kind.display
        parse(f"{numbers[0]} {unit}", kind)
        written = " or ".join(f'"{number} {unit}"' for number in numbers)
        if len(numbers) > 1:
            raise UnitProblem("the comma may separate decimals or thousands", f"Write {written}")
        if re.fullmatch(_COMMA, text):
            raise UnitProblem("this has a decimal comma", f"Write a decimal point: {written}")
        raise UnitProblem("thousands separators are not read", f"Write {written}")


def respelled(text: str) -> tuple[tuple[str, ...], str]:
    """Return the numbers that a text with a decimal comma or thousands separators may mean, none for any other, and its unit."""
    if comma := re.fullmatch(_COMMA, text):
        sign, whole, decimals, unit = comma.groups()
        sure = len(decimals) != 3 or len(whole) > 3 or whole.startswith("0")
        return (f"{sign}{whole}.{decimals}", *(() if sure else (f"{sign}{whole}{decimals}",))), unit or ""
    if groups := re.fullmatch(_GROUPS, text):
        whole, decimals, unit = groups.groups()
        return (f"{re.sub('[^-+0-9]', '', whole)}{f'.{decimals}' if decimals else ''}",), unit or ""
    return (), ""


def split_range(text: str) -> dict[str, str | float] | None:
    """Return the sides of a range such as "40..140 deg", "80 mm +- 0.2 mm" or ">= 40 deg"; None for any other text.

    The values by "min" and "max" have their units; they are numbers where none is written.
    """
    if len(text) > 200 or not re.search(r"\.\.|\u2026|[<>\u2264\u2265\u00b1]|\+/?[-\u2010\u2011\u2013\u2212]", text):
        return None
    text = plain(text)
    if (toleranced := re.fullmatch(_TOLERANCE, text)) is not None:
        return _toleranced(*toleranced.groups())
    one_sided = re.fullmatch(_ONE_SIDED, text)
    if one_sided is not None:
        side, number, unit = one_sided.groups()
        return {"min" if side == ">" else "max": _side(number, unit)}
    match = re.fullmatch(_RANGE, text)
    if match is None:
        return None
    low, low_unit, high, high_unit = match.groups()
    return {"min": _side(low, low_unit or high_unit), "max": _side(high, high_unit or low_unit)}


def _toleranced(number: str, unit: str | None, tolerance: str, of_tolerance: str | None) -> dict[str, str | float] | None:
    """Return the sides of a value with a tolerance in its unit, in another unit of its kind, or in percent; None if unlike."""
    if "," in number + tolerance or tolerance.startswith("-"):
        return None
    value, width = decimal.Decimal(number), decimal.Decimal(tolerance)
    if of_tolerance == "%":
        width *= abs(value) / 100
    elif of_tolerance and of_tolerance != (unit or of_tolerance):
        (size, si), (own, own_si) = in_si(of_tolerance), in_si(unit or "")
        if si != own_si:
            return None
        width = decimal.Decimal(f"{float(width) * (size / own):.12g}")
    unit = unit or (of_tolerance if of_tolerance != "%" else None)
    return {side: _side(f"{end:zf}", unit) for side, end in (("min", value - width), ("max", value + width))}


def is_toleranced(text: str) -> bool:
    """Return whether a text is a value with a tolerance."""
    return len(text) <= 200 and re.fullmatch(_TOLERANCE, plain(text)) is not None


def is_sweep(text: str) -> bool:
    """Return whether a text is a range with a number of values, as `study sweep` has it: "450..550 mm:101"."""
    return (
        len(text) <= 200
        and re.fullmatch(r"\s*[-+]?\.?\d[^.:]*(\.\d[^.:]*)?\.\.[^:]*:\s*\d+\s*(log\s*)?[^\s\d:]*", text) is not None
    )


def mistyped_range(text: str) -> str | None:
    """Return the range that "40-140 deg", "40 to 140 deg" or "40...140 deg" means, with two dots; None for any other text."""
    text = plain(text[:201]).strip()
    hyphen = re.fullmatch(_HYPHEN, text)
    dotted = "..".join(part.strip() for part in (hyphen.groups() if hyphen else text.split("...")))
    return dotted if dotted != text and split_range(dotted) else None


def _side(number: str, unit: str | None) -> str | float:
    if unit:
        return f"{number} {unit}"
    return number if "," in number else float(number)


def split(text: str) -> tuple[float, str] | None:
    """Return number and unit of a quantity, the unit empty where there is none; None for any other text."""
    match = _QUANTITY.fullmatch(plain(text)) if len(text) <= 200 else None
    return None if match is None else (float(match[1]), match[2] or "")


def with_article(words: str) -> str:
    """Return words after "a" or "an"."""
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"


DISPLAYED = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "deg"), "": (1.0, "")}
"""Factor from SI and display unit of deviations, by their SI unit."""


def display_unit(kind: str) -> tuple[float, str]:
    """Return the factor from SI to the display unit of a kind, and that unit."""
    unit = KINDS[kind].display
    return 1.0 / factor(unit, kind), unit


def show(value: float, kind: str, unit: str | None = None, digits: int = 6) -> str:
    """Format an SI value in a unit, by default the display unit of its kind: `show(0.412, "length")` is "412 mm"."""
    unit = unit or KINDS[kind].display
    return f"{value / factor(unit, kind):z.{digits}g} {unit}".rstrip()


def percent(share: float, decimals: int = 1, *, signed: bool = False) -> str:
    """Format a share in per cent, as in "97.3 %"; a dash if it is not finite. `signed`: a change other than zero has its sign."""
    if not math.isfinite(share):
        return "-"
    shown = f"{100.0 * share:{'+' if signed else ''}z.{decimals}f}"
    return f"{shown if float(shown) else shown.removeprefix('+')} %"


def count_noun(count: int, noun: str, plural: str = "") -> str:
    """Write a number with its noun: "1 point", "1,200 points"; the plural has an s at its end, or is given."""
    return f"{count:,} {noun if count == 1 else plural or f'{noun}s'}"
