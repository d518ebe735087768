"""Derivatives of elementary functions, with a bound of the third derivative over a range: the rules of Taylor models.

Every rule is a function of (centre, low, high), arrays of one shape; NaN where the function is undefined between low and high.
"""

from collections.abc import Callable

import numpy as np

from optlink.linkage.vector2d import Array

LIBRARY = 2.0**-48  # bounds the error of sin, cos, arctan (absolute) and exp, log, power (relative): at least 16 ulp
UPWARD = 1.0 + 2.0**-44  # makes up for the rounding of a remainder, a sum and product of fewer than 100 positive numbers

Derivatives = tuple[Array, Array, Array, Array]
"""Value, first and second derivative at the centre, and a bound of the size of the third over the range."""
Rule = Callable[[Array, Array, Array], Derivatives]


def _sqrt(x: Array, low: Array, high: Array) -> Derivatives:
    low = np.where(low > 0.0, low, np.nan)
    root = np.sqrt(x)
    return root, 0.5 / root, -0.25 / (root * x), 0.375 * UPWARD / (low * low * np.sqrt(low))


def _reciprocal(x: Array, low: Array, high: Array) -> Derivatives:
    inverse = 1.0 / x
    least = np.where(low > 0.0, low, np.where(high < 0.0, -high, np.nan))
    square = least * least
    return inverse, -inverse * inverse, 2.0 * inverse * inverse * inverse, 6.0 * UPWARD / (square * square)


def _sin(x: Array, low: Array, high: Array) -> Derivatives:
    s, c = np.sin(x), np.cos(x)
    return s, c, -s, np.ones_like(x)


def _cos(x: Array, low: Array, high: Array) -> Derivatives:
    s, c = np.sin(x), np.cos(x)
    return c, -s, -c, np.ones_like(x)


def _arctan(x: Array, low: Array, high: Array) -> Derivatives:
    w = 1.0 / (1.0 + x * x)
    return np.arctan(x), w, -2.0 * x * w * w, np.full_like(x, 2.0)


def _exp(x: Array, low: Array, high: Array) -> Derivatives:
    e = np.exp(x)
    return e, e, e, np.exp(high) * (1.0 + LIBRARY) * UPWARD


def _log(x: Array, low: Array, high: Array) -> Derivatives:
    low, inverse = np.where(low > 0.0, low, np.nan), 1.0 / x
    return np.log(x), inverse, -inverse * inverse, 2.0 * UPWARD / (low * low * low)


def power(p: float) -> Rule:
    """Return the rule of x**p."""

    def rule(x: Array, low: Array, high: Array) -> Derivatives:
        f, low = np.power(x, p), np.where(low > 0.0, low, np.nan)
        third = abs(p * (p - 1.0) * (p - 2.0)) * np.maximum(np.power(low, p - 3.0), np.power(high, p - 3.0))
        slope = p * f / x
        return f, slope, (p - 1.0) * slope / x, third * (1.0 + LIBRARY) * UPWARD

    return rule


DERIVATIVES: dict[np.ufunc, Rule] = {
    np.sqrt: _sqrt,
    np.reciprocal: _reciprocal,
    np.sin: _sin,
    np.cos: _cos,
    np.arctan: _arctan,
    np.exp: _exp,
    np.log: _log,
}
