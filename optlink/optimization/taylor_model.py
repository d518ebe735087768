"""Second-order Taylor models: a quantity over a whole box of designs, as a polynomial with a proven remainder.

A quantity q over the box, whose coordinates d_1 ... d_n run from -1 to 1, is

    q(d) = c + sum g_i d_i + sum_{i <= j} h_ij d_i d_j + r,    |r| <= remainder,

for every d in the box where q is defined. The formulas of `linkage` pass Taylor models on as they pass on jets: one evaluation
gives the value, the first and the second derivatives at the centre, and bounds over the box whose error is of third order in its
size. Rounding errors of every operation are part of the remainder, so the bounds are rigorous.

References
----------
M. Berz and K. Makino, Verified integration of ODEs and flows using differential algebraic methods on high-order Taylor models,
Reliable Computing 4 (1998) 361-369. S. M. Rump, Verification methods: rigorous results using floating-point arithmetic, Acta
Numerica 19 (2010) 287-449, section 9 (error of a floating-point sum).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import ArrayLike, NDArray

from optlink.errors import Fault, InputError
from optlink.linkage.fourbar import transmission_cosine
from optlink.linkage.singular import FIXED_LIMIT_TOLERANCE
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.terms import TERMS, ConstraintRow, output_error, position_rows
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.limits import Reach
from optlink.problem.requirements.base import START, StartPosition, at_positions
from optlink.problem.requirements.values import GRID
from optlink.problem.targets.law import Law

UNIT = 2.0**-53  # largest relative error of a rounded operation
ROUNDING = 64.0 * UNIT  # bounds the rounding errors of all coefficients of one operation, relative to the sum of their sizes
TINY = 1e-290  # makes up for underflow
LIBRARY = 2.0**-48  # bounds the error of sin, cos, arctan (absolute) and exp, log, power (relative): at least 16 ulp
UPWARD = 1.0 + 2.0**-44  # makes up for the rounding of a remainder, a sum and product of fewer than 100 positive numbers
INTEGER_POWERS = 16  # largest integer exponent that is expanded into products


@cache
def pairs(count: int) -> tuple[tuple[int, int], ...]:
    """Return the indices (i, j), i <= j, of the second-order coefficients in the order of storage."""
    return tuple((i, j) for i in range(count) for j in range(i, count))


class TaylorModel(NDArrayOperatorsMixin):
    """A quantity over boxes of `count` unknowns. Where it is undefined, or cannot be bounded, the remainder is infinite.

    `coefficients` (1 + n + n (n + 1) / 2, ...) are the value at the centre, the first-order coefficients, and the second-order
    ones in the order of `pairs`; or (1, ...) for a quantity that is the same in the whole box. `remainder` (...) is the largest
    deviation from the polynomial; `sizes`: see the property, where they are known.
    """

    __slots__ = ("_sizes", "coefficients", "count", "remainder")

    def __init__(self, coefficients: Array, remainder: ArrayLike, count: int, sizes: tuple[Array, Array] | None = None) -> None:
        self.coefficients, self.count = coefficients, count
        self.remainder = np.asarray(remainder, dtype=float)
        self._sizes = sizes

    def __repr__(self) -> str:
        return f"TaylorModel({self.count} unknowns, shape {self.remainder.shape})"

    # --- construction ----------------------------------------------------------------------------------------------

    @staticmethod
    def constant(value: ArrayLike, count: int) -> TaylorModel:
        """Return a quantity that is the same in every box."""
        value = np.asarray(value, dtype=float)
        return TaylorModel(value[None], np.zeros(value.shape), count)

    @staticmethod
    def unknowns(low: Array, high: Array) -> list[TaylorModel]:
        """Return the n unknowns over boxes, each of shape (boxes, 1).

        Parameters
        ----------
        low, high : array (boxes, n)
            Corners of the boxes.
        """
        boxes, count = low.shape
        models = []
        for k in range(count):
            coefficients = np.zeros((1 + count + len(pairs(count)), boxes, 1))
            coefficients[0, :, 0] = 0.5 * (low[:, k] + high[:, k])
            coefficients[1 + k, :, 0] = 0.5 * (high[:, k] - low[:, k])
            slack = 4.0 * UNIT * (np.abs(low[:, k]) + np.abs(high[:, k])) + TINY
            models.append(TaylorModel(coefficients, slack[:, None], count))
        return models

    # --- bounds ----------------------------------------------------------------------------------------------------

    @property
    def value(self) -> Array:
        """Value at the centre of every box, not rigorous."""
        value: Array = self.coefficients[0]
        return value

    @property
    def linear(self) -> Array:
        """First-order coefficients (n, ...)."""
        if len(self.coefficients) == 1:
            return np.zeros((self.count, *self.remainder.shape))
        return self.coefficients[1 : 1 + self.count]

    @property
    def quadratic(self) -> Array:
        """Second-order coefficients (n (n + 1) / 2, ...), in the order of `pairs`."""
        if len(self.coefficients) == 1:
            return np.zeros((len(pairs(self.count)), *self.remainder.shape))
        return self.coefficients[1 + self.count :]

    @property
    def sizes(self) -> tuple[Array, Array]:
        """Largest absolute value of the first-order and of the second-order part."""
        if self._sizes is None:
            if len(self.coefficients) == 1:
                zero = np.zeros(self.remainder.shape)
                self._sizes = zero, zero
            else:
                both = np.abs(self.coefficients[1:])
                self._sizes = np.add.reduce(both[: self.count]), np.add.reduce(both[self.count :])
        return self._sizes

    @property
    def radius(self) -> Array:
        """Largest deviation from the value at the centre, rigorous."""
        first, second = self.sizes
        radius: Array = (first + second + self.remainder) * UPWARD + TINY
        return radius

    @property
    def low(self) -> Array:
        """Lower bound over every box, rigorous; -inf where there is none."""
        return _bound(self.value, self.radius, -1.0)

    @property
    def high(self) -> Array:
        """Upper bound over every box, rigorous; inf where there is none."""
        return _bound(self.value, self.radius, 1.0)

    # --- arithmetic ------------------------------------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        rule = _RULES.get(ufunc)
        if rule is None or method != "__call__" or kwargs:
            return NotImplemented
        with np.errstate(all="ignore"):
            return rule(*inputs)  # what overflows or is undefined gets an infinite remainder

    def __add__(self, other: Any) -> TaylorModel:  # bypasses numpy's dispatch, most of the cost of a small batch
        return _add(self, other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> TaylorModel:
        return _add(self, -other)

    def __rsub__(self, other: Any) -> TaylorModel:
        return _add(-self, other)

    def __mul__(self, other: Any) -> TaylorModel:
        with np.errstate(all="ignore"):
            return _multiply(self, other)

    __rmul__ = __mul__

    def __neg__(self) -> TaylorModel:
        return TaylorModel(-self.coefficients, self.remainder, self.count, self._sizes)

    def __getitem__(self, index: Any) -> TaylorModel:
        index = index if isinstance(index, tuple) else (index,)
        return TaylorModel(self.coefficients[(slice(None), *index)], self.remainder[index], self.count)

    def sum(self, axis: int = -1) -> TaylorModel:
        """Return the sum along an axis (negative: counted from the last)."""
        size = np.sum(np.abs(self.coefficients), axis=(0, axis))
        terms = self.remainder.shape[axis]
        remainder = (np.sum(self.remainder, axis=axis) + terms * UNIT * 4.0 * size) * (UPWARD + 4.0 * UNIT * terms) + TINY
        return TaylorModel(np.sum(self.coefficients, axis=axis), remainder, self.count)


def _bound(value: Array, radius: Array, side: float) -> Array:
    with np.errstate(invalid="ignore"):
        bound = value + side * radius
    bound = bound + side * 4.0 * UNIT * np.abs(bound)
    return np.where(np.isnan(bound), side * np.inf, bound)


def _model(x: Any, like: TaylorModel) -> TaylorModel:
    return x if isinstance(x, TaylorModel) else TaylorModel.constant(x, like.count)


def _two(a: Any, b: Any) -> tuple[TaylorModel, TaylorModel]:
    like = a if isinstance(a, TaylorModel) else b
    return _model(a, like), _model(b, like)


def _aligned(coefficients: Array, rank: int) -> Array:
    """Insert axes after the first, so that the other axes broadcast from the right."""
    missing = rank - (coefficients.ndim - 1)
    return coefficients.reshape(coefficients.shape[0], *([1] * missing), *coefficients.shape[1:]) if missing > 0 else coefficients


def _add(a: Any, b: Any) -> TaylorModel:
    """Return the sum; a rounded sum of two numbers is wrong by at most `UNIT` of itself, whatever the sizes of its terms."""
    if isinstance(b, float | int):
        out = a.coefficients.copy()
        out[0] += b
        return TaylorModel(out, (a.remainder + ROUNDING * np.abs(out[0])) * UPWARD + TINY, a.count, a._sizes)
    a, b = _two(a, b)
    x, y = a.coefficients, b.coefficients
    rank = max(x.ndim, y.ndim) - 1
    x, y = _aligned(x, rank), _aligned(y, rank)
    sizes = None
    if len(x) == len(y):
        out = x + y
        size = np.abs(out)
        sizes = np.add.reduce(size[1 : 1 + a.count]), np.add.reduce(size[1 + a.count :])
        rounding = ROUNDING * (size[0] + sizes[0] + sizes[1])
    else:
        longer, shorter = (x, y) if len(x) > len(y) else (y, x)
        out = np.empty((len(longer), *np.broadcast_shapes(longer.shape[1:], shorter.shape[1:])))
        out[:] = longer
        out[0] += shorter[0]
        rounding = ROUNDING * np.abs(out[0])
    return TaylorModel(out, (a.remainder + b.remainder + rounding) * UPWARD + TINY, a.count, sizes)


def _multiply(a: Any, b: Any) -> TaylorModel:
    if isinstance(a, float | int):
        a, b = b, a
    if isinstance(b, float | int):
        first, second = a.sizes
        remainder = (a.remainder + ROUNDING * (np.abs(a.value) + first + second)) * abs(b)
        return TaylorModel(a.coefficients * b, remainder * UPWARD + TINY, a.count)
    square = a is b
    a, b = _two(a, b)
    x, y, n = a.coefficients, b.coefficients, a.count
    rank = max(x.ndim, y.ndim) - 1
    x, y = _aligned(x, rank), _aligned(y, rank)
    (ga, qa), (gb, qb) = a.sizes, b.sizes
    ca, cb = np.abs(x[0]), np.abs(y[0])
    size_a, size_b = ca + ga + qa, cb + gb + qb
    if len(x) == 1 or len(y) == 1:
        out = x * y
        third: Any = 0.0
    else:
        out = y * x[:1]
        out[1:] += x[1:] * y[:1]
        for k, (i, j) in enumerate(pairs(n)):
            if i == j:
                out[1 + n + k] += x[1 + i] * y[1 + i]
            elif square:
                out[1 + n + k] += 2.0 * (x[1 + i] * y[1 + j])
            else:
                out[1 + n + k] += x[1 + i] * y[1 + j] + x[1 + j] * y[1 + i]
        third = ga * qb + qa * (gb + qb)
    remainder = third + a.remainder * (size_b + b.remainder) + size_a * b.remainder + ROUNDING * (size_a * size_b)
    return TaylorModel(out, remainder * UPWARD + TINY, n)


def _compose(x: TaylorModel, rule: Rule, error: float = 0.0) -> TaylorModel:
    """Return f(x) from f, f', f'' at the centre and a bound of f''' over the range of x.

    `error` is the absolute error of f at the centre, on top of a relative one of `LIBRARY`.
    """
    a, n = x.coefficients, x.count
    linear, quadratic = x.sizes
    deviation = x.radius
    f, first, second, third = rule(a[0], x.low, x.high)
    beyond = quadratic + x.remainder  # second order and remainder of x
    if len(a) == 1:
        out = f[None].copy()
    else:
        out = a * first
        out[0] = f
        half = 0.5 * second
        for k, (i, j) in enumerate(pairs(n)):
            product = a[1 + i] * a[1 + j]
            out[1 + n + k] += half * product if i == j else second * product
    first, second = np.abs(first), np.abs(second)
    cubic = deviation * deviation * deviation
    remainder = first * x.remainder + 0.5 * second * beyond * (2.0 * linear + beyond) + third * (cubic / 6.0)
    size = first * (linear + quadratic) + 0.5 * second * (linear * linear)
    remainder = remainder + (ROUNDING + LIBRARY) * size + LIBRARY * np.abs(f) + error
    bad = ~np.isfinite(remainder) | ~np.isfinite(f)
    if np.any(bad):
        remainder = np.where(bad, np.inf, remainder)
        out = np.where(np.isfinite(out) & ~bad, out, 0.0)
    return TaylorModel(out, remainder * UPWARD + TINY, n)


def _divide(a: Any, b: Any) -> TaylorModel:
    if not isinstance(b, TaylorModel):
        return _multiply(a, 1.0 / TaylorModel.constant(b, a.count))
    inverse = _compose(b, DERIVATIVES[np.reciprocal])
    return inverse if isinstance(a, float | int) and a == 1.0 else _multiply(a, inverse)


def _power(base: Any, exponent: Any) -> TaylorModel:
    if isinstance(exponent, TaylorModel):
        base = _model(base, exponent)
        return np.exp(exponent * np.log(base))  # type: ignore[no-any-return]
    n = float(exponent)
    if n != int(n) or abs(n) > INTEGER_POWERS:
        return _compose(base, power(n))
    result = base if n else TaylorModel.constant(1.0, base.count)
    for _ in range(abs(int(n)) - 1):
        result = result * base
    return 1.0 / result if n < 0 else result


def _arctan2(y: Any, x: Any) -> TaylorModel:
    """Angle of the direction (x, y), continuous over the box; beyond -pi ... pi where the box crosses the negative x axis."""
    y, x = _two(y, x)
    centre = np.arctan2(y.value, x.value)
    c, s = np.cos(centre), np.sin(centre)
    along, across = x * c + y * s, y * c - x * s
    slope = across * _compose(along, DERIVATIVES[np.reciprocal])
    valid = along.low > 0.0
    angle = _compose(slope, DERIVATIVES[np.arctan], LIBRARY)
    remainder = np.where(valid, angle.remainder + 4.0 * LIBRARY, np.inf)
    out = angle.coefficients.copy()
    out[0] += centre
    return TaylorModel(out, remainder, x.count)


def _hull(x: TaylorModel, low: Array, high: Array) -> TaylorModel:
    """Return a quantity of which only bounds are known."""
    middle = 0.5 * (low + high)
    spread = (0.5 * (high - low) + 4.0 * UNIT * (np.abs(low) + np.abs(high))) * UPWARD + TINY
    bad = ~np.isfinite(spread)
    return TaylorModel(np.where(bad, 0.0, middle)[None], np.where(bad, np.inf, spread), x.count)


def _select(
    x: TaylorModel, y: TaylorModel, first: NDArray[np.bool_], other: TaylorModel, second: NDArray[np.bool_]
) -> TaylorModel:
    """Return x where `first`, y where `second`, and `other` elsewhere."""
    full = 1 + x.count + len(pairs(x.count))
    shape = np.broadcast_shapes(x.remainder.shape, y.remainder.shape, other.remainder.shape)

    def whole(model: TaylorModel) -> Array:
        out = np.zeros((full, *shape))
        out[: len(model.coefficients)] = _aligned(model.coefficients, len(shape))
        return out

    coefficients = np.where(first, whole(x), np.where(second, whole(y), whole(other)))
    return TaylorModel(coefficients, np.where(first, x.remainder, np.where(second, y.remainder, other.remainder)), x.count)


def _absolute(x: TaylorModel) -> TaylorModel:
    low, high = x.low, x.high
    return _select(x, -x, low >= 0.0, _hull(x, np.zeros_like(low), np.maximum(-low, high)), high <= 0.0)


def _sign(x: TaylorModel) -> TaylorModel:
    low, high = x.low, x.high
    return _hull(x, np.where(low > 0.0, 1.0, -1.0), np.where(high < 0.0, -1.0, 1.0))


def _minimum(a: Any, b: Any) -> TaylorModel:
    a, b = _two(a, b)
    both = _hull(a, np.minimum(a.low, b.low), np.minimum(a.high, b.high))
    return _select(a, b, a.high <= b.low, both, b.high <= a.low)


def _root(x: TaylorModel) -> TaylorModel:
    """Square root; where x is negative in a part of the box, the range of the root in the other part."""
    root, low, high = _compose(x, DERIVATIVES[np.sqrt]), x.low, x.high
    partly = (low <= 0.0) & (high > 0.0) & np.isfinite(high)
    if not np.any(partly):
        return root
    whole = _hull(x, np.zeros_like(high), np.sqrt(np.maximum(high, 0.0)))
    return _select(whole, root, partly, root, ~partly)


# --- derivatives of elementary functions ------------------------------------------------------------------------

Derivatives = tuple[Array, Array, Array, Array]
"""Value, first and second derivative at the centre, and a bound of the size of the third over the range; NaN if undefined."""
Rule = Callable[[Array, Array, Array], Derivatives]
"""(centre, low, high), arrays of one shape, to the derivatives of an elementary function."""


def _positive(low: Array) -> Array:
    return np.where(low > 0.0, low, np.nan)


def power(p: float) -> Rule:
    """Return the rule of x**p."""

    def rule(x: Array, low: Array, high: Array) -> Derivatives:
        f, low = np.power(x, p), _positive(low)
        third = abs(p * (p - 1.0) * (p - 2.0)) * np.maximum(np.power(low, p - 3.0), np.power(high, p - 3.0))
        slope = p * f / x
        return f, slope, (p - 1.0) * slope / x, third * (1.0 + LIBRARY) * UPWARD

    return rule


DERIVATIVES: dict[np.ufunc, Rule] = {
    np.sqrt: lambda x, low, high: (
        root := np.sqrt(x),
        0.5 / root,
        -0.25 / (root * x),
        0.375 * UPWARD / ((low := _positive(low)) * low * np.sqrt(low)),
    ),
    np.reciprocal: lambda x, low, high: (
        inverse := 1.0 / x,
        -inverse * inverse,
        2.0 * inverse * inverse * inverse,
        6.0 * UPWARD / ((square := (least := np.where(low > 0.0, low, _positive(-high))) * least) * square),
    ),
    np.sin: lambda x, low, high: (s := np.sin(x), np.cos(x), -s, np.ones_like(x)),
    np.cos: lambda x, low, high: (c := np.cos(x), -np.sin(x), -c, np.ones_like(x)),
    np.arctan: lambda x, low, high: (np.arctan(x), w := 1.0 / (1.0 + x * x), -2.0 * x * w * w, np.full_like(x, 2.0)),
    np.exp: lambda x, low, high: (e := np.exp(x), e, e, np.exp(high) * (1.0 + LIBRARY) * UPWARD),
    np.log: lambda x, low, high: (
        np.log(x),
        inverse := 1.0 / x,
        -inverse * inverse,
        2.0 * UPWARD / ((low := _positive(low)) * low * low),
    ),
}


_RULES: dict[np.ufunc, Callable[..., TaylorModel]] = {
    np.add: _add,
    np.subtract: lambda a, b: _add(a, -b),
    np.multiply: _multiply,
    np.divide: _divide,
    np.power: _power,
    np.negative: lambda x: -x,
    np.positive: lambda x: x,
    np.square: lambda x: _multiply(x, x),
    np.sqrt: _root,
    np.sin: lambda x: _compose(x, DERIVATIVES[np.sin], LIBRARY),
    np.cos: lambda x: _compose(x, DERIVATIVES[np.cos], LIBRARY),
    np.tan: lambda x: np.sin(x) / np.cos(x),
    np.arcsin: lambda x: _arctan2(x, np.sqrt(1.0 - x * x)),
    np.arccos: lambda x: _arctan2(np.sqrt(1.0 - x * x), x),
    np.arctan: lambda x: _compose(x, DERIVATIVES[np.arctan], LIBRARY),
    np.arctan2: _arctan2,
    np.exp: lambda x: _compose(x, DERIVATIVES[np.exp]),
    np.log: lambda x: _compose(x, DERIVATIVES[np.log], LIBRARY),
    np.log10: lambda x: _compose(x, DERIVATIVES[np.log], LIBRARY) * (1.0 / np.log(10.0)),
    np.sinh: lambda x: 0.5 * (np.exp(x) - np.exp(-x)),
    np.cosh: lambda x: 0.5 * (np.exp(x) + np.exp(-x)),
    np.tanh: lambda x: 1.0 - 2.0 / (np.exp(2.0 * x) + 1.0),
    np.absolute: _absolute,
    np.sign: _sign,
    np.minimum: _minimum,
    np.maximum: lambda a, b: -_minimum(-a, -b),
}


# Objective and limits of a problem over boxes of designs: the formulas of the NLP, evaluated with Taylor models.
#
# Limits that cannot be evaluated over a box are left out, and limits at every crank angle apply at some of them only. So every
# feasible design is feasible here too, and a lower bound of the objective here holds there.

TRIALS = 6.0 * (np.outer((0.7548776662466927, 0.5698402909980532), np.arange(1, 17)) % 1.0) - 3.0
"""Start positions [rad] at which the period of a law is tested: the R2 sequence, without loading a random generator."""


@dataclass(frozen=True)
class BoxModels:
    """Objective and limits over a batch of boxes.

    `residuals` (boxes, positions, components); `slacks` (boxes, limits), not negative for a feasible design; `periodic`: the
    residuals are angles [rad] of which the nearest multiple of a full turn is subtracted.
    """

    residuals: TaylorModel
    slacks: TaylorModel
    periodic: bool = False


@dataclass
class DesignBoxes:
    """A motion law, function, timed path or transmission problem (see `box_problem`) over boxes of its design variables [SI].

    `low` and `high` (n,) are the bounds of the design variables; `limits` names the limit of every slack, once evaluated.
    """

    problem: DesignProblem
    further: Array = field(default_factory=lambda: np.zeros(0))
    """Crank rotations [rad] from the start of a law at which its error counts too, those of the peaks of a largest error."""
    low: Array = field(init=False)
    high: Array = field(init=False)
    limits: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        bounds = [self.problem.quantities[name].bounds for name in self.problem.free]
        self.low, self.high = np.array(bounds, dtype=float).reshape(-1, 2).T.copy()

    @property
    def law(self) -> Law:
        """The law at all positions."""
        return Law(self.problem.law.source, np.concatenate([self.problem.law.offsets, self.further]))

    @property
    def measure(self) -> str:
        """Measure of the residuals: "sum of squares", "rms" or "max"."""
        return self.problem.measure

    def over(self, low: Array, high: Array) -> BoxModels:
        """Return the models over boxes with corners (boxes, n) [SI]."""
        values: dict[str, Any] = dict(zip(self.problem.free, TaylorModel.unknowns(low, high), strict=True))
        with np.errstate(all="ignore"):
            values = self.problem.complete(values)
            if self.problem.task == "function":
                residuals, rows = _function(self.problem, self.law, values, low.shape[1])
            else:
                law = self.law if self.problem.law_given else None
                residuals, rows = _timed(self.problem, law, values, low.shape[1])
        labelled: list[tuple[str, TaylorModel]] = []
        count = low.shape[1]
        for row in rows:
            for bound, sign in ((row.low, 1.0), (row.high, -1.0)):
                slack = sign * (row.value - bound) if np.isfinite(bound) else np.inf
                if not isinstance(slack, TaylorModel) or slack.remainder.ndim < 2:  # no design changes it
                    least = np.min(slack.high if isinstance(slack, TaylorModel) else slack)
                    slack = TaylorModel.constant(least, count) if least < -FIXED_LIMIT_TOLERANCE else None
                if slack is not None:
                    labelled += [(row.limit, column) for column in _columns(slack)]
        self.limits = tuple(limit for limit, _ in labelled)
        slacks = _joined([column for _, column in labelled], (len(low),), count)
        return BoxModels(residuals, slacks, periodic=self.problem.unit == "rad")


def box_problem(problem: ProblemFile, further: Array | None = None) -> DesignBoxes:
    """Return a problem with definite assembly modes in the form in which it can be bounded over boxes.

    `further`: see `DesignBoxes`.

    Raises
    ------
    InputError
        If no lower bound is available for this kind of problem.
    """
    if not problem.model.parts:
        reason = "only motion laws, functions, timed paths and transmission problems have one"
    elif (model := problem.spec).composed:
        reason = "only the deviations of one requirement alone have one"
    elif model.robust is not None:
        reason = "the objective of a robust design has none"
    elif model.data.offsets is None:
        reason = "the crank angles at the points are unknowns too"
    elif model.limits.regions:
        reason = "with limits of regions there is none"
    elif model.slides and "." in model.output:
        reason = "among laws, those of a coordinate of a point have none"
    elif model.requirement.kind == "transmission" and model.frame_angle is None:
        reason = "among transmission problems, only those of four-bars with a fixed direction of the frame have one"
    else:
        return DesignBoxes(model, np.zeros(0) if further is None else further)
    raise InputError(Fault(f"no certificate of the global optimum: {reason}", "Leave --certify out", problem.file, "--certify"))


Evaluated = tuple[TaylorModel, list[ConstraintRow]]


def _function(problem: DesignProblem, law: Law, values: dict[str, Any], count: int) -> Evaluated:
    """Return the residuals (boxes, positions, 1) and the limits of a function synthesis problem."""
    start = problem.start_position(values)
    residuals = output_error(
        problem, values, start, TaylorModel.constant(law.offsets, count), TaylorModel.constant(law.tabulated, count)
    )
    if not _has_period(problem):
        residuals = _where_principal(residuals, start)
    return residuals[..., None], _limits(problem, values, Reach(start.phi0, problem.span, problem.sense))


def _has_period(problem: DesignProblem) -> bool:
    """Return whether start angles that differ by a full turn prescribe the same law; the models of angles are continuous."""
    phi0, psi0 = TRIALS[:, :, None]
    law = problem.law
    with np.errstate(all="ignore"):
        shifts = [law.target(law.offsets, law.tabulated, phi0 + a, psi0 + b) for a, b in ((0.0, 0.0), (TURN, 0.0), (0.0, TURN))]
        gaps = [np.abs(np.exp(1j * shifted) - np.exp(1j * shifts[0])) for shifted in shifts[1:]]
    free = "phi0" in problem.quantities, "psi0" in problem.quantities
    return all(is_free or bool(np.nanmax(gap, initial=0.0) < 1e-9) for is_free, gap in zip(free, gaps, strict=True))


def _where_principal(residuals: TaylorModel, start: StartPosition) -> TaylorModel:
    """Return the residuals, unknown in boxes in which an angle of the start position passes half a turn."""
    unknown = np.zeros(residuals.remainder.shape, dtype=bool)
    for angle in (start.phi0, start.psi0):
        if isinstance(angle, TaylorModel):
            unknown |= (angle.high > np.pi) | (angle.low < -np.pi)
    return TaylorModel(residuals.coefficients, np.where(unknown, np.inf, residuals.remainder), residuals.count)


def _known_within(model: TaylorModel, most: float) -> TaylorModel:
    """Return a model that is undefined in boxes in which its magnitude may exceed `most`."""
    beyond = ~((model.high < most) & (model.low > -most))
    return TaylorModel(model.coefficients, np.where(beyond, np.inf, model.remainder), model.count)


def _timed(problem: DesignProblem, law: Law | None, values: dict[str, Any], count: int) -> Evaluated:
    """Return the residuals (boxes, positions, components) and the limits of a problem with prescribed crank angles."""
    data = problem.data if law is None else at_positions(np.column_stack([law.offsets, law.tabulated]), law.offsets)
    assert data.offsets is not None
    start = values[START] if problem.timing == "from start" else TaylorModel.constant(0.0, count)
    pose = problem.linkage.at(values, start + TaylorModel.constant(data.offsets, count))
    if problem.requirement.kind == "transmission":  # rational in the lengths, so known where the linkage cannot be assembled too
        assert problem.four_bar is not None
        ends = np.cos(data.offsets - data.offsets[0])
        cosines = [transmission_cosine(*problem.four_bar.lengths(values), TaylorModel.constant(ends, count))]
    else:
        cosines = problem.deviation(pose, values, tuple(TaylorModel.constant(column, count) for column in data.columns.T))
        if problem.requirement.kind == "motion":  # the models of angles are continuous, and may pass half a turn
            cosines[2] = _known_within(cosines[2], problem.radian * np.pi)
    shape = next(iter(values[name] for name in problem.free)).remainder.shape[0], len(data.offsets)
    residuals = _joined(cosines, shape, count) * data.roots[:, None]
    assert problem.data.offsets is not None
    span = float(problem.data.offsets[-1] - problem.data.offsets[0])
    sense = 1 if span >= 0.0 else -1
    rows = _limits(problem, values, Reach(start + float(data.offsets[0]), span, sense))
    if not problem.four_bar:
        turns = problem.limits.crank != "span"
        over_span = position_rows(problem, pose)
        whole = over_span
        if turns:
            grid = np.linspace(*problem.linkage.extent, GRID, endpoint=problem.linkage.limits is not None)
            angles = TaylorModel.constant(grid, count)
            whole = position_rows(problem, problem.linkage.at(values, angles))
        rows += [span_row if span_row.over_span else row for row, span_row in zip(whole, over_span, strict=True)]
    if np.any(np.isfinite(data.tolerances)):
        distance = (residuals[..., :2] * residuals[..., :2]).sum()
        limited = np.isfinite(data.tolerances)
        most = np.where(limited, data.tolerances, 0.0) * data.roots
        slack = (TaylorModel.constant(most * most, count) - distance)[:, limited]
        rows.append(ConstraintRow("requirement.points", "tolerance", slack, 0.0, np.inf, None))  # type: ignore[arg-type]
    return residuals, rows


def _limits(problem: DesignProblem, values: dict[str, Any], reach: Reach) -> list[ConstraintRow]:
    """Return the limits that can be evaluated with Taylor models."""
    rows: list[ConstraintRow] = []
    for term in TERMS:
        with contextlib.suppress(TypeError):  # an operation without a rule: the remaining limits of this term are left out
            rows.extend(term(problem, values, reach, 1.0))
    return rows


def _columns(model: TaylorModel) -> list[TaylorModel]:
    """Return a quantity over boxes as models (boxes,), one for each of its positions."""
    if model.remainder.ndim < 2:
        return [model]
    return [model[..., k] for k in range(model.remainder.shape[-1])]


def _joined(models: list[TaylorModel], shape: tuple[int, ...], count: int) -> TaylorModel:
    """Return models of `count` unknowns that broadcast to a shape as one, along a new last axis."""
    coefficients = np.zeros((1 + count + len(pairs(count)), *shape, len(models)))
    remainder = np.zeros((*shape, len(models)))
    for k, model in enumerate(models):
        coefficients[: len(model.coefficients), ..., k] = np.broadcast_to(model.coefficients, (len(model.coefficients), *shape))
        remainder[..., k] = model.remainder
    return TaylorModel(coefficients, remainder, count)
