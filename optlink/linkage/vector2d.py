"""Functions that numpy lacks: of arrays, and elementwise ones for floats, arrays, complex steps, casadi symbols and jets."""

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of floats."""

Value: TypeAlias = Any
"""A float, an array of any broadcastable shape, a casadi symbol or a Jet; the formulas accept all of them."""

Vector: TypeAlias = tuple[Value, Value]
"""x and y of a point or a direction, each a Value."""

TURN = 2.0 * math.pi
"""A revolution [rad]."""

np.empty(1_000_000)  # freed at once: from now on glibc keeps up to 16 MB of freed arrays, whose pages need not be mapped anew


def all_finite(values: ArrayLike) -> bool:
    """Return whether all values are finite numbers."""
    return bool(np.all(np.isfinite(values)))


def max_magnitude(values: ArrayLike) -> float:
    """Return the largest magnitude of some values, 0 of none."""
    return float(np.max(np.abs(values), initial=0.0))


def finite_or(values: Array, other: float) -> Array:
    """Return the values, with another one in place of those that are not finite."""
    return np.where(np.isfinite(values), values, other)


def wrapped(angles: Array) -> Array:
    """Return angles [rad] less whole revolutions: from -pi to pi."""
    return np.remainder(angles + math.pi, TURN) - math.pi


def whole_turns(rotation: float) -> int:
    """Return the number of revolutions that a rotation [rad] is closest to, at least one."""
    return max(1, round(rotation / TURN))


def root(x: Value) -> Value:
    """Return the square root, NaN without a warning where x < 0; nothing is clipped."""
    with np.errstate(invalid="ignore"):
        return np.sqrt(x)


def _complex(x: Value) -> bool:
    return isinstance(x, np.ndarray | np.generic | complex) and bool(np.iscomplexobj(x))


def real(x: Value) -> Value:
    """Return the real part of complex numbers, and any other value unchanged."""
    return np.real(x) if _complex(x) else x


def magnitude(x: Value) -> Value:
    """Return the absolute value; for a complex step its analytic continuation, because numpy's would drop the step."""
    return np.where(np.real(x) < 0.0, -x, x) if _complex(x) else np.abs(x)


def sign(x: Value) -> Value:
    """Return -1, 0 or 1; for a complex step the sign of the real part, because numpy's would keep the step."""
    return np.sign(np.real(x)) if _complex(x) else np.sign(x)


def angle(v: Vector) -> Value:
    """Return the angle of the direction v from +x, counter-clockwise [rad], in (-pi, pi].

    numpy's arctan2 does not accept complex numbers; for a complex step the analytic continuation about the real direction is
    used.
    """
    x, y = v
    if _complex(x) or _complex(y):
        real = np.arctan2(np.real(y), np.real(x))
        c, s = np.cos(real), np.sin(real)
        return real + np.arctan((c * y - s * x) / (c * x + s * y))
    return np.arctan2(y, x)


def turn(v: Vector, by: Vector) -> Vector:
    """Rotate the direction v by the angle of a unit vector (complex product)."""
    return v[0] * by[0] - v[1] * by[1], v[0] * by[1] + v[1] * by[0]


def turn_back(v: Vector, by: Vector) -> Vector:
    """Rotate the direction v back by the angle of a unit vector: the inverse of `turn`."""
    return v[0] * by[0] + v[1] * by[1], v[1] * by[0] - v[0] * by[1]


def dot(a: Vector, b: Vector) -> Value:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1]


def cross(a: Vector, b: Vector) -> Value:
    """Return the z component of the vector product.

    With a lever a and a force b it is the moment, positive counter-clockwise.
    """
    return a[0] * b[1] - a[1] * b[0]


def plus(a: Vector, b: Vector) -> Vector:
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1]


def minus(a: Vector, b: Vector) -> Vector:
    """Return the difference a - b, the vector from b to a."""
    return a[0] - b[0], a[1] - b[1]


def angle_from(reference: Vector, v: Vector) -> Value:
    """Return the angle from `reference` to `v`, counter-clockwise [rad], in (-pi, pi].

    Two close directions are never separated by the branch cut.
    """
    return angle((dot(reference, v), cross(reference, v)))


def unit(phi: Value) -> Vector:
    """Return the unit vector at the angle phi [rad]."""
    return np.cos(phi), np.sin(phi)
