"""Expressions of target laws: "psi0 + 2/(3*pi)*(phi - phi0)^2".

An expression consists of numbers, permitted names, pi, + - * / ^ (or **), brackets and the functions of `FUNCTIONS`. It is parsed
into a postfix program and run on numpy ufuncs, so floats, arrays, casadi symbols and jets are all supported; no text is ever
passed to Python for evaluation.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, NoReturn, Self

import numpy as np

from optlink.errors import InvalidValue
from optlink.linkage.vector2d import Value, all_finite
from optlink.problem.quantity import nearest
from optlink.units import is_unit

MAX_CHARACTERS = 2_000
MAX_DEPTH = 60
SPACE = " \t\r\n\f\v"

FUNCTIONS: dict[str, np.ufunc] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "exp": np.exp,
    "log": np.log,
    "log10": np.log10,
    "sqrt": np.sqrt,
    "abs": np.absolute,
}
CONSTANTS = {"pi": float(np.pi)}
_BINARY: dict[str, np.ufunc] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "^": np.power,
}
_NAME = "[A-Za-z_][A-Za-z_0-9]*"
_PARTED = rf"{_NAME}(?:\.{_NAME})*"
_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_TOKEN, _TOKEN_OF_LINK = (
    re.compile(rf"\s*(?:(?P<number>{_NUMBER})|(?P<name>{name})|(?P<sign>\*\*|[-+*/^()]))", re.ASCII) for name in (_NAME, _PARTED)
)
# binding powers: left, right; a higher one binds tighter. -x^2 is -(x^2), 2^-1 is 0.5, 2^3^2 is 2^9
_POWER = {"+": (10, 11), "-": (10, 11), "*": (20, 21), "/": (20, 21), "^": (41, 40)}
_NEGATE = 30

_REMEDIES = {
    ",": "Write decimals with a point",
    ".": "Write * / ^ without a point before them",
    "=": "Write what is on the right of =",
    "\N{DEGREE SIGN}": "Angles are in radians: write 30*pi/180",
    "\N{GREEK SMALL LETTER PHI}": "Write phi in its place",
    "\N{GREEK SMALL LETTER PSI}": "Write psi in its place",
    "\N{GREEK SMALL LETTER PI}": "Write pi in its place",
    "\N{MINUS SIGN}": "Write - in its place",
    "\N{MIDDLE DOT}": "Write * in its place",
    "\N{SUPERSCRIPT TWO}": "Write ^2 in its place",
}
"""What to write instead of a character that does not belong in a law."""

Step = tuple[str, Any]


class LawError(InvalidValue):
    """A law that cannot be parsed: `message` is the error and its column, `remedy` how to fix it."""


@dataclass(frozen=True)
class Expression:
    """A parsed law: its text, the names it uses, and its postfix program."""

    text: str
    names: frozenset[str] = field(repr=False)
    program: tuple[Step, ...]

    def __call__(self, values: Mapping[str, Value]) -> Value:
        """Evaluate with a Value for every name; NaN or infinity where it is undefined, without warnings."""
        return self._run(values, None)

    @property
    def constants_finite(self) -> bool:
        """Whether every part without variables has a finite value, and none that divides is zero: not in 1/0 or x/(2 - 2)."""
        stack: list[Value | None] = []  # None: a part with a variable
        for kind, what in self.program:
            if kind in ("number", "name"):
                stack.append(what if kind == "number" else None)
                continue
            parts = [stack.pop() for _ in range(2 if kind == "binary" else 1)]
            if None in parts:
                stack.append(None)
                fine = (what, parts[0]) != ("/", 0.0)
            else:
                value = operation(kind, what, [part for part in reversed(parts) if part is not None])
                stack.append(value)
                fine = bool(np.isfinite(value))
            if not fine:
                return False
        return True

    def hazards(self, values: Mapping[str, Value]) -> str | None:
        """Return the defect of a law along arrays of consecutive values, or None.

        Poles between two values are found too: a denominator that changes its sign.
        """
        hazards: list[str] = []

        def watch(sign: str, left: Any, right: Any) -> None:
            denominator = right if sign == "/" else left
            if sign == "tan":
                denominator = np.cos(left)
            elif sign not in "/^" or (sign == "^" and not np.any(np.asarray(right) < 0.0)):
                return
            array = np.atleast_1d(np.asarray(denominator, dtype=float))
            if np.any(array == 0.0) or (np.any(array < 0.0) and np.any(array > 0.0)):
                what = {"/": "divides by zero", "^": "raises zero to a negative power", "tan": "passes a pole of tan"}
                hazards.append(what[sign])

        result = np.asarray(self._run(values, watch), dtype=float)
        if hazards:
            return hazards[0]
        if not all_finite(result):
            return "has no finite real value (a root or logarithm of a negative number, or an overflow)"
        return None

    def breakpoints(self, values: Mapping[str, Value]) -> list[Value]:
        """Return quantities at whose zeros the value may have a pole, a jump, a corner or an end of its domain.

        They are denominators, bases of powers that are not whole numbers above zero, and arguments of roots, logarithms and
        absolute values; those that are constant over arrays of values are left out.
        """
        breakpoints: list[Value] = []

        def watch(sign: str, left: Any, right: Any) -> None:
            if sign == "/":
                breakpoints.append(right)
            elif sign == "^":
                if np.ndim(right) or right <= 0.0 or right % 1.0:
                    breakpoints.append(left)
            elif sign == "tan":
                breakpoints.append(np.cos(left))
            elif sign in ("asin", "acos"):
                breakpoints.append(1.0 - left * left)
            elif sign in ("sqrt", "log", "log10", "abs"):
                breakpoints.append(left)

        self._run(values, watch)
        return [value for value in breakpoints if np.ndim(value)]

    def _run(self, values: Mapping[str, Value], watch: Callable[[str, Any, Any], None] | None) -> Value:
        stack: list[Value] = []
        with np.errstate(all="ignore"):
            for kind, what in self.program:
                if kind == "number":
                    stack.append(what)
                elif kind == "name":
                    stack.append(values[what])
                elif kind == "negate":
                    stack.append(-stack.pop())
                elif kind == "function":
                    x = stack.pop()
                    if watch:
                        watch(what, x, None)
                    stack.append(FUNCTIONS[what](x))
                else:
                    right, left = stack.pop(), stack.pop()
                    if watch and what in "/^":
                        watch(what, left, right)
                    stack.append(_BINARY[what](left, right))
        return stack.pop()


def operation(kind: str, what: str, constants: Iterable[float]) -> float:
    """Return the result of a step of a program on constants, its operands in order."""
    program = (*(("number", constant) for constant in constants), (kind, what))
    return float(Expression("", frozenset(), program)({}))


@dataclass(frozen=True)
class Wording:
    """How a kind of expressions is called in errors, with an example.

    `of_quantities`: whether its names can have several parts, such as "crank.length", and its numbers units.
    """

    noun: str
    example: str
    of_quantities: bool = False


LAW = Wording("law", "psi0 + 0.5*(phi - phi0)")


def parse(text: str, names: Iterable[str], wording: Wording = LAW) -> Expression:
    """Parse an expression, by default a law, with these variables beside pi and the functions.

    It has at most `MAX_CHARACTERS` characters, and brackets nested at most `MAX_DEPTH` deep. A number with a unit, such as
    "3 mm", is a variable of that name.

    Raises
    ------
    LawError
    """
    if len(text) > MAX_CHARACTERS:
        message = f"the {wording.noun} has {len(text):,} characters, more than {MAX_CHARACTERS:,}"
        raise LawError(message, "Shorten it, or give it as a table")
    parser = _Parser(text, frozenset(names), wording)
    parser.expression(0, 0)
    if parser.here is not None:
        parser.fail(f'"{parser.here.text}" is not expected here', "Check brackets and operators; write 2*pi, not 2 pi")
    return Expression(text, frozenset(parser.used), tuple(parser.program))


class _Token(NamedTuple):
    """A number, a name or a sign, and the column where it begins, from 1."""

    kind: str
    text: str
    column: int


class _Parser:
    """Precedence-climbing (Pratt) parser that emits postfix. `here` is the next token, None at the end."""

    def __init__(self, text: str, names: frozenset[str], wording: Wording) -> None:
        self.text, self.names, self.wording = text, names, wording
        self.used: set[str] = set()
        self.program: list[Step] = []
        self.end = 0
        self.here: _Token | None = None
        self.advance()

    def fail(self, message: str, remedy: str, column: int | None = None) -> NoReturn:
        """Refuse the law at a column, by default that of the next token."""
        at = column or (self.here.column if self.here is not None else len(self.text.rstrip(SPACE)) + 1)
        raise LawError(f"{message} (column {at})", remedy)

    def advance(self) -> None:
        rest = self.text[self.end :]
        column = self.end + len(rest) - len(rest.lstrip(SPACE)) + 1
        if not rest.strip(SPACE):
            self.here = None
            return
        match = (_TOKEN_OF_LINK if self.wording.of_quantities else _TOKEN).match(rest)
        if match is None:
            sign = self.text[column - 1]
            noun, names = self.wording.noun, ", ".join(sorted(self.names))
            law = f"A {noun} has numbers, {names}, pi, + - * / ^, brackets and the usual functions"
            file = f'Write law = {{ csv = "{self.text.strip()}" }}' if self.text.strip().endswith(".csv") else None
            self.fail(f'"{sign}" does not belong in a {noun}', file or _REMEDIES.get(sign, law), column)
        self.end += match.end()
        self.here = _Token(str(match.lastgroup), match.group().strip().replace("**", "^"), column)

    def expression(self, power: int, depth: int) -> None:
        if depth > MAX_DEPTH:
            self.fail(f"the {self.wording.noun} is nested more than {MAX_DEPTH} deep", "Simplify it, or give it as a table")
        self.operand(depth)
        while self.here is not None and self.here.text in _POWER:
            sign = self.here.text
            left, right = _POWER[sign]
            if left < power:
                return
            self.advance()
            self.expression(right, depth + 1)
            self.program.append(("binary", sign))

    def operand(self, depth: int) -> None:
        if self.here is None:
            self.fail(f"the {self.wording.noun} ends too early", f"Complete it, for example: {self.wording.example}")
        kind, token, column = self.here
        if kind == "number":
            self.advance()
            number = float(token)
            if not np.isfinite(number):
                self.fail(f"{token} is too large a number", "Use a smaller one", column)
            if self.wording.of_quantities and self.here is not None and self.here.kind == "name" and is_unit(self.here.text):
                name = f"{token} {self.here.text}"
                self.advance()
                self.used.add(name)
                self.program.append(("name", name))
            else:
                self.program.append(("number", number))
        elif kind == "name":
            self.advance()
            self.name(token, column, depth)
        elif token in "+-":
            self.advance()
            self.expression(_NEGATE, depth + 1)
            if token == "-":
                self.program.append(("negate", None))
        elif token == "(":
            self.bracket(depth)
        else:
            self.fail(f'"{token}" is not expected here', "An operand is missing before it")

    def bracket(self, depth: int) -> None:
        assert self.here is not None
        opening_column = self.here.column
        self.advance()
        self.expression(0, depth + 1)
        if self.here is None:
            self.fail("a bracket is not closed", 'Add the missing ")"', opening_column)
        if self.here.text != ")":
            self.fail(f'"{self.here.text}" is not expected here', 'Check operators, or add the missing ")"')
        self.advance()

    def name(self, token: str, column: int, depth: int) -> None:
        if token in FUNCTIONS:
            if self.here is None or self.here.text != "(":
                self.fail(f"the function {token} needs its argument in brackets", f"Write {token}(...)", column)
            self.bracket(depth)
            self.program.append(("function", token))
        elif token in CONSTANTS:
            self.program.append(("number", CONSTANTS[token]))
        elif token in self.names:
            self.used.add(token)
            self.program.append(("name", token))
        else:
            self.fail(f'"{token[:40]}" is unknown', nearest(token, [*sorted(self.names), *CONSTANTS, *FUNCTIONS]), column)


# Number of revolutions of the crank after which an expression of the crank angle repeats, from its form alone.

MOST_REVOLUTIONS = 24
"""Revolutions after which a cycle must end."""
SAME_PHASE = 1e-9  # rad by which an angle may miss a whole multiple of half a turn
ROUNDING = 1e-15  # of the sum of two slopes, below which they cancel one another
MOST_HALVES = 1e9  # half turns of an argument, above which its phase has lost its digits
PERIODIC = ("sin", "cos", "tan")
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
    part = _part_of(expression, "phi", 1.0, [])
    if part is None or part.slope:
        return None
    revolutions = part.repeated().revolutions
    return revolutions if revolutions <= MOST_REVOLUTIONS else None


def period_of(expression: Expression, name: str) -> tuple[float, float] | None:
    """Return the period of an expression in a variable, and the mean rate at which it grows; None if it does not repeat.

    The period of a straight line is 0: it repeats after any. The slowest of its sines, cosines and tangents stands for the
    crank in `revolutions_of`: at most `MOST_REVOLUTIONS` of its periods are one of the expression.
    """
    slopes: list[float] = []
    _part_of(expression, name, 1.0, slopes)
    slowest = min(slopes, default=1.0)
    part = _part_of(expression, name, 1.0 / slowest, [])
    if part is None or (part := part.repeated()).revolutions > MOST_REVOLUTIONS:
        return None
    return 2.0 * math.pi * part.revolutions / slowest if slopes else 0.0, part.slope * slowest


def _part_of(expression: Expression, name: str, slope: float, slopes: list[float]) -> _Part | None:
    """Return an expression as a part, its variable `name` with a slope; None if it does not repeat.

    The slopes of the arguments of its sines, cosines and tangents are appended to `slopes`.
    """
    stack: list[_Part | None] = []
    for kind, what in expression.program:
        if kind == "number":
            stack.append(_Part(constant=float(what)))
        elif kind == "name":
            stack.append(_Part(slope=slope if what == name else 0.0))
        else:
            parts = [stack.pop() for _ in range(2 if kind == "binary" else 1)]
            if what in PERIODIC and parts[0] is not None and parts[0].slope:
                slopes.append(abs(parts[0].slope))
            stack.append(_result(kind, what, [part for part in reversed(parts) if part is not None], len(parts)))
    return stack.pop()


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
        for times in range(1, MOST_REVOLUTIONS // part.revolutions + 1) if name in PERIODIC and abs(halves) < MOST_HALVES else ():
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
