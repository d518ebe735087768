"""Numbers as text, in tables, captions and charts, and their display units."""

import contextlib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import NamedTuple

from optlink.units import percent

FINEST_STEP = 1e-3  # share of a step to which it is refined for a steep price
_PRODUCT = re.compile(r"\b([kMGmµnpfa]?N|kg)[ *]m\b")


def number(value: float, digits: int = 6) -> str:
    """Format a number with significant digits (two below 1e-5); a dash if it is not finite."""
    if not math.isfinite(value):
        return "-"
    if abs(value) < 1e-300:
        return "0"
    return f"{value:.{digits}g}" if abs(value) >= 1e-5 else f"{value:.1e}"


def precise(value: float, digits: int) -> str:
    """Format a number with all its significant digits, however small it is."""
    return number(value, digits) if value == 0.0 or abs(value) >= 1e-5 else f"{value:.{digits - 1}e}"


def price_step(unit: str, bound: float = 0.0, share: float = 0.0) -> tuple[float, str]:
    """Return the step of a limit or parameter to which a price refers, with its text: one unit, or 0.01 of a ratio.

    It is a smaller power of ten where that exceeds a tenth of the bound, or changes the objective by more than all of it, and
    a larger one from a bound of 10,000 on. `share` is the relative change of the objective per unit.
    """
    step, size = (1.0 if unit else 0.01), abs(bound)
    if 0.0 < size < math.inf:
        place = math.floor(math.log10(size) + 1e-9)
        step = 10.0 ** (place - 3) if size >= 1e4 else min(step, 10.0 ** (place - 1))
    finest = FINEST_STEP * step
    while 1.0 < share * step < math.inf and step > 1.5 * finest:
        step *= 0.1
    return (step, unit) if unit and step == 1.0 else (step, f"{step:g} {unit}".rstrip())


def fixed(value: float, decimals: int = 3) -> str:
    """Format a number with fixed decimals; a dash if it is not finite."""
    return f"{value:z.{decimals}f}" if math.isfinite(value) else "-"


def significant(value: float) -> str:
    """Format a dimension with at least three decimals and six significant digits; zero if it is below 1e-5."""
    digits = 3 if abs(value) >= 100.0 or abs(value) < 1e-5 else 5 - math.floor(math.log10(abs(value)))
    return fixed(value, digits)


def dimension(value: float) -> str:
    """Format a dimension with three decimals; six significant digits below 1."""
    return number(value) if 1e-5 <= abs(value) < 1.0 else fixed(value)


def product(text: str) -> str:
    """Write the products of units in a text with a dot: N·m, kg·m^2."""
    return _PRODUCT.sub(r"\1·m", text)


def pretty(text: str) -> str:
    """Write units and relations in a text with their signs: N·m, rad², ≤."""
    return product(text).replace("^2", "²").replace("<=", "≤").replace(">=", "≥").replace("->", "→")


def shown(text: str) -> str:
    """Write the units and relations in a sentence with their signs, as the values of a page have them."""
    return re.sub(r"(?<=\d) deg\b", "°", pretty(text))


def signed(value: float) -> str:
    """Format a change with its sign and four significant digits."""
    return f"{value:+.4g}" if value else "0"


def change(share: float) -> str:
    """Format a relative change in per cent with two decimals and its sign unless it is zero; a dash if it is not finite."""
    return percent(share, 2, signed=True)


def round_below(value: float, steps: Sequence[float] = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0), room: float = 0.0) -> float:
    """Return the largest round number up to a value; 0 if the value is not positive or not finite.

    `steps` are the first digits of round numbers; by the share `room` the number may exceed the value: rounding errors.
    """
    if not 0.0 < value < math.inf:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in steps if step * power <= value * (1.0 + room))


def points(count: int) -> str:
    """Format a number of points, with its noun."""
    return f"{count:,} point{'' if count == 1 else 's'}"


def times(seconds: Mapping[str, float], decimals: int = 0) -> str:
    """List the stages that took time [s], in milliseconds."""
    return ", ".join(f"{name} {1e3 * value:z.{decimals}f} ms" for name, value in seconds.items() if value > 0.0)


class Scale(NamedTuple):
    """Display unit of a quantity: values in SI times `factor` in `unit`; `decimals` shows the largest value with five digits."""

    factor: float
    unit: str
    decimals: int = 3

    def text(self, value: float) -> str:
        """Format a value [SI] with its unit."""
        size = abs(value * self.factor)
        decimals = min(self.decimals, max(0, 4 - math.floor(math.log10(size)))) if size >= 1.0 else self.decimals
        shown = f"{value * self.factor:z.{decimals}f}" if size < 1e7 else f"{value * self.factor:.3e}"
        shown = shown.replace("-", "−")
        return f"{shown}{'°' if self.unit == 'deg' else ' ' + self.unit}"


def degrees(angle: float) -> str:
    """Format an angle [rad] in degrees."""
    return scale(0.0, "deg").text(angle)


LENGTH = ((1e3, "k", 5.0), (1.0, "", 5.0), (1e-3, "m", 1.0), (1e-6, "µ", 1.0), (1e-9, "n", 0.0))
OTHER = (
    (1e9, "G", 5.0),
    (1e6, "M", 5.0),
    (1e3, "k", 5.0),
    (1.0, "", 0.5),
    (1e-3, "m", 0.5),
    (1e-6, "µ", 0.5),
    (1e-9, "n", 0.5),
    (1e-12, "p", 0.5),
    (1e-15, "f", 0.5),
    (1e-18, "a", 0.0),
)
PREFIXED = {"m": LENGTH, "m/s": OTHER[3:], "m/s²": OTHER[3:], "N": OTHER, "N m": OTHER, "J": OTHER, "W": OTHER}
"""Prefixes by unit: size, letter, and from how many of them on it is taken."""


_single: ContextVar[bool] = ContextVar("single", default=False)


@contextlib.contextmanager
def single_units() -> Iterator[None]:
    """Show every length in mm and every other quantity without a prefix, so that a page has one unit for each kind."""
    before = _single.set(True)
    try:
        yield
    finally:
        _single.reset(before)


def scale(largest: float, unit: str) -> Scale:
    """Return the display unit for quantities up to a value [SI]; angles ("deg") are shown in degrees."""
    largest = abs(largest) if math.isfinite(largest) else 0.0
    if unit == "deg":
        return Scale(math.degrees(1.0), unit, 2)
    factor, letter = 1.0, ""
    if _single.get() and unit in PREFIXED:
        factor, letter = (1e3, "m") if unit == "m" else (1.0, "")
    elif largest > 0.0 and unit in PREFIXED:
        size, letter = next((size, letter) for size, letter, least in PREFIXED[unit] if largest >= least * size or least == 0.0)
        factor = 1.0 / size
    digits = math.floor(math.log10(largest * factor)) if largest > 0.0 else 0
    return Scale(factor, product(letter + unit), min(max(0, 4 - digits), 9))


def figure(value: float, unit: str = "") -> str:
    """Format a value in a display unit with four significant digits."""
    if not math.isfinite(value):
        return "unlimited"
    size = abs(value)
    shown = f"{value:z.4g}" if 1e-4 <= size < 1e4 or value == 0.0 else f"{value:z,.0f}" if 1e4 <= size < 1e9 else f"{value:.3e}"
    return shown.replace("-", "−") + ("°" if unit == "deg" else f" {pretty(unit)}" if unit else "")


def si(value: float, unit: str) -> str:
    """Format a value [SI] in its display unit."""
    shown = scale(abs(value), "deg" if unit == "rad" else unit)
    return figure(value * shown.factor, shown.unit)


def joined(words: Sequence[str]) -> str:
    """Join words with commas and "and"."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
