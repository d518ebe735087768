"""Second-order jets: a value with its first and second time derivative, propagated through the position formulas.

Velocity and acceleration need no formulas of their own: a position formula evaluated with jets returns jets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from optlink.linkage.vector2d import Value

# a quantity that is not a jet is constant: its terms are omitted, not multiplied by zero


def _add(a: Value, b: Value) -> Jet:
    if not isinstance(b, Jet):
        return Jet(a.value + b, a.rate, a.acceleration)
    if not isinstance(a, Jet):
        return _add(b, a)
    return Jet(a.value + b.value, a.rate + b.rate, a.acceleration + b.acceleration)


def _subtract(a: Value, b: Value) -> Jet:
    if not isinstance(b, Jet):
        return Jet(a.value - b, a.rate, a.acceleration)
    if not isinstance(a, Jet):
        return Jet(a - b.value, -b.rate, -b.acceleration)
    return Jet(a.value - b.value, a.rate - b.rate, a.acceleration - b.acceleration)


def _multiply(a: Value, b: Value) -> Jet:
    if not isinstance(b, Jet):
        return Jet(a.value * b, a.rate * b, a.acceleration * b)
    if not isinstance(a, Jet):
        return _multiply(b, a)
    if a is b:
        return Jet(a.value * a.value, 2.0 * (a.value * a.rate), 2.0 * (a.rate * a.rate + a.value * a.acceleration))
    return Jet(
        a.value * b.value,
        a.rate * b.value + a.value * b.rate,
        a.rate * (2.0 * b.rate) + (a.acceleration * b.value + a.value * b.acceleration),
    )


def _divide(a: Value, b: Value) -> Jet:
    if not isinstance(b, Jet):
        return Jet(a.value / b, a.rate / b, a.acceleration / b)
    inverse = 1.0 / b.value
    if not isinstance(a, Jet):
        value = a * inverse
        rate = -value * b.rate * inverse
        return Jet(value, rate, (-2.0 * (rate * b.rate) - value * b.acceleration) * inverse)
    value = a.value / b.value
    rate = (a.rate - value * b.rate) * inverse
    return Jet(value, rate, (a.acceleration - 2.0 * (rate * b.rate) - value * b.acceleration) * inverse)


class Jet(NDArrayOperatorsMixin):
    """Truncated Taylor series in time.

    A quantity that is not a Jet is constant in time. Functions without a rule raise TypeError (numpy's own message).

    Parameters
    ----------
    value, rate, acceleration : Value, broadcastable
        The quantity and its first and second derivative with respect to time.
    """

    __slots__ = ("acceleration", "rate", "value")

    def __init__(self, value: Value, rate: Value = 0.0, acceleration: Value = 0.0) -> None:
        self.value, self.rate, self.acceleration = value, rate, acceleration

    @property
    def parts(self) -> tuple[Value, Value, Value]:
        """Value, rate and acceleration."""
        return self.value, self.rate, self.acceleration

    def __repr__(self) -> str:
        return f"Jet({self.value!r}, {self.rate!r}, {self.acceleration!r})"

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or kwargs:
            return NotImplemented
        if ufunc in _CHAIN:
            x = inputs[0]
            value = ufunc(x.value)
            first, second = _CHAIN[ufunc](x.value, value)
            return Jet(value, first * x.rate, first * x.acceleration + second * x.rate * x.rate)
        rule = _RULES.get(ufunc)
        return NotImplemented if rule is None else rule(*inputs)

    # direct operators bypass numpy's dispatch, which is half of the cost of a jet of a few hundred positions

    __add__, __sub__, __mul__, __truediv__ = _add, _subtract, _multiply, _divide
    __radd__, __rmul__ = _add, _multiply

    def __rsub__(self, other: Value) -> Jet:
        return _subtract(other, self)

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.rate, -self.acceleration)


def as_jet(x: Value) -> Jet:
    """Return a jet unchanged, and any other value as one that is constant in time."""
    return x if isinstance(x, Jet) else Jet(x)


def _arctan2(y: Value, x: Value) -> Jet:
    y, x = as_jet(y), as_jet(x)
    square = x.value * x.value + y.value * y.value
    rate = (x.value * y.rate - y.value * x.rate) / square
    change = 2.0 * (x.value * x.rate + y.value * y.rate)  # of the squared radius
    acceleration = (x.value * y.acceleration - y.value * x.acceleration - change * rate) / square
    return Jet(np.arctan2(y.value, x.value), rate, acceleration)


def _power(base: Value, exponent: Value) -> Jet:
    if isinstance(exponent, Jet):  # only a variable exponent needs log(base)
        return np.exp(exponent * np.log(base))  # type: ignore[no-any-return]
    n = exponent
    if isinstance(n, float | int) and n in (0, 1, 2):  # where the general rule would multiply zero by infinity at zero
        return (Jet(np.power(base.value, n)), base, base * base)[int(n)]
    first = n * np.power(base.value, n - 1.0)
    second = n * (n - 1.0) * np.power(base.value, n - 2.0)
    return Jet(np.power(base.value, n), first * base.rate, first * base.acceleration + second * base.rate * base.rate)


_RULES: dict[np.ufunc, Callable[..., Jet]] = {
    np.add: _add,
    np.subtract: _subtract,
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.multiply: _multiply,
    np.divide: _divide,
    np.arctan2: _arctan2,
    np.power: _power,
}

# f -> (f', f'') from the argument x and the value f(x)
_CHAIN: dict[np.ufunc, Callable[[Value, Value], tuple[Value, Value]]] = {
    np.sqrt: lambda x, f: (0.5 / f, -0.25 / (f * x)),
    np.square: lambda x, f: (2.0 * x, 2.0),
    np.sin: lambda x, f: (np.cos(x), -f),
    np.cos: lambda x, f: (-np.sin(x), -f),
    np.tan: lambda x, f: (1.0 + f * f, 2.0 * f * (1.0 + f * f)),
    np.arcsin: lambda x, f: (1.0 / np.sqrt(1.0 - x * x), x / (1.0 - x * x) / np.sqrt(1.0 - x * x)),
    np.arccos: lambda x, f: (-1.0 / np.sqrt(1.0 - x * x), -x / (1.0 - x * x) / np.sqrt(1.0 - x * x)),
    np.arctan: lambda x, f: (1.0 / (1.0 + x * x), -2.0 * x / ((1.0 + x * x) * (1.0 + x * x))),
    np.sinh: lambda x, f: (np.cosh(x), f),
    np.cosh: lambda x, f: (np.sinh(x), f),
    np.tanh: lambda x, f: (1.0 - f * f, -2.0 * f * (1.0 - f * f)),
    np.exp: lambda x, f: (f, f),
    np.log: lambda x, f: (1.0 / x, -1.0 / (x * x)),
    np.log10: lambda x, f: (1.0 / (x * np.log(10.0)), -1.0 / (x * x * np.log(10.0))),
    np.absolute: lambda x, f: (np.sign(x), 0.0),
    np.sign: lambda x, f: (0.0, 0.0),
}
