"""Function generation: y(x), where x is proportional to the crank angle and y to the output, each over its range."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Value
from optlink.problem.quantity import Unusable, below, check_keys, check_pair, is_number, read_scalar
from optlink.problem.targets.expression import Expression, LawError, parse

KEYS = ("function", "x", "input", "output")
EXAMPLE = 'law = { function = "log10(x)", x = [1, 2], input = "60 deg", output = "60 deg" }'
GRID = 2001  # values of x at which y is evaluated to find its range


@dataclass(frozen=True)
class Function:
    """A function y(x) for `low` <= x <= `high`, generated in a crank rotation `input` [rad].

    The output moves by `output` [rad or m] from the least to the largest value of y. It is a law of the crank angle: prescribed
    output = psi0 + output * (y(x) - least y) / (largest y - least y), where psi0 is the output at the least y.
    """

    expression: Expression
    low: float
    high: float
    input: float
    output: float
    kind: str = "angle"  # of the output: or "coordinate"
    names: frozenset[str] = field(default=frozenset({"phi", "phi0", "psi0"}), repr=False)

    @property
    def text(self) -> str:
        """The function for display."""
        return f"y = {self.expression.text}, x = {self.low:g} ... {self.high:g}"

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Least and largest y, refined between the values of a grid."""
        x = np.linspace(self.low, self.high, GRID)
        y = np.asarray(self.expression({"x": x}) + 0.0 * x, dtype=float)
        values = []
        for sign in (1.0, -1.0):
            i = int(np.argmin(sign * y))
            near = np.linspace(x[max(i - 1, 0)], x[min(i + 1, GRID - 1)], GRID)
            values.append(sign * float(np.min(sign * np.asarray(self.expression({"x": near}) + 0.0 * near, dtype=float))))
        return values[0], values[1]

    def rise(self, offset: Value) -> Value:
        """Return the prescribed output [rad or m] above that of the least y at a crank rotation [rad]; elementwise."""
        least, largest = self.ends
        x = self.low + (self.high - self.low) / self.input * offset
        return (self.expression({"x": x}) - least) * (self.output / (largest - least))

    def __call__(self, values: Mapping[str, Value]) -> Value:
        """Return the prescribed output for phi, phi0 and psi0."""
        return values["psi0"] + self.rise(values["phi"] - values["phi0"])

    def hazards(self, values: Mapping[str, Value]) -> str | None:
        """Return the defect of the function along the range, or None; see `Expression.hazards`."""
        return self.expression.hazards({"x": self.low + (self.high - self.low) / self.input * (values["phi"] - values["phi0"])})


def read_function(raw: Mapping[str, Any], kind: str = "angle") -> Function:
    """Read a function from its table; the kind of the output is "angle" or "coordinate".

    Raises
    ------
    Unusable
        with the key of the cause.
    """
    check_keys(raw, KEYS)
    for key in KEYS:
        if key not in raw:
            raise Unusable("the function needs this key", f"Write {EXAMPLE}", key)
    if not isinstance(raw["function"], str):
        raise Unusable("a function is text", f"Write {EXAMPLE}", "function", raw["function"])
    with below("function", raw["function"]):
        expression = parse(raw["function"], ("x",))
    bounds = raw["x"]
    check_pair(bounds, "the range of x is a list of two numbers", 'Write x = [1, 2], or x = ["0 deg", "90 deg"]', "x")
    low, high = (_bound(bound, k) for k, bound in enumerate(bounds))
    if not low < high:
        raise Unusable("the range of x must rise", "Exchange its ends; a negative input turns the crank clockwise", "x", bounds)
    turned = read_scalar(raw["input"], "angle", "input")[0]
    if not 1e-6 <= abs(turned) <= 2.0 * math.pi * (1.0 + 1e-9):
        raise Unusable(
            "the crank rotation must not be zero or exceed one revolution", 'Write input = "60 deg"', "input", raw["input"]
        )
    output = read_scalar(raw["output"], kind, "output")[0]
    if output == 0.0:
        raise Unusable("the output range must not be zero", 'Write output = "60 deg"', "output", raw["output"])
    function = Function(expression, low, high, turned, output, kind)
    span = {"phi": turned * np.linspace(0.0, 1.0, GRID), "phi0": 0.0, "psi0": 0.0}
    worry = function.hazards(span)
    if worry:
        message = f"the function {worry} between x = {low:g} and {high:g}"
        raise Unusable(message, "Change the function or its range", "function", expression.text)
    least, largest = function.ends
    if not math.isfinite(largest - least) or largest - least <= 1e-12 * max(abs(least), abs(largest), 1e-300):
        raise Unusable("the function is constant there", "Choose a function that varies", "function", expression.text)
    return function


def _bound(raw: object, index: int) -> float:
    if isinstance(raw, str):
        try:
            return float(parse(raw, ())({}))
        except LawError:
            return read_scalar(raw, "angle", f"x[{index}]")[0]
    if not is_number(raw) or not math.isfinite(raw):
        raise Unusable("expected a plain number", "Write x = [1, 2]", f"x[{index}]", raw)
    return float(raw)
