"""Linked quantities: dimensions that follow from others of the file, such as `rocker = { equals = "0.5*coupler + 3 mm" }`.

A linked quantity is neither a design variable nor a fixed parameter. Its expression has the names of other quantities, numbers
with and without units, and the operators and functions of motion laws; it is checked for its physical kind.
"""

import graphlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from optlink.errors import InvalidValue
from optlink.linkage.vector2d import Value
from optlink.problem.quantity import LONGEST, SHORTEST, Quantity, Unusable
from optlink.problem.targets.expression import Expression, Wording, operation, parse
from optlink.units import factor, kind_of_unit, plain, show, with_article

LINK = Wording("link", "0.5*coupler + 3 mm", of_quantities=True)
TWIN = {"phi0": "start", "start": "phi0", "zero": "psi0"}
"""Other names of the start angle of a requirement, and of the output there, which a link may use as well."""


@dataclass(frozen=True)
class Link:
    """The expression of a linked quantity.

    `numbers`: its numbers with units [SI]; `names`: quantities by their names in it; `positive`: whether it is a sum, product
    or ratio of lengths and positive numbers, which are above zero.
    """

    expression: Expression
    numbers: Mapping[str, float]
    names: Mapping[str, str]
    positive: bool

    def __call__(self, values: Mapping[str, Value]) -> Value:
        """Return the value [SI] for those of the other quantities; elementwise, NaN or infinity where it is undefined."""
        return self.expression({**self.numbers, **{name: values[quantity] for name, quantity in self.names.items()}})


def states_links(raw: Any) -> bool:
    """Return whether nested tables of a file have a link."""
    if isinstance(raw, list):
        return any(map(states_links, raw))
    return isinstance(raw, Mapping) and ("equals" in raw or any(map(states_links, raw.values())))


def links_of(quantities: Mapping[str, Quantity]) -> dict[str, Link]:
    """Return the links by the names of the linked quantities, each after those from which it follows.

    Raises
    ------
    Unusable
        whose key is the name of the quantity.
    """
    links = {name: _link(name, quantity, quantities) for name, quantity in quantities.items() if quantity.equals}
    order = graphlib.TopologicalSorter({name: set(link.names.values()) & set(links) for name, link in links.items()})
    try:
        return {name: links[name] for name in order.static_order()}
    except graphlib.CycleError as error:
        first, *others = reversed(error.args[1][1:])  # each follows from the next
        message = f"{first} follows from itself, by way of {' and '.join(others)}"
        raise Unusable(message, "Give one of them a value or bounds", first, quantities[first].equals) from None


def _link(name: str, quantity: Quantity, quantities: Mapping[str, Quantity]) -> Link:
    text = str(quantity.equals)

    def refuse(message: str, remedy: str) -> NoReturn:
        raise Unusable(message, remedy, name, text)

    twins = {twin: one for one, twin in TWIN.items() if one in quantities}
    known = {one: one for one in quantities} | twins
    try:
        expression = parse(plain(text), known, LINK)
    except InvalidValue as error:
        refuse(error.message, error.remedy)
    numbers, kinds = {}, {one: quantities[of].kind for one, of in known.items()}
    for term in sorted(expression.names - set(known)):
        number, unit = term.split(" ", 1)
        kind = kind_of_unit(unit)
        if kind not in ("length", "angle"):
            refuse(f'"{term}" is neither a length nor an angle', "Use a unit of length or angle, such as mm or deg")
        numbers[term], kinds[term] = float(number) * factor(unit, kind), kind
    names = {one: known[one] for one in sorted(expression.names & set(known))}
    if not names:
        refuse("the link names no other quantity", f'Give a value without "equals", or name one of: {", ".join(quantities)}')
    if name in names.values():
        refuse(f"{name} follows from itself", "Name other quantities")
    if not expression.constants_finite:
        refuse("a part without names has no finite value", "Check its divisors, roots and logarithms")
    try:
        result = _kind(expression, kinds)
    except _Mixed as error:
        refuse(*error.args)
    if not result.fits(quantity.kind):
        remedy = f'Write one with its kind, such as "{"180 deg - start" if quantity.kind == "angle" else LINK.example}"'
        refuse(f"the link is {result}, and {name} is {with_article(quantity.kind)}", remedy)
    positive = all(
        (step == "name" and (what in numbers or kinds[what] == "length"))
        or (step == "number" and what > 0.0)
        or (step == "binary" and what != "-")
        or (step, what) == ("function", "sqrt")
        for step, what in expression.program
    )
    return Link(expression, numbers, names, positive)


class _Mixed(Exception):
    """Kinds that do not fit together: message and remedy."""


NUMBER, ANGLE, EITHER = "a number", "an angle", "pi"


@dataclass(frozen=True)
class _Kind:
    """A physical kind: the exponent of length; a number, an angle or, as pi, either; `value`: of a constant number."""

    length: float
    turn: str = NUMBER
    value: float | None = None

    def __str__(self) -> str:
        if self.length == 0.0:
            return NUMBER if self.turn == EITHER else self.turn
        return {1.0: "a length", 2.0: "an area"}.get(self.length, f"a length to the power of {self.length:g}")

    def fits(self, kind: str) -> bool:
        """Return whether it is the kind of a quantity."""
        if kind in ("angle", "ratio"):
            return self.length == 0.0 and self.turn != (NUMBER if kind == "angle" else ANGLE)
        return math.isclose(self.length, 1.0)


def _kind(expression: Expression, kinds: Mapping[str, str]) -> _Kind:
    """Return the physical kind of an expression of names with these kinds.

    Raises
    ------
    _Mixed
    """
    stack: list[_Kind] = []
    for step, what in expression.program:
        if step == "number":
            stack.append(_Kind(0.0, EITHER if what == math.pi else NUMBER, what))
        elif step == "name":
            stack.append({"angle": _Kind(0.0, ANGLE), "ratio": _Kind(0.0)}.get(kinds[what], _Kind(1.0)))
        else:
            parts = list(reversed([stack.pop() for _ in range(2 if step == "binary" else 1)]))
            constants = [part.value for part in parts if part.value is not None]
            kind = _of_sign(what, *parts) if step == "binary" else _of_function(what, *parts) if step == "function" else parts[0]
            stack.append(replace(kind, value=operation(step, what, constants) if len(constants) == len(parts) else None))
    return stack.pop()


def _of_function(name: str, kind: _Kind) -> _Kind:
    if name == "abs":
        return kind
    if name == "sqrt":
        return _Kind(0.5 * kind.length)
    if name in ("sin", "cos", "tan"):
        if not kind.fits("angle"):
            raise _Mixed(f"{name} is taken of {kind}", f"Give it an angle with its unit, for example {name}(30 deg)")
        return _Kind(0.0)
    if kind.length or kind.turn == ANGLE:
        raise _Mixed(f"{name} is taken of {kind}", "Give it a ratio, for example crank/frame")
    return _Kind(0.0, ANGLE if name.startswith("a") else NUMBER)


def _of_sign(sign: str, left: _Kind, right: _Kind) -> _Kind:
    turns = {left.turn, right.turn}
    if sign in "+-":
        if not math.isclose(left.length, right.length) or (left.length == 0.0 and turns == {NUMBER, ANGLE}):
            remedy, named = "Add quantities of one kind", [str(left), str(right)]
            if NUMBER in named:
                remedy = f"Give the number a unit, for example {'40 deg' if ANGLE in named else '3 mm'}"
            raise _Mixed(f"{named[0]} and {named[1]} are {'added' if sign == '+' else 'subtracted'}", remedy)
        return _Kind(left.length, next((turn for turn in (ANGLE, NUMBER) if turn in turns), EITHER))
    if sign == "^":
        if right.length or right.turn == ANGLE or (right.value is None and left.length):
            raise _Mixed(f"{left} has an exponent that is not a plain number", "Write a number, for example 2")
        return _Kind(left.length * (right.value or 0.0) if left.length else 0.0)
    length = left.length + (right.length if sign == "*" else -right.length)
    turn = left.turn if sign == "/" else EITHER if EITHER in turns else NUMBER
    turn = NUMBER if turns == {ANGLE} else ANGLE if ANGLE in turns else turn
    return _Kind(0.0 if abs(length) < 1e-12 else length, turn)


def check_linked(name: str, quantity: Quantity, value: float) -> None:
    """Refuse the value [SI] of a linked quantity at the start of the design variables if no linkage can have it.

    Raises
    ------
    Unusable
    """
    remedy = "Change the link, or the values from which it follows"
    if not np.isfinite(value):
        raise Unusable(f"{name} has no finite value where the quantities start", remedy)
    if quantity.kind == "length" and not SHORTEST <= value <= LONGEST:
        message = f"{name} is {show(value, 'length', quantity.unit)} where the quantities start"
        raise Unusable(message, remedy)
