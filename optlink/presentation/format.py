"""Numbers as text, in tables, captions and charts, and their display units."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING, NamedTuple

from optlink.units import count_noun, percent
from optlink.validation.check import KEY, LIMIT, Check

if TYPE_CHECKING:
    from optlink.problem.driving import Driving
    from optlink.tasks.results.design import LinkageDesign


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


def comparable(value: float, gap: float) -> str:
    """Format a number with four significant digits, and with as many more as show its distance from a limit, up to nine."""
    whole = math.floor(math.log10(abs(value))) if value and math.isfinite(value) else 0
    return number(value, min(max(4, whole + 1 - math.floor(math.log10(gap)) if gap > 0.0 else 4), 9))


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


def position(driving: Driving, at: float) -> str:
    """Format a position of a drive [rad] in its unit: "30.00°", "1050 mm"."""
    return degrees(at) if driving.ends is None else figure(driving.shown(at), driving.unit)


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


_UNIT = re.compile(r"(.+?)_((?:rad|m)_s2?|(?:rad|mm|m|deg)2?|s|kg|N|Nm|W|J|Pa|percent|[A-Za-z]+\d?_per_[A-Za-z]+\d?)")


def column_unit(column: str) -> tuple[str, str]:
    """Return the name of a column without the unit that ends it, and that unit; empty if there is none."""
    match = _UNIT.fullmatch(column)
    if match is None:
        return column, ""
    name, unit = match.groups()
    unit = unit.replace("_per_", "/").replace("_", "/").replace("Nm", "N m").replace("percent", "%")
    return name, unit.removesuffix("2") + ("²" if unit.endswith("2") else "")


def si(value: float, unit: str) -> str:
    """Format a value [SI] in its display unit."""
    shown = scale(abs(value), "deg" if unit == "rad" else unit)
    return figure(value * shown.factor, shown.unit)


def joined(words: Sequence[str]) -> str:
    """Join words with commas and "and"."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


# Why a design is not valid, in words: what was measured, and what is required.

MEASURED = (
    (r"swing angle, (?:least|largest)", "the rocker swings {}"),
    (KEY + r"stroke of (.+)", r"the stroke of \1 is {}"),
    (KEY + r"(?:least|smallest) transmission angle( at .+)?", r"the transmission angle\1 falls to {}"),
    (KEY + r"largest transmission angle( at .+)?", r"the transmission angle\1 rises to {}"),
    (KEY + r"(?:peak|largest) pressure angle( at .+)?", r"the pressure angle\1 rises to {}"),
    (r"(.+) off alignment over .+", r"the angle of \1 from alignment falls to {}"),
    (r"(.+) within its bounds", r"\1 is {}"),
    (r"(.+), (?:least|largest)", r"the \1 is {}"),
)
"""Names of measured limits, and how to state the value; the limit follows."""
OTHERS = (
    (r"Grashof: .+|the crank turns fully", "the crank cannot turn fully"),
    (r"the linkage closes throughout the range", "the linkage does not close throughout the range of the drive"),
    (r"link lengths re-measured in motion", "the links do not meet in every position"),
    (r"one branch: .+", "the linkage leaves its assembly mode"),
    (r"one circuit: .+", "the linkage does not reach all positions in one motion"),
    (r"no singular position .+", "the mechanism passes a singular position"),
    (r"the linkage has a position for every target", "the linkage does not reach every target"),
    (r"output error has a value everywhere", "the linkage does not reach every position"),
    (r"points met in order", "the points are not met in order"),
    (r"points met within one revolution", "the points are not met within one revolution"),
    (r"points met within their tolerances", "a point is missed by {} times its tolerance"),
    (r"all limits met \(scaled\)", "a limit is missed by {} of the scale"),
    (r"optimality .+", "the search ended before an optimum"),
    (r"objective measured in motion", "the objective differs from that measured in motion by {}"),
)
"""Names of other checks, and how to state that they fail."""
GENERAL = (KEY + r"(.+)", r"\1 is {}")
TURNS = OTHERS[0][0]
SIDES = {">=": "at least ", "<=": "at most ", "=": "", "": ""}


def causes(checks: Sequence[Check]) -> list[str]:
    """Return why a design is not valid, one text for each failed check that is no consequence of others.

    Where the crank cannot turn, that is the cause; checks without a value follow from others that have one. Two checks with the
    same limit prescribe a value.
    """
    failed = [check for check in checks if not check.passed]
    turns = [check for check in failed if re.fullmatch(TURNS, check.name)]
    valued = [check for check in failed if math.isfinite(check.value)]
    return list(dict.fromkeys(_cause(check, checks) for check in turns or valued or failed))


def why_invalid(checks: Sequence[Check], otherwise: str) -> str:
    """Return the first cause why a design is not valid, and the number of others; `otherwise` if every check passed."""
    first, *others = causes(checks) or [otherwise]
    more = f"; {count_noun(len(others), 'more check fails', 'more checks fail')}" if others else ""
    return f"{first}{more}"


def marked(title: str, design: LinkageDesign, refuted: str) -> list[str]:
    """Return the lines of a picture's title; the second one says why a design is not valid.

    That is which limits exclude each other (`refuted`), or the first cause.
    """
    if design.valid:
        return [title]
    return [title, refuted or f"NOT VALID: {why_invalid(design.validation.checks, design.status.text)}"]


def _cause(check: Check, checks: Sequence[Check]) -> str:
    value = f"{number(check.value, 4)} {check.unit}".rstrip()
    for name, words in OTHERS:
        if re.fullmatch(name, check.name):
            return words.replace("{}", number(check.value, 3))
    limit = LIMIT.fullmatch(check.limit)
    if limit is None or not math.isfinite(check.value):
        return f"it fails the check of {check.name}"
    name, words = next(pair for pair in (*MEASURED, GENERAL) if re.fullmatch(pair[0], check.name))
    match = re.fullmatch(name, check.name)
    assert match is not None
    sides = {one.limit.partition(" ")[0] for one in checks if one.limit.partition(" ")[2] == limit[2]}
    prescribed = sides >= {">=", "<="}  # the same value limits from below and from above
    required = f"{'' if prescribed else SIDES[limit[1]]}{limit[2]} {check.unit}".rstrip()
    return f"{match.expand(words).replace('{}', value)}, {required} {'are' if check.unit else 'is'} required"
