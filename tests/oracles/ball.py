"""Quantities over a box of designs in ball arithmetic (Arb): value, gradient and Hessian, each with a proven error bound.

The design variables are scaled: a design of the box has coordinates d_1 ... d_n from -1 to 1, and all derivatives are with
respect to them. Every operation carries the value and the gradient at one design, the centre, and enclosures of value, gradient
and Hessian over the whole box (forward mode). So there are two enclosures: the value itself, and the Taylor form
centre + slope . d + d' Hessian d / 2; the nonlinear rules use the intersection of both.

References
----------
F. Johansson, Arb: efficient arbitrary-precision midpoint-radius interval arithmetic, IEEE Transactions on Computers 66 (2017)
1281-1292. A. Neumaier, Interval Methods for Systems of Equations, Cambridge 1990, sections 2.3 and 2.4 (Taylor forms).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from flint import arb, arb_mat

UNIT = arb(0, 1)  # -1 ... 1
NAN = arb("nan")
INTEGER_POWERS = 16  # largest integer exponent that is expanded into products
DESCENT = 8  # rounds of coordinate descent towards the minimum of a quadratic form

Vector = tuple["Ball", "Ball"]
Row = list[float]


class Ball:
    """A quantity over a box, NaN where it is undefined somewhere in it. Without derivatives it is the same in the whole box.

    `centre`, `value`: at the centre and over the box; `slope`, `gradient` (1, n): the same of the first derivatives; `hessian`
    (n, n) over the box.
    """

    __slots__ = ("_range", "centre", "gradient", "hessian", "slope", "value")

    def __init__(self, centre: Any, value: Any, slope: Any = None, gradient: Any = None, hessian: Any = None) -> None:
        self.centre, self.value = centre, value
        self.slope, self.gradient, self.hessian = slope, gradient, hessian
        self._range: Any = None

    @staticmethod
    def variable(index: int, count: int, at: float, scale: Any, *, over: bool = True) -> Ball:
        """Return a design variable; with `over` false it stays at the centre, and the derivatives are those there."""
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
                size = sum((x.abs_upper() for x in self.hessian.entries()), arb(0)) / 2
                size = sum((x.abs_upper() for x in self.slope.entries()), size)
                taylor = self.centre + size.upper() * UNIT
                if taylor.is_finite() and self.value.is_finite():
                    self._range = self.value.intersection(taylor)
        return self._range

    def __neg__(self) -> Ball:
        if self.slope is None:
            return constant(-self.value)
        return Ball(-self.centre, -self.value, -self.slope, -self.gradient, -self.hessian)

    def __add__(self, other: Any) -> Ball:
        a, b = self, ball(other)
        centre, value = a.centre + b.centre, a.value + b.value
        if a.slope is None or b.slope is None:
            like = b if a.slope is None else a
            return Ball(centre, value, like.slope, like.gradient, like.hessian)
        return Ball(centre, value, a.slope + b.slope, a.gradient + b.gradient, a.hessian + b.hessian)

    def __sub__(self, other: Any) -> Ball:
        return self + -ball(other)

    def __rsub__(self, other: Any) -> Ball:
        return -self + other

    def __mul__(self, other: Any) -> Ball:
        a, b = self, ball(other)
        if b.slope is None:
            a, b = b, a
        if a.slope is None:
            factor = a.value
            if b.slope is None:
                return constant(factor * b.value)
            return Ball(factor * b.centre, factor * b.value, b.slope * factor, b.gradient * factor, b.hessian * factor)
        x, y = a.range, b.range
        outer = a.gradient.transpose() * b.gradient
        if a is b:
            hessian = (a.hessian * x + outer) * 2
            slope, gradient, value = a.slope * (2 * a.centre), a.gradient * (2 * x), (x * x).nonnegative_part()
        else:
            hessian = a.hessian * y + b.hessian * x + outer + outer.transpose()
            slope, gradient, value = a.slope * b.centre + b.slope * a.centre, a.gradient * y + b.gradient * x, x * y
        return Ball(a.centre * b.centre, value, slope, gradient, hessian)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: Any) -> Ball:
        return self * composed(ball(other), _reciprocal)

    def __rtruediv__(self, other: Any) -> Ball:
        return other * composed(self, _reciprocal)


def constant(value: Any) -> Ball:
    """Return a number, exactly that of the float."""
    value = value if isinstance(value, arb) else arb(float(value))
    return Ball(value, value)


def ball(x: Any) -> Ball:
    """Return a quantity or a number as a ball."""
    return x if isinstance(x, Ball) else constant(x)


def composed(x: Ball, rule: Callable[[Any], tuple[Any, Any, Any]]) -> Ball:
    """Return a function of a quantity; `rule`: arb -> value, first and second derivative, each of them NaN where undefined."""
    centre, first, _ = rule(x.centre)
    if x.slope is None:
        return constant(centre)
    value, over, second = rule(x.range)
    hessian = x.hessian * over + (x.gradient.transpose() * x.gradient) * second
    return Ball(centre, value, x.slope * first, x.gradient * over, hessian)


def _reciprocal(x: Any) -> tuple[Any, Any, Any]:
    inverse = 1 / x
    return inverse, -inverse * inverse, 2 * inverse * inverse * inverse


def _sqrt(x: Any) -> tuple[Any, Any, Any]:
    root = x.sqrt()
    return root, 1 / (2 * root), -1 / (4 * root * x)


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


def sqrt(x: Ball) -> Ball:
    """Return the square root."""
    return composed(x, _sqrt)


def unit(angle: Ball) -> Vector:
    """Return the unit vector at an angle [rad]."""
    return composed(angle, _cos), composed(angle, _sin)


def absolute(x: Ball) -> Ball:
    """Return the magnitude; its derivatives are unknown where the sign changes in the box."""
    if x.range >= 0 or x.range <= 0:
        return x if x.range >= 0 else -x
    return undefined(abs(x.centre), abs(x.range), x)


def maximum(a: Ball, b: Ball) -> Ball:
    """Return the larger of two quantities; its derivatives are unknown where neither is the larger one in the whole box."""
    if a.range >= b.range or b.range >= a.range:
        return a if a.range >= b.range else b
    return undefined(a.centre.max(b.centre), a.range.max(b.range), a, b)


FUNCTIONS: dict[str, Callable[[Ball], Ball]] = {
    "sin": lambda x: composed(x, _sin),
    "cos": lambda x: composed(x, _cos),
    "tan": lambda x: composed(x, _sin) / composed(x, _cos),
    "asin": lambda x: composed(x, _arcsin),
    "acos": lambda x: arb.pi() / 2 - composed(x, _arcsin),
    "atan": lambda x: composed(x, _arctan),
    "sinh": lambda x: composed(x, _sinh),
    "cosh": lambda x: composed(x, _cosh),
    "tanh": lambda x: composed(x, _tanh),
    "exp": lambda x: composed(x, _exp),
    "log": lambda x: composed(x, _log),
    "log10": lambda x: composed(x, _log) * (1 / arb(10).log()),
    "sqrt": sqrt,
    "abs": absolute,
}
"""Functions of the expression of a law."""


def power(base: Ball, exponent: Ball) -> Ball:
    """Return a power: of a small whole exponent by products, of any other one by a logarithm."""
    n = exponent.value
    if exponent.slope is not None or not n.is_integer() or abs(float(n)) > INTEGER_POWERS:
        return composed(exponent * composed(base, _log), _exp)
    count = int(float(n))
    if count == 0:
        return constant(1.0)
    result = base if abs(count) == 1 else base * base
    for _ in range(abs(count) - 2):
        result = result * base
    return composed(result, _reciprocal) if count < 0 else result


def angle_of(direction: Vector, *, principal: bool = False) -> Ball:
    """Return the angle of a direction [rad], continuous over the box.

    It lies beyond -pi ... pi where the box crosses the negative x axis; there a `principal` angle is undefined.
    """
    x, y = direction
    about = math.atan2(float(y.centre), float(x.centre))
    if not math.isfinite(about):
        return undefined(NAN, NAN, x, y)
    s, c = arb(about).sin_cos()
    along, across = x * c + y * s, y * c - x * s
    if not along.range > 0:
        return undefined(NAN, NAN, x, y)
    result = constant(about) + composed(across / along, _arctan)
    if principal and not (result.range < arb.pi() and result.range > -arb.pi()):
        return undefined(NAN, NAN, x, y)
    return result


def angle_between(first: Vector, second: Vector, *, principal: bool = False) -> Ball:
    """Return the angle from one direction to another [rad]."""
    return angle_of((dot(first, second), cross(first, second)), principal=principal)


def undefined(centre: Any, value: Any, *like: Ball) -> Ball:
    """Return a quantity without known derivatives, a constant if those that it depends on are."""
    count = max((one.slope.ncols() for one in like if one.slope is not None), default=0)
    if not count:
        return constant(value)
    row, square = (arb_mat(rows, count, [NAN] * (rows * count)) for rows in (1, count))
    return Ball(centre, value, row, row, square)


# --- vectors of the plane ------------------------------------------------------------------------------------------------------


def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1]


def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1]


def times(factor: Ball, a: Vector) -> Vector:
    """Return a vector times a number."""
    return factor * a[0], factor * a[1]


def dot(a: Vector, b: Vector) -> Ball:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1]


def cross(a: Vector, b: Vector) -> Ball:
    """Return the component of the vector product along z."""
    return a[0] * b[1] - a[1] * b[0]


def turned(a: Vector, by: Vector) -> Vector:
    """Return a vector turned by the angle of the unit vector `by`."""
    return a[0] * by[0] - a[1] * by[1], a[0] * by[1] + a[1] * by[0]


def turned_back(a: Vector, by: Vector) -> Vector:
    """Return a vector turned by the opposite angle."""
    return dot(by, a), cross(by, a)


# --- bounds --------------------------------------------------------------------------------------------------------------------


def finite(x: Any) -> Any:
    """Return a number, or -inf if it is none."""
    return x if x.is_finite() else arb("-inf")


def lower_bound(q: Ball) -> Any:
    """Return a lower bound over the box, the best of three forms: value, mean value and Taylor form; -inf where there is none."""
    lower = finite(q.value.lower())
    if q.slope is None:
        return lower
    mean = q.centre - sum((x.abs_upper() for x in q.gradient.entries()), arb(0))
    return lower.max(finite(mean.lower())).max(finite(_taylor(q).lower()))


def floats(matrix: Any) -> list[float]:
    """Return the entries of a matrix, rounded."""
    return [float(x) for x in matrix.entries()]


def square_floats(matrix: Any) -> list[Row]:
    """Return the rows of a square matrix, rounded and made symmetric."""
    n, entries = matrix.nrows(), floats(matrix)
    return [[0.5 * (entries[i * n + j] + entries[j * n + i]) for j in range(n)] for i in range(n)]


def _taylor(q: Ball) -> Any:
    """Return a lower bound of the Taylor form: the tangent plane, at about its minimum, of the form made convex.

    With any positive definite matrix C and point p in the box, d'Hd >= d'Cd - rest and d'Cd / 2 >= p'Cp / 2 + (d - p)'Cp; the
    rest is the sum of |H - C| off the diagonal, and of C - H on it where that is positive.
    """
    if not q.known or not q.centre.is_finite():
        return arb("-inf")
    n = q.slope.ncols()
    convex, linear = _made_convex(square_floats(q.hessian)), floats(q.slope)
    if not all(math.isfinite(x) for x in (*linear, *(x for row in convex for x in row))):
        return arb("-inf")
    exact = arb_mat(n, n, [arb(x) for row in convex for x in row])
    if any(x for row in convex for x in row) and not positive_definite(exact):
        return arb("-inf")
    p = arb_mat(n, 1, [arb(x) for x in box_minimum(linear, convex)])
    curved, differs, rest = exact * p, q.hessian - exact, arb(0)
    for i in range(n):
        rest += (-differs[i, i]).max(arb(0)).abs_upper()  # d_i^2 is not negative
        rest += sum((differs[i, j].abs_upper() for j in range(n) if j != i), arb(0))
    slope = q.slope.transpose() + curved
    return q.centre - (p.transpose() * curved)[0, 0] / 2 - sum((x.abs_upper() for x in slope.entries()), arb(0)) - rest / 2


def _made_convex(rows: list[Row]) -> list[Row]:
    """Return a matrix with so much added to its diagonal that it is positive definite."""
    total = sum(abs(x) for row in rows for x in row)
    low, high = 0.0, total  # more than the largest magnitude of an eigenvalue
    least = 1e-9 * total

    def shifted(shift: float) -> list[Row]:
        return [[x + (shift + least) * (i == j) for j, x in enumerate(row)] for i, row in enumerate(rows)]

    if not math.isfinite(total) or not total or _pivots_positive(rows):
        return shifted(0.0)
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _pivots_positive(shifted(middle - least)) else (middle, high)
    return shifted(high)


def _pivots_positive(matrix: Sequence[Sequence[Any]]) -> bool:
    rows = [list(row) for row in matrix]
    n = len(rows)
    for k in range(n):
        if not rows[k][k] > 0:
            return False
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            for j in range(i, n):
                rows[i][j] = rows[j][i] = rows[i][j] - factor * rows[k][j]
    return True


def positive_definite(matrix: Any) -> bool:
    """Return whether every symmetric matrix within the balls is positive definite: the pivots of its elimination are positive."""
    n = matrix.nrows()
    return _pivots_positive([[matrix[i, j] for j in range(n)] for i in range(n)])


def box_minimum(linear: Row, convex: list[Row], begin: Row | None = None) -> Row:
    """Return about the minimum of linear . d + d' convex d / 2 over -1 <= d <= 1, by coordinate descent.

    With `begin` the form is expanded about that point: d is the point plus the step.
    """
    point, slope = list(begin or [0.0] * len(linear)), list(linear)
    for k in range(DESCENT * len(linear)):
        i = k % len(linear)
        curvature = convex[i][i]
        target = point[i] - slope[i] / curvature if curvature > 0.0 else -math.copysign(1.0, slope[i]) if slope[i] else point[i]
        step = min(1.0, max(-1.0, target)) - point[i]
        point[i] += step
        slope = [s + row[i] * step for s, row in zip(slope, convex, strict=True)]
    return point


def tangent_bound(q: Ball, point: Sequence[Any]) -> Any:
    """Return the lower bound over -1 <= d <= 1 of a convex quantity by its tangent plane at its centre, d = `point`."""
    bound = q.centre
    for slope, at in zip(q.slope.entries(), point, strict=True):
        bound -= (slope * (1 + at)).max(-slope * (1 - at))
    return finite(bound.lower())
