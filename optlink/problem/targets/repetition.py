"""Number of revolutions of the crank after which an expression of the crank angle repeats, from its form alone."""

import math
from dataclasses import dataclass
from typing import Self

from optlink.problem.targets.expression import FUNCTIONS, Expression, operation

MOST_REVOLUTIONS = 24
"""Revolutions after which a cycle must end."""
SAME_PHASE = 1e-9  # rad by which an angle may miss a whole multiple of half a turn
ROUNDING = 1e-15  # of the sum of two slopes, below which they cancel one another
ODD = ("sin", "tan", "asin", "atan", "sinh", "tanh")  # f(-x) = -f(x)
EVEN = ("cos", "cosh", "abs")  # f(-x) = f(x)


@dataclass(frozen=True)
class _Part:
    """A part f of an expression: after `revolutions` of the crank it is `sign` f plus `slope` times the crank rotation."""

    revolutions: int = 1
    sign: int = 1
    slope: float = 0.0
    constant: float | None = None

    def over(self, revolutions: int) -> Self:
        """Return the part over a multiple of its revolutions."""
        return type(self)(revolutions, self.sign ** (revolutions // self.revolutions), self.slope, self.constant)

    def repeated(self) -> Self:
        """Return the part over revolutions after which its sign is the same again."""
        return self if self.sign > 0 else self.over(2 * self.revolutions)


def revolutions_of(expression: Expression) -> int | None:
    """Return the revolutions of the crank after which an expression repeats, its other variables unchanged; None if it does not.

    Its variable phi is the crank angle [rad]. It may repeat after a part of them already: parts that cancel one another are not
    recognised.
    """
    stack: list[_Part | None] = []
    for kind, what in expression.program:
        if kind == "number":
            stack.append(_Part(constant=float(what)))
        elif kind == "name":
            stack.append(_Part(slope=1.0 if what == "phi" else 0.0))
        else:
            parts = [stack.pop() for _ in range(2 if kind == "binary" else 1)]
            stack.append(_result(kind, what, [part for part in reversed(parts) if part is not None], len(parts)))
    part = stack.pop()
    if part is None or part.slope:
        return None
    revolutions = part.repeated().revolutions
    return revolutions if revolutions <= MOST_REVOLUTIONS else None


def _result(kind: str, what: str, parts: list[_Part], count: int) -> _Part | None:
    """Return the result of an operation on parts; None if it does not repeat, or one of its `count` parts does not."""
    if len(parts) < count:
        return None
    constants = [part.constant for part in parts if part.constant is not None]
    if len(constants) == count:
        return _Part(constant=operation(kind, what, constants))
    if kind == "negate":
        return _scaled(parts[0], -1.0)
    if kind == "function":
        return _function(what, parts[0])
    first, second = parts
    if what == "^":
        return _power(first, second)
    if what == "*" and constants:
        return _scaled(second if first.constant is not None else first, constants[0])
    if what == "/" and second.constant is not None:
        return _scaled(first, 1.0 / second.constant) if second.constant else None
    revolutions = math.lcm(first.revolutions, second.revolutions)
    first, second = first.over(revolutions), second.over(revolutions)
    if what in "*/":
        return None if first.slope or second.slope else _Part(revolutions, first.sign * second.sign)
    if first.sign != second.sign:
        first, second = first.over(2 * revolutions), second.over(2 * revolutions)
    slope = first.slope + (second.slope if what == "+" else -second.slope)
    cancelled = abs(slope) <= ROUNDING * (abs(first.slope) + abs(second.slope))
    return _Part(first.revolutions, first.sign, 0.0 if cancelled else slope)


def _scaled(part: _Part, factor: float) -> _Part:
    if factor == 0.0:
        return _Part(constant=0.0)
    return _Part(part.revolutions, part.sign, part.slope * factor)


def _function(name: str, part: _Part) -> _Part | None:
    assert name in FUNCTIONS
    if part.slope:
        halves = 2.0 * part.revolutions * part.slope  # half turns of its argument in the revolutions of the part
        for times in range(1, MOST_REVOLUTIONS // part.revolutions + 1) if name in ("sin", "cos", "tan") else ():
            whole = round(times * halves)
            if abs(times * halves - whole) * math.pi <= SAME_PHASE:
                return _Part(times * part.revolutions, 1 if name == "tan" or whole % 2 == 0 else -1)
        return None
    if name in EVEN:
        return _Part(part.revolutions)
    return _Part(part.revolutions, part.sign) if name in ODD else _Part(part.repeated().revolutions)


def _power(base: _Part, exponent: _Part) -> _Part | None:
    power = exponent.constant
    if power == 0.0:
        return _Part(constant=1.0)
    if power == 1.0:
        return base
    if base.slope or exponent.slope:
        return None
    if power is not None and power % 1.0 == 0.0:
        return _Part(base.revolutions, base.sign if power % 2.0 else 1)
    return _Part(math.lcm(base.repeated().revolutions, exponent.repeated().revolutions))
