"""Conversion of quantities such as "412 mm", "64 rpm" or "45 deg" to SI values, and formatting in display units.

Pint does the algebra on a dedicated registry of the units of machine design, because its default registry takes
a fifth of a second to load and defines other meanings of `deg` (temperature step), `h` (Planck constant) and the year.
"""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass
from typing import Any

DEFINITIONS = (
    "meter = [length] = m = metre",
    "second = [time] = s = sec",
    "kilogram = [mass] = kg",
    "radian = [angle] = rad",
    "millimeter = 1e-3 m = mm = millimetre",
    "centimeter = 1e-2 m = cm = centimetre",
    "decimeter = 1e-1 m = dm",
    "micrometer = 1e-6 m = um = micrometre",
    "kilometer = 1e3 m = km",
    "inch = 0.0254 m = in",
    "foot = 0.3048 m = ft",
    "degree = 0.017453292519943295 rad = deg",
    "milliradian = 1e-3 rad = mrad",
    "arcminute = 0.0002908882086657216 rad = arcmin",
    "turn = 6.283185307179586 rad = rev = revolution",
    "rpm = 0.10471975511965977 rad / s",
    "millisecond = 1e-3 s = ms",
    "minute = 60 s = min",
    "hour = 3600 s",
    "hertz = 6.283185307179586 rad / s = Hz",
    "gram = 1e-3 kg = g",
    "tonne = 1e3 kg = t",
    "pound = 0.45359237 kg = lb",
    "newton = kg * m / s ** 2 = N",
    "kilonewton = 1e3 N = kN",
    "pound_force = 4.4482216152605 N = lbf",
    "joule = N * m = J",
    "watt = J / s = W",
    "kilowatt = 1e3 W = kW",
    "pascal = N / m ** 2 = Pa",
    "megapascal = 1e6 Pa = MPa",
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
        Kind("angular velocity", "rad/s", "rpm", "64 rpm"),
        Kind("time", "s", "s", "2 s"),
        Kind("mass", "kg", "kg", "1.2 kg"),
        Kind("density", "kg/m**3", "kg/m^3", "7850 kg/m^3"),
        Kind("force", "N", "N", "1000 N"),
        Kind("torque", "N*m", "N*m", "5 N*m"),
        Kind("energy", "J", "J", "100 J"),
        Kind("moment of inertia", "kg*m**2", "kg*m^2", "0.016 kg*m^2"),
        Kind("acceleration", "m/s**2", "m/s^2", "9.81 m/s^2"),
        Kind("stiffness", "N/m", "N/m", "500 N/m"),
        Kind("damping", "N*s/m", "N*s/m", "20 N*s/m"),
        Kind("velocity", "m/s", "m/s", "0.01 m/s"),
        Kind("pressure", "Pa", "GPa", "207 GPa"),
        Kind("contact stiffness", "N/m**1.5", "N/m^1.5", "6.6e+10 N/m^1.5"),
        Kind("frequency", "rad/s", "Hz", "300 Hz"),
        Kind("torsional stiffness", "N*m/rad", "N*m/rad", "5 N*m/rad"),
        Kind("torsional damping", "N*m*s/rad", "N*m*s/rad", "0.1 N*m*s/rad"),
    )
}

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)\s*([^\s\d].*?)?\s*", re.DOTALL | re.ASCII)
_FACTOR = r"[A-Za-z°µμ_]+(?:\s*(?:\^|\*\*)\s*-?[1-4](?:\.5)?)?"
_UNIT = re.compile(rf"{_FACTOR}(?:(?:\s*[*/·]\s*|\s+){_FACTOR}){{0,4}}")  # "kg m^2" is kg*m^2


class UnitProblem(ValueError):
    """A quantity that cannot be parsed: `message` gives the reason, `remedy` the correction."""

    def __init__(self, message: str, remedy: str) -> None:
        super().__init__(f"{message}. {remedy}")
        self.message, self.remedy = message, remedy


@functools.cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(None, on_redefinition="raise")
    for definition in DEFINITIONS:
        registry.define(definition)
    return registry


@functools.lru_cache(maxsize=512)
def factor(unit: str, kind: str) -> float:
    """Return the SI value of one `unit`.

    Parameters
    ----------
    unit : str
        A unit, for example "mm" or "kg*m^2".
    kind : str
        One of `KINDS`.

    Raises
    ------
    UnitProblem
        The unit is unknown or measures another quantity.
    """
    import pint

    wanted = KINDS[kind]
    use = f'Use a unit of {kind}, for example "{wanted.example}"'
    spelled = unit.replace("°", "deg").replace("µ", "u").replace("μ", "u").replace("·", "*").replace("^", "**")
    if not _UNIT.fullmatch(unit):
        raise UnitProblem(f'"{unit[:40]}" is not a unit', use)
    registry = _registry()
    try:
        one = registry.Quantity(1.0, registry.parse_units(spelled))
        return float(one.to(wanted.si).magnitude)
    except pint.UndefinedUnitError:
        raise UnitProblem(f'the unit "{unit[:40]}" is unknown', use) from None
    except pint.DimensionalityError:
        raise UnitProblem(f'"{unit[:40]}" is not a unit of {kind}', use) from None
    except (pint.PintError, ValueError, TypeError, AttributeError, OverflowError, ArithmeticError):
        raise UnitProblem(f'"{unit[:40]}" is not a unit', use) from None


def parse(text: object, kind: str) -> tuple[float, str]:
    """Parse a quantity such as "412 mm".

    Parameters
    ----------
    text : str
        A number and a unit.
    kind : str
        One of `KINDS`.

    Returns
    -------
    value : float, in SI
    unit : str, as written

    Raises
    ------
    UnitProblem
        Not a text, no number, no unit, unknown unit, unit of another quantity, or not finite.
    """
    wanted = KINDS[kind]
    if isinstance(text, bool) or not isinstance(text, (str, int, float)):
        raise UnitProblem(f"expected {_a(kind)}, found {type(text).__name__}", f'Write it as text: "{wanted.example}"')
    if not isinstance(text, str):
        if abs(text) > 1e300 or not math.isfinite(text):
            raise UnitProblem(f"{_a(kind)} must be finite", f'Write a number and a unit: "{wanted.example}"')
        raise UnitProblem(f"{_a(kind)} needs a unit", f'Write "{_digits(text)} {wanted.display}", with the quotes')
    match = _QUANTITY.fullmatch(text) if len(text) <= 200 else None
    if match is None:
        if re.match(r"\s*[-+]?(nan|inf)", text, re.IGNORECASE):
            raise UnitProblem(f"{_a(kind)} must be finite", f'Write a number and a unit: "{wanted.example}"')
        raise UnitProblem(f"this is not {_a(kind)}", f'Write a number and a unit: "{wanted.example}"')
    number, unit = match.groups()
    if unit is None:
        raise UnitProblem(f"{_a(kind)} needs a unit", f'Write "{number} {wanted.display}"')
    value = float(number) * factor(unit, kind)
    if not math.isfinite(value):
        raise UnitProblem(f"{_a(kind)} must be finite", f'Write a number and a unit: "{wanted.example}"')
    return value, unit


def _a(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _digits(number: float) -> str:
    return f"{number:.12g}"


def show(value: float, kind: str, unit: str | None = None, digits: int = 6) -> str:
    """Format an SI value in display units: `show(0.412, "length")` is "412 mm".

    Parameters
    ----------
    value : float
        Value in SI.
    kind : str
        One of `KINDS`.
    unit : str, optional
        Unit of the output. Default: the display unit of the kind.
    digits : int
        Significant digits.
    """
    unit = unit or KINDS[kind].display
    return f"{value / factor(unit, kind):.{digits}g} {unit}"
