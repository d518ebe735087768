"""Complex numbers of about 32 digits, as pairs of floats, and the equations of four-bars in them.

References
----------
T. J. Dekker, Numer. Math. 18 (1971) 224-242.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Pair:
    """Complex numbers as sums of two arrays, of which the second one is the rounding error of the first."""

    high: Complex
    low: Any = 0.0

    def __getitem__(self, index: Any) -> "Pair":
        return Pair(self.high[index], self.low[index])

    def __add__(self, other: "Pair") -> "Pair":
        total = self.high + other.high
        part = total - self.high
        error = (self.high - (total - part)) + (other.high - part)
        return _normal(total, error + (self.low + other.low))

    def __neg__(self) -> "Pair":
        return Pair(-self.high, -self.low)

    def __sub__(self, other: "Pair") -> "Pair":
        return self + -other

    def conjugate(self) -> "Pair":
        """Return the conjugates."""
        return Pair(np.conj(self.high), np.conj(self.low))

    def __truediv__(self, other: "Pair") -> "Pair":
        near = Pair(1.0 / other.high)
        return self * (near + near * (Pair(np.ones(1, complex)) - near * other))

    def __mul__(self, other: "Pair") -> "Pair":
        p, q = self.high, other.high
        real, imag = _product(p.real, q.real), _product(p.real, q.imag)
        both = _normal(real[0] + 1j * imag[0], real[1] + 1j * imag[1])
        real, imag = _product(p.imag, q.imag), _product(p.imag, q.real)
        return both + _normal(-real[0] + 1j * imag[0], -real[1] + 1j * imag[1] + (p * other.low + self.low * q))


def _normal(high: Complex, low: Complex) -> Pair:
    total = high + low
    return Pair(total, low - (total - high))


def _product(a: Array, b: Array) -> tuple[Array, Array]:
    """Return products and their rounding errors."""
    p = a * b
    big, large = a * 134217729.0, b * 134217729.0
    a_high, b_high = big - (big - a), large - (large - b)
    a_low, b_low = a - a_high, b - b_high
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


def closure(x: Any, xb: Any, u: Any, ub: Any, d: Any, e: Any, t: Any, one: Any, minus: Any) -> Any:
    """Return the equations of `homotopy` times 1 + t, for numbers of any kind."""
    p, more = d + t * x, one + t
    return p * ub * more + (u + p) * (e * more + t * xb * minus)
