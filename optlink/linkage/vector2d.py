"""The few elementwise functions that numpy lacks, for floats, arrays, complex steps, casadi symbols and jets alike."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

Value: TypeAlias = Any
"""A float, an array of any broadcastable shape, a casadi symbol or a Jet: the formulas do not care."""

Vector: TypeAlias = tuple[Value, Value]
"""x and y of a point or a direction, each a Value."""


def root(x: Value) -> Value:
    """Square root that is NaN, silently, where x < 0: the caller's margin tells, nothing is clipped."""
    with np.errstate(invalid="ignore"):
        return np.sqrt(x)


def _complex(x: Value) -> bool:
    return isinstance(x, np.ndarray | np.generic | complex) and bool(np.iscomplexobj(x))


def magnitude(x: Value) -> Value:
    """Absolute value; under a complex step its analytic continuation, where numpy's would forget the step."""
    return np.where(np.real(x) < 0.0, -x, x) if _complex(x) else np.abs(x)


def sign(x: Value) -> Value:
    """-1, 0 or 1; under a complex step that of the real part, where numpy's would keep the step."""
    return np.sign(np.real(x)) if _complex(x) else np.sign(x)


def angle(v: Vector) -> Value:
    """Angle of the direction v from +x, counter-clockwise [rad], in (-pi, pi].

    numpy's arctan2 knows no complex numbers; for a complex step the analytic continuation about the real direction is used.
    """
    x, y = v
    if _complex(x) or _complex(y):
        real = np.arctan2(np.real(y), np.real(x))
        c, s = np.cos(real), np.sin(real)
        return real + np.arctan((c * y - s * x) / (c * x + s * y))
    return np.arctan2(y, x)


def turn(v: Vector, by: Vector) -> Vector:
    """Rotate the direction v by the angle whose unit vector is `by` (complex product)."""
    return v[0] * by[0] - v[1] * by[1], v[0] * by[1] + v[1] * by[0]


def turn_back(v: Vector, by: Vector) -> Vector:
    """Rotate the direction v back by the angle whose unit vector is `by`: what `turn` undoes."""
    return v[0] * by[0] + v[1] * by[1], v[1] * by[0] - v[0] * by[1]


def dot(a: Vector, b: Vector) -> Value:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1]


def cross(a: Vector, b: Vector) -> Value:
    """Vector product: the moment of the force b at the lever a, positive counter-clockwise."""
    return a[0] * b[1] - a[1] * b[0]


def plus(a: Vector, b: Vector) -> Vector:
    """Sum."""
    return a[0] + b[0], a[1] + b[1]


def minus(a: Vector, b: Vector) -> Vector:
    """Difference: from b to a."""
    return a[0] - b[0], a[1] - b[1]


def angle_from(reference: Vector, v: Vector) -> Value:
    """Angle from `reference` to `v`, counter-clockwise [rad], in (-pi, pi]: no branch cut between two close directions."""
    return angle((reference[0] * v[0] + reference[1] * v[1], reference[0] * v[1] - reference[1] * v[0]))


def unit(phi: Value) -> Vector:
    """Unit vector at the angle phi [rad]."""
    return np.cos(phi), np.sin(phi)
