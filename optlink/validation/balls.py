"""Quantities over a box of designs in ball arithmetic (Arb): value, gradient and Hessian, each with a proven error bound.

The formulas of `linkage` pass a `Ball` on as they pass on floats. The unknowns are scaled: a design of the box has coordinates
d_1 ... d_n from -1 to 1, and all derivatives are with respect to them. Every operation carries the value and the gradient at one
design, the centre, and enclosures of value, gradient and Hessian over the whole box (forward mode). So there are two enclosures:
the value itself, and the Taylor form centre + slope . d + d' Hessian d / 2; the nonlinear rules use the intersection of both.

References
----------
F. Johansson, Arb: efficient arbitrary-precision midpoint-radius interval arithmetic, IEEE Transactions on Computers 66 (2017)
1281-1292. A. Neumaier, Interval Methods for Systems of Equations, Cambridge 1990, sections 2.3 and 2.4 (Taylor forms).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from flint import arb, arb_mat
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

BITS = 100  # precision of the arithmetic; a double has 53
UNIT = arb(0, 1)  # -1 ... 1
INTEGER_POWERS = 16  # largest integer exponent that is expanded into products
DESCENT = 8  # rounds of coordinate descent towards the minimum of a quadratic form
NAN = arb("nan")


class Ball(NDArrayOperatorsMixin):
    """A quantity over a box, NaN where it is undefined somewhere in it. Without derivatives it is the same in the whole box.

    Parameters
    ----------
    centre, value : arb
        At the centre, and over the box.
    slope, gradient : arb_mat (1, n), optional
        At the centre, and over the box.
    hessian : arb_mat (n, n), optional
        Over the box.
    """

    __slots__ = ("_range", "centre", "gradient", "hessian", "slope", "value")

    def __init__(self, centre: Any, value: Any, slope: Any = None, gradient: Any = None, hessian: Any = None) -> None:
        self.centre, self.value = centre, value
        self.slope, self.gradient, self.hessian = slope, gradient, hessian
        self._range: Any = None

    def __repr__(self) -> str:
        return f"Ball({self.value})"

    @staticmethod
    def constant(value: Any) -> Ball:
        """Return a number, exactly that of the float."""
        value = arb(float(value)) if not isinstance(value, arb) else value
        return Ball(value, value)

    @staticmethod
    def unknown(index: int, count: int, at: float, scale: Any, *, over: bool = True) -> Ball:
        """Return an unknown.

        Parameters
        ----------
        index, count : int
            Which of how many.
        at : float
            Centre.
        scale : arb
            Half width of the box.
        over : bool
            Whether it varies over the box; else it stays at the centre, and the derivatives are those there.
        """
        slope = arb_mat(1, count, [scale if k == index else 0 for k in range(count)])
        centre = arb(at)
        return Ball(centre, centre + scale * UNIT if over else centre, slope, slope, arb_mat(count, count))

    @property
    def known(self) -> bool:
        """Whether it is defined over the whole box, with its derivatives."""
        return bool(self.value.is_finite()) and (self.slope is None or all(x.is_finite() for x in self.hessian.entries()))

    @property
    def range(self) -> Any:
        """Enclosure of the value: the intersection of the value and the Taylor form."""
        if self._range is None:
            self._range = self.value
            if self.slope is not None:
                second = arb(0)
                for x in self.hessian.entries():
                    second += x.abs_upper()
                size = second / 2
                for x in self.slope.entries():
                    size += x.abs_upper()
                taylor = self.centre + size.upper() * UNIT
                if taylor.is_finite() and self.value.is_finite():
                    self._range = self.value.intersection(taylor)
        return self._range

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        rule = _RULES.get(ufunc)
        if method != "__call__" or kwargs or rule is None:
            return NotImplemented
        return rule(*inputs)

    # direct operators bypass numpy's dispatch

    def __neg__(self) -> Ball:
        if self.slope is None:
            return Ball(-self.centre, -self.value)
        return Ball(-self.centre, -self.value, -self.slope, -self.gradient, -self.hessian)

    def __add__(self, other: Any) -> Ball:
        return _add(self, other)

    def __radd__(self, other: Any) -> Ball:
        return _add(self, other)

    def __sub__(self, other: Any) -> Ball:
        return _add(self, -_ball(other))

    def __rsub__(self, other: Any) -> Ball:
        return _add(-self, other)

    def __mul__(self, other: Any) -> Ball:
        return _multiply(self, other)

    def __truediv__(self, other: Any) -> Ball:
        return _divide(self, other)

    def __rmul__(self, other: Any) -> Ball:
        return _multiply(self, other)


def _ball(x: Any) -> Ball:
    return x if isinstance(x, Ball) else Ball.constant(x)


def _add(a: Any, b: Any) -> Ball:
    a, b = _ball(a), _ball(b)
    centre, value = a.centre + b.centre, a.value + b.value
    if a.slope is None or b.slope is None:
        other = b if a.slope is None else a
        return Ball(centre, value, other.slope, other.gradient, other.hessian)
    return Ball(centre, value, a.slope + b.slope, a.gradient + b.gradient, a.hessian + b.hessian)


def _multiply(a: Any, b: Any) -> Ball:
    square = a is b
    a, b = _ball(a), _ball(b)
    if b.slope is None:
        a, b = b, a
    if a.slope is None:
        factor = a.value
        if b.slope is None:
            return Ball.constant(factor * b.value)
        return Ball(factor * b.centre, factor * b.value, b.slope * factor, b.gradient * factor, b.hessian * factor)
    x, y = a.range, b.range
    outer = a.gradient.transpose() * b.gradient
    if square:
        hessian = (a.hessian * x + outer) * 2
        slope, gradient, value = a.slope * (2 * a.centre), a.gradient * (2 * x), (x * x).nonnegative_part()
    else:
        hessian = a.hessian * y + b.hessian * x + outer + outer.transpose()
        slope, gradient, value = a.slope * b.centre + b.slope * a.centre, a.gradient * y + b.gradient * x, x * y
    return Ball(a.centre * b.centre, value, slope, gradient, hessian)


Derivatives = Callable[[Any], tuple[Any, Any, Any]]
"""arb -> value, first and second derivative, each of them NaN where it is undefined."""


def _compose(x: Any, rule: Derivatives) -> Ball:
    x = _ball(x)
    centre, first, _ = rule(x.centre)
    if x.slope is None:
        return Ball.constant(centre)
    value, over, second = rule(x.range)
    hessian = x.hessian * over + (x.gradient.transpose() * x.gradient) * second
    return Ball(centre, value, x.slope * first, x.gradient * over, hessian)


def _sqrt(x: Any) -> tuple[Any, Any, Any]:
    root = x.sqrt()
    return root, 1 / (2 * root), -1 / (4 * root * x)


def _reciprocal(x: Any) -> tuple[Any, Any, Any]:
    inverse = 1 / x
    return inverse, -inverse * inverse, 2 * inverse * inverse * inverse


def _sin(x: Any) -> tuple[Any, Any, Any]:
    s, c = x.sin_cos()
    return s, c, -s


def _cos(x: Any) -> tuple[Any, Any, Any]:
    s, c = x.sin_cos()
    return c, -s, -c


def _arctan(x: Any) -> tuple[Any, Any, Any]:
    w = 1 / (1 + (x * x).nonnegative_part())
    return x.atan(), w, -2 * x * w * w


def _arcsin(x: Any) -> tuple[Any, Any, Any]:
    square = 1 - x * x
    first = 1 / square.sqrt()
    return x.asin(), first, x * first / square


def _exp(x: Any) -> tuple[Any, Any, Any]:
    e = x.exp()
    return e, e, e


def _log(x: Any) -> tuple[Any, Any, Any]:
    inverse = 1 / x
    return x.log(), inverse, -inverse * inverse


def _sinh(x: Any) -> tuple[Any, Any, Any]:
    s, c = x.sinh_cosh()
    return s, c, s


def _cosh(x: Any) -> tuple[Any, Any, Any]:
    s, c = x.sinh_cosh()
    return c, s, c


def _tanh(x: Any) -> tuple[Any, Any, Any]:
    t = x.tanh()
    first = 1 - t * t
    return t, first, -2 * t * first


def _divide(a: Any, b: Any) -> Ball:
    return _multiply(a, _compose(b, _reciprocal))


def _power(base: Any, exponent: Any) -> Ball:
    if isinstance(exponent, Ball):
        return _compose(exponent * _compose(base, _log), _exp)
    n = float(exponent)
    if n != int(n) or abs(n) > INTEGER_POWERS:
        return _compose(n * _compose(base, _log), _exp)
    if n == 0.0:
        return Ball.constant(1.0)
    result = base
    for k in range(abs(int(n)) - 1):
        result = _multiply(result, base) if k else _multiply(base, base)
    return _compose(result, _reciprocal) if n < 0 else result


_principal: list[bool] = []


@contextlib.contextmanager
def principal_angles() -> Iterator[None]:
    """Let angles of directions be undefined, not continuous, where the box crosses the negative x axis."""
    _principal.append(True)
    try:
        yield
    finally:
        _principal.pop()


def _arctan2(y: Any, x: Any) -> Ball:
    """Angle of the direction (x, y), continuous over the box; beyond -pi ... pi where the box crosses the negative x axis."""
    y, x = _ball(y), _ball(x)
    about = math.atan2(float(y.centre), float(x.centre))
    if not math.isfinite(about):
        return _unknown(NAN, NAN, x, y)
    s, c = arb(about).sin_cos()
    along, across = x * c + y * s, y * c - x * s
    if not along.range > 0:
        return _unknown(NAN, NAN, x, y)
    result = _add(about, _compose(_divide(across, along), _arctan))
    if _principal and not (result.range < arb.pi() and result.range > -arb.pi()):
        return _unknown(NAN, NAN, x, y)
    return result


def _unknown(centre: Any, value: Any, *like: Ball) -> Ball:
    """Return a quantity without known derivatives, a constant if those that it depends on are."""
    count = max((ball.slope.ncols() for ball in like if ball.slope is not None), default=0)
    if not count:
        return Ball.constant(value)
    row, square = (arb_mat(rows, count, [NAN] * (rows * count)) for rows in (1, count))
    return Ball(centre, value, row, row, square)


def _absolute(x: Any) -> Ball:
    x = _ball(x)
    if x.range >= 0 or x.range <= 0:
        result: Ball = x if x.range >= 0 else -x
        return result
    return _unknown(abs(x.centre), abs(x.range), x)


def _sign(x: Any) -> Ball:
    x = _ball(x)
    return Ball.constant(1.0 if x.range > 0 else -1.0) if x.range > 0 or x.range < 0 else _unknown(NAN, UNIT, x)


def _maximum(a: Any, b: Any) -> Ball:
    a, b = _ball(a), _ball(b)
    if a.range >= b.range or b.range >= a.range:
        result: Ball = a if a.range >= b.range else b
        return result
    return _unknown(a.centre.max(b.centre), a.range.max(b.range), a, b)


_RULES: dict[np.ufunc, Callable[..., Ball]] = {
    np.add: _add,
    np.subtract: lambda a, b: _add(a, -_ball(b)),
    np.multiply: _multiply,
    np.divide: _divide,
    np.power: _power,
    np.negative: lambda x: -x,
    np.positive: lambda x: x,
    np.square: lambda x: _multiply(x, x),
    np.sqrt: lambda x: _compose(x, _sqrt),
    np.sin: lambda x: _compose(x, _sin),
    np.cos: lambda x: _compose(x, _cos),
    np.tan: lambda x: _divide(_compose(x, _sin), _compose(x, _cos)),
    np.arcsin: lambda x: _compose(x, _arcsin),
    np.arccos: lambda x: arb.pi() / 2 - _compose(x, _arcsin),
    np.arctan: lambda x: _compose(x, _arctan),
    np.arctan2: _arctan2,
    np.exp: lambda x: _compose(x, _exp),
    np.log: lambda x: _compose(x, _log),
    np.log10: lambda x: _compose(x, _log) * (1 / arb(10).log()),
    np.sinh: lambda x: _compose(x, _sinh),
    np.cosh: lambda x: _compose(x, _cosh),
    np.tanh: lambda x: _compose(x, _tanh),
    np.absolute: _absolute,
    np.sign: _sign,
    np.maximum: _maximum,
    np.minimum: lambda a, b: -_maximum(-_ball(a), -_ball(b)),
}


# --- bounds ------------------------------------------------------------------------------------------------------------------


def lower_bound(q: Ball) -> Any:
    """Return a lower bound over the box, the best of three forms: value, mean value and Taylor form; -inf where there is none."""
    lower = _finite(q.value.lower())
    if q.slope is None:
        return lower
    mean = q.centre - sum((x.abs_upper() for x in q.gradient.entries()), arb(0))
    return lower.max(_finite(mean.lower())).max(_finite(_taylor(q).lower()))


def _finite(x: Any) -> Any:
    return x if x.is_finite() else arb("-inf")


def _taylor(q: Ball) -> Any:
    """Return a lower bound of the Taylor form: the tangent plane, at about its minimum, of the form made convex.

    With any positive definite matrix C and point p in the box, d'Hd >= d'Cd - rest and d'Cd / 2 >= p'Cp / 2 + (d - p)'Cp; the
    rest is the sum of |H - C| off the diagonal, and of C - H on it where that is positive.
    """
    if not q.known or not q.centre.is_finite():
        return arb("-inf")
    n = q.slope.ncols()
    middle = np.array([float(x) for x in q.hessian.entries()]).reshape(n, n)
    middle = 0.5 * (middle + middle.T)
    linear = np.array([float(x) for x in q.slope.entries()])
    if not np.all(np.isfinite(middle)) or not np.all(np.isfinite(linear)):
        return arb("-inf")
    least = float(np.linalg.eigvalsh(middle)[0])
    shift = max(0.0, 1e-9 * float(np.sum(np.abs(middle))) - least)
    convex = middle + shift * np.eye(n)
    exact = arb_mat(n, n, [arb(float(x)) for x in convex.ravel()])
    if np.any(middle) and not positive_definite(exact):
        return arb("-inf")
    point = box_minimum(linear, convex)
    p = arb_mat(n, 1, [arb(float(x)) for x in point])
    curved = exact * p
    differs = q.hessian - exact
    rest = arb(0)
    for i in range(n):
        rest += (-differs[i, i]).max(arb(0)).abs_upper()  # d_i^2 is not negative
        rest += sum((differs[i, j].abs_upper() for j in range(n) if j != i), arb(0))
    slope = q.slope.transpose() + curved
    return q.centre - (p.transpose() * curved)[0, 0] / 2 - sum((x.abs_upper() for x in slope.entries()), arb(0)) - rest / 2


def positive_definite(matrix: Any) -> bool:
    """Return whether every symmetric matrix within the balls is positive definite: the pivots of its elimination are positive."""
    n = matrix.nrows()
    rows = [[matrix[i, j] for j in range(n)] for i in range(n)]
    for k in range(n):
        if not rows[k][k] > 0:
            return False
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            for j in range(i, n):
                rows[i][j] = rows[j][i] = rows[i][j] - factor * rows[k][j]
    return True


def box_minimum(
    linear: NDArray[np.float64], convex: NDArray[np.float64], begin: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return about the minimum (n,) of linear . d + d' convex d / 2 over -1 <= d <= 1, by coordinate descent.

    Parameters
    ----------
    linear : array (n,)
    convex : array (n, n)
        Symmetric, positive semidefinite.
    begin : array (n,), optional
        Point about which the form is expanded; d is begin plus the step. Default: zero.
    """
    start = np.zeros(len(linear)) if begin is None else begin
    point, slope = start.copy(), linear.copy()
    for k in range(DESCENT * len(linear)):
        i = k % len(linear)
        curvature = convex[i, i]
        target = point[i] - slope[i] / curvature if curvature > 0.0 else -math.copysign(1.0, slope[i]) if slope[i] else point[i]
        step = min(1.0, max(-1.0, target)) - point[i]
        point[i] += step
        slope += convex[:, i] * step
    return point


def tangent_bound(q: Ball, point: Sequence[Any]) -> Any:
    """Return the lower bound over -1 <= d <= 1 of a convex quantity, by its tangent plane at one design.

    Parameters
    ----------
    q : Ball
        With that design as its centre (`Ball.unknown` with over=False).
    point : sequence of arb (n,)
        Its coordinates d.
    """
    bound = q.centre
    for slope, at in zip(q.slope.entries(), point, strict=True):
        bound -= (slope * (1 + at)).max(-slope * (1 - at))
    return _finite(bound.lower())
